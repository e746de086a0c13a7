"""The YAML of a map_server map as yaml-cpp reads it, which is what map_server uses; PyYAML follows YAML 1.1.

To YAML 1.1 ``010`` is 8, ``1:30`` is 90, ``1_000`` is 1000, and a tab behind a colon is an error. To yaml-cpp the first
is 10, the second and the third are no numbers, and a tab is a blank. So scalars stay text here, and each field is read
as what it must be. What yaml-cpp 0.7 makes of each case was measured; the cases are in the tests.
"""

from __future__ import annotations

import math
import re
import reprlib
from pathlib import Path

import yaml

from fleetmap.model.errors import MapFormatError

MAX_YAML_BYTES, MAX_YAML_TOKENS = 1 << 16, 1000
"""A usual file has 300 bytes and 40 tokens; PyYAML takes quadratic time over nested brackets, 0.1 s for these."""

NULLS = ("", "~", "null", "Null", "NULL")

NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
WHOLE = re.compile(r"[-+]?(0[xX]0*[0-9a-fA-F]{1,8}|0*[0-9]{1,10})")
TRUE, FALSE = (
    {form for word in words for form in (word, word.upper(), word.capitalize())}
    for words in (("y", "yes", "true", "on"), ("n", "no", "false", "off"))
)

Value = str | None | list["Value"] | dict[str, "Value"]
"""Text, nothing, or more of them."""


def read_yaml(path: Path) -> dict[str, Value]:
    """Read the mapping in a YAML file, of bounded size, without aliases and doubled keys.

    Raises
    ------
    MapFormatError : the file can't be read, or holds anything else
    """

    def refuse(reason: str) -> MapFormatError:
        return MapFormatError(path=path, field="yaml", reason=reason)

    try:
        with path.open("rb") as file:
            raw = file.read(MAX_YAML_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise refuse(f"cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(raw) > MAX_YAML_BYTES:
        raise refuse(f"more than {MAX_YAML_BYTES} bytes; expected the few lines of a map_server file")
    try:
        text = raw.decode()
        for count, token in enumerate(yaml.scan(text, Loader=_Loader)):
            # Aliases let a few lines stand for terabytes.
            if count > MAX_YAML_TOKENS or isinstance(token, yaml.AliasToken):
                raise refuse("expected a plain mapping; found aliases, or very many values")
        fields = _value(yaml.compose(text, Loader=_Loader), path)
    except MapFormatError:
        raise
    except Exception as error:  # PyYAML lets through what chr() and deep nesting raise
        raise refuse(f"is no YAML: {' '.join(str(error).split()) or type(error).__name__}") from error
    if not isinstance(fields, dict):
        raise refuse(f"expected a mapping with image, resolution and origin; found {reprlib.repr(fields)}")
    return fields


def as_number(value: Value) -> float:
    """The number that a text is in decimal notation; NaN if it is none, or not finite."""
    text = value.rstrip() if isinstance(value, str) else ""  # blanks may stand behind it, not before
    number = float(text) if NUMBER.fullmatch(text) else math.nan
    return number if math.isfinite(number) else math.nan


def as_truth(value: Value) -> bool | None:
    """Whether a text is yes, or a whole number other than 0; None if it is neither yes nor no nor such a number."""
    text = value.rstrip() if isinstance(value, str) else ""
    if not WHOLE.fullmatch(text):
        return {**dict.fromkeys(TRUE, True), **dict.fromkeys(FALSE, False)}.get(text)
    number = int(text, 16) if "x" in text.lower() else int(text)
    return bool(number) if -(2**31) <= number < 2**31 else None  # yaml-cpp reads an int


def _value(node: yaml.Node | None, path: Path) -> Value:
    if isinstance(node, yaml.ScalarNode):
        return None if node.style is None and node.value in NULLS else str(node.value)
    if isinstance(node, yaml.SequenceNode):
        return [_value(item, path) for item in node.value]
    fields: dict[str, Value] = {}
    for key, value in node.value if isinstance(node, yaml.MappingNode) else ():
        if not isinstance(key, yaml.ScalarNode):
            raise MapFormatError(path=path, field="yaml", reason="expected plain keys; found a list or a mapping")
        if key.value in fields:
            # yaml-cpp takes the first one, PyYAML the last one: whoever wrote it can't know which it is.
            reason = f"stands there twice, the second time in line {key.start_mark.line + 1}; expected each key once"
            raise MapFormatError(path=path, field=reprlib.repr(key.value).strip("'"), reason=reason)
        fields[key.value] = _value(value, path)
    return fields if node is not None else None


class _Loader(yaml.SafeLoader):
    """Takes a tab for a blank wherever it doesn't indent, as yaml-cpp does."""

    def scan_to_next_token(self) -> None:
        super().scan_to_next_token()
        while self.peek() == "\t":
            if not self.flow_level:
                self.allow_simple_key = False  # no key follows a tab: that would be indentation
            self.forward()
            super().scan_to_next_token()

    def scan_plain_spaces(self, indent: int, start_mark: yaml.Mark) -> list[str]:
        """Blanks within a plain scalar; PyYAML ends it at a tab."""
        length = 0
        while self.peek(length) in (" ", "\t"):
            length += 1
        blanks: str = self.prefix(length)
        if "\t" in blanks:
            self.forward(length)
            if self.peek() not in "\r\n\x85\u2028\u2029":
                return [blanks]
        return super().scan_plain_spaces(indent, start_mark) or []
