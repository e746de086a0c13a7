"""Names of robots, fleets, levels and submaps."""

from __future__ import annotations

import re

from fleetmap.model.errors import ConfigError

NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")


def check_name(option: str, name: str) -> str:
    """The name, if it is one.

    Raises
    ------
    ConfigError : it is not 1 to 64 of the characters A-Z a-z 0-9 _ . -
    """
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise ConfigError(option=option, value=name, reason="expected 1 to 64 of A-Z a-z 0-9 _ . -")
    return name
