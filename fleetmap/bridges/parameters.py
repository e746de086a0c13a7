"""Parameter files in ROS's form: ``node: ros__parameters: {name: value}``, with wildcards and namespaces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from fleetmap.bridges.options import BridgeOptions, WireOptions, options_of
from fleetmap.model.errors import ConfigError

KEY = "ros__parameters"
MAX_DEPTH = 16
"""Of namespaces."""


def read_parameters(path: Path, *, node: str, namespace: str) -> dict[str, Any]:
    """The parameters that the file has for a node; what stands later wins, as in rclcpp.

    Raises
    ------
    ConfigError : the file can't be read, has nothing for this node, or a parameter that there isn't
    """

    def refuse(reason: str) -> ConfigError:
        return ConfigError(option="params_file", value=str(path), reason=reason)

    try:
        document = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError) as error:
        raise refuse(f"can't be read: {error}") from None
    except (yaml.YAMLError, ValueError) as error:  # of a date that is none
        raise refuse(f"no YAML: {error}") from None
    if not isinstance(document, Mapping):
        raise refuse(f"expected {{node: {{{KEY}: {{name: value}}}}}}")
    root = "" if namespace == "/" else namespace
    found: dict[str, Any] = {}
    named = []
    for name, values in _nodes(document, ""):
        named.append(name)
        if not isinstance(values, Mapping):
            raise refuse(f"{name}: {KEY}: expected {{name: value}}")
        if _matches(name, f"{root}/{node}"):
            found.update({str(key): value for key, value in values.items()})
    if not found:
        there = ", ".join(named) or f"no {KEY} at all"
        expected = f"expected /**, {node} or {root}/{node}; found {there}"
        raise refuse(f"has no parameters for {root}/{node}: {expected}. --namespace and --node say which node this is")
    known = [f.name for kind in (BridgeOptions, WireOptions) for f in options_of(kind)]
    for key in found:
        if key not in known:
            raise refuse(f"{key}: there is no such parameter; expected one of {', '.join(known)}")
    return found


def _nodes(tree: Mapping[Any, Any], path: str) -> Iterator[tuple[str, Any]]:
    if path.count("/") > MAX_DEPTH:  # a mapping that holds itself has no end
        return
    for key, value in tree.items():
        name = f"{path}/{str(key).strip('/')}"
        if isinstance(value, Mapping):
            if KEY in value:
                yield name, value[KEY]
            yield from _nodes({k: v for k, v in value.items() if k != KEY}, name)


def _matches(pattern: str, name: str) -> bool:
    """``/**`` stands for any namespaces, also none; ``*`` for one; a bare name for a node in any namespace."""
    wanted, given = pattern.strip("/").split("/"), name.strip("/").split("/")
    if len(wanted) == 1 and wanted[0] not in ("*", "**"):
        return wanted[0] == given[-1]

    def fits(w: list[str], g: list[str]) -> bool:
        if not w:
            return not g
        if w[0] == "**":
            return fits(w[1:], g) or (bool(g) and fits(w, g[1:]))
        return bool(g) and w[0] in ("*", g[0]) and fits(w[1:], g[1:])

    return fits(wanted, given)
