"""Zenoh keys of the fleet, and how Zenoh hands over what it finds under them."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import zenoh

from fleetmap.codecs.names import NAME
from fleetmap.model.errors import ConfigError
from fleetmap.peer.link import Token
from fleetmap.peer.settings import as_json5

T = TypeVar("T")

LIFE = re.compile("[0-9a-f]{16}")
MAX_LOOKED_AT = 16_384
"""Tokens that a look at all of them finds."""


def zenoh_config(settings: Mapping[str, object]) -> zenoh.Config:
    """The settings as Zenoh takes them.

    Raises
    ------
    ConfigError : it doesn't take one of them
    """
    config = zenoh.Config()
    for key, value in settings.items():
        try:
            config.insert_json5(key, as_json5(value))
        except zenoh.ZError as error:
            # Zenoh's own message has the place in its source, and not the key.
            told = str(error).partition(" at /")[0].partition("Message {")[0]
            reason = f"Zenoh takes no such setting as {key!r}, or no such value for it: {told}"
            raise ConfigError(option="config", value={key: value}, reason=reason) from None
    return config


def direct(call: Callable[[T], None], end: Callable[[], None] | None = None) -> Any:
    """A callback that runs on Zenoh's own thread, which it must not keep: any other one has a thread of Python's."""
    return zenoh.handlers.Callback(call, end, indirect=False)


def living_keys(session: zenoh.Session, selector: str, *, timeout_s: float) -> list[str]:
    """The liveliness keys that are shown now.

    Zenoh's own queue of replies holds 256, and what a session knows already comes before ``get`` returns: with more
    tokens than that nobody would ever take one out.
    """
    found: list[str] = []
    ended = threading.Event()

    def take(reply: zenoh.Reply) -> None:
        if reply.ok is not None and len(found) < MAX_LOOKED_AT:
            found.append(str(reply.ok.key_expr))

    session.liveliness().get(selector, zenoh.handlers.Callback(take, ended.set), timeout=timeout_s)
    ended.wait(2 * timeout_s)
    return list(found)


def parse_key(key: str) -> tuple[str, str, int] | None:
    """(robot, kind, life) of ``fleetmap/<fleet>/<robot>/<kind>/<life>``; None if it is no such key."""
    parts = key.split("/")
    if len(parts) != 5 or not LIFE.fullmatch(parts[4]) or not NAME.fullmatch(parts[2]):
        return None
    return parts[2], parts[3], int(parts[4], 16)


def parse_token(key: str) -> Token | None:
    """The peer behind a liveliness key; None if it is none of ours."""
    parsed = parse_key(key)
    return (parsed[0], parsed[2]) if parsed is not None and parsed[1] == "alive" else None


def robot_of_token(key: str) -> str | None:
    """The robot behind a key ``fleetmap/<fleet>/<robot>/alive/...``, also of another version; None if it is none."""
    parts = key.split("/")
    return parts[2] if len(parts) > 4 and parts[3] == "alive" and NAME.fullmatch(parts[2]) else None
