"""Names of ROS: what is one, and what a relative one means."""

from __future__ import annotations

import re

from fleetmap.model.errors import ConfigError

_PART = "[A-Za-z_][A-Za-z0-9_]*"
TOPIC = re.compile(rf"(/|~/)?{_PART}(/{_PART})*")
NAMESPACE = re.compile(rf"/|(/?{_PART})(/{_PART})*")
NODE = re.compile(_PART)
MAX_TOPIC = 247
"""Characters of a topic (RMW_TOPIC_MAX_NAME_LENGTH)."""
HOW = "parts of A-Z a-z 0-9 _ that begin with no digit, and / between them"


def check_topic(option: str, value: object, *, may_be_empty: bool = False) -> str:
    """A topic, as a user may write it.

    Raises
    ------
    ConfigError : it is none
    """
    if value == "" and may_be_empty:
        return ""
    if not isinstance(value, str) or not TOPIC.fullmatch(value) or len(value) > MAX_TOPIC:
        raise ConfigError(option=option, value=value, reason=f"expected a topic, as map or /r1/map: {HOW}")
    return value


def check_namespace(option: str, value: object) -> str:
    """A namespace, with its leading slash; the root is ``/``.

    Raises
    ------
    ConfigError : it is none
    """
    if value == "":
        return "/"
    if not isinstance(value, str) or not NAMESPACE.fullmatch(value):
        raise ConfigError(option=option, value=value, reason=f"expected a namespace, as / or /r1: {HOW}")
    return "/" + value.lstrip("/")


def check_node(option: str, value: object) -> str:
    """The name of a node.

    Raises
    ------
    ConfigError : it is none
    """
    if not isinstance(value, str) or not NODE.fullmatch(value):
        raise ConfigError(option=option, value=value, reason="expected A-Z a-z 0-9 _ that begin with no digit")
    return value


def check_frame(option: str, value: object, *, may_be_empty: bool = False) -> str:
    """The name of a frame, without the leading slash that tf2 doesn't take.

    Raises
    ------
    ConfigError : it is none
    """
    if not isinstance(value, str) or len(value) > 255 or "\x00" in value or not (value.lstrip("/") or may_be_empty):
        raise ConfigError(option=option, value=value, reason="expected the name of a frame, as map or r1/map")
    return value.lstrip("/")


def resolve(topic: str, *, namespace: str, node: str) -> str:
    """The whole name of a topic."""
    root = "" if namespace == "/" else namespace
    if topic.startswith("/"):
        return topic
    if topic.startswith("~/"):
        return f"{root}/{node}/{topic[2:]}"
    return f"{root}/{topic}"
