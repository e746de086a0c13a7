"""Zenoh's settings as users hand them over: configuration keys -> values, whole trees or leaf by leaf."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from fleetmap.model.errors import ConfigError

FILES = (
    "root_ca_certificate",
    "listen_private_key",
    "listen_certificate",
    "connect_private_key",
    "connect_certificate",
    "dictionary_file",
    "public_key_file",
    "private_key_file",
)
"""Settings of Zenoh that name a file. It takes one that is missing in silence, and then no link comes up."""


def check_config(config: object) -> dict[str, object]:
    """The settings, if they can be written as JSON, and the files that they name be read.

    Raises
    ------
    ConfigError : which one, and why
    """
    if not isinstance(config, Mapping) or not all(isinstance(key, str) for key in config):
        reason = 'expected Zenoh\'s keys -> values, as {"scouting/multicast/enabled": False}'
        raise ConfigError(option="config", value=config, reason=reason)
    for key, value in config.items():
        try:
            as_json5(value)
        except (TypeError, ValueError) as error:
            reason = f"the value of {key!r} can't be written as JSON: {error}"
            raise ConfigError(option="config", value={key: value}, reason=reason) from None
    for key, name in _files(config):
        try:
            Path(name).open("rb").close()
        except OSError as error:
            reason = f"{name} can't be read ({error.strerror})"
            raise ConfigError(option="config", value=key, reason=reason) from None
    return dict(config)


def read_config(path: str | Path) -> dict[str, object]:
    """Settings from a JSON file.

    Raises
    ------
    ConfigError : it can't be read, or holds no object
    """
    try:
        settings = json.loads(Path(path).read_text())
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ConfigError(option="config", value=str(path), reason=f"can't be read as JSON: {error}") from None
    if not isinstance(settings, dict):
        raise ConfigError(option="config", value=str(path), reason="expected an object of Zenoh's keys -> values")
    return settings


def as_json5(value: object) -> str:
    """A setting as the JSON text that ``zenoh.Config.insert_json5`` expects; text stays as it is."""
    return value if isinstance(value, str) and value[:1] in '"[{' else json.dumps(value)


def leaves(value: object, path: str) -> Iterator[tuple[str, object]]:
    """Settings by their whole keys."""
    if isinstance(value, str) and value[:1] in '"{':
        with suppress(json.JSONDecodeError):  # JSON5, which Zenoh takes, too: it isn't looked into
            value = json.loads(value)
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from leaves(inner, f"{path}/{key}" if path else str(key))
    else:
        yield path, value


def _files(config: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    for path, value in leaves(config, ""):
        if path.rsplit("/", 1)[-1] in FILES and isinstance(value, str) and value:
            yield path, value
