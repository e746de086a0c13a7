"""Every error that fleetmap raises: one base class, leaves that carry their data as attributes.

FleetmapError
├── MapFormatError   a map file, or an array handed in as a map, is not what it claims to be
├── WireError        bytes from another robot, or from an .fmap file, were refused
├── LinkError        the transport could not be opened, or failed for good
│   └── NameInUse    another living peer of the fleet has this robot's name
├── ConfigError      an option has an impossible value
└── NoPath           a planner has no path; ``status`` says why

MapWarning           a map is legal, but says something that its author hardly meant
"""

from __future__ import annotations

from pathlib import Path

MAX_SHOWN = 80
"""So many characters of a refused value are shown in its error."""


class FleetmapError(Exception):
    """Base class of every error that fleetmap raises on purpose."""


class MapFormatError(FleetmapError, ValueError):
    """A map file or array is malformed: ``path`` and ``field`` say where, ``reason`` what was expected."""

    def __init__(self, *, path: str | Path, field: str, reason: str) -> None:
        self.path, self.field, self.reason = str(path), field, reason
        super().__init__(f"{path}: {field}: {reason}")


class MapWarning(UserWarning):
    """A map is legal, but read by the letter it says something that its author hardly meant."""


class WireError(FleetmapError, ValueError):
    """A message was refused; nothing of it was applied. ``version``: that of the protocol, if it is another one."""

    def __init__(self, *, robot: str, size_bytes: int, reason: str, version: int | None = None) -> None:
        self.robot, self.size_bytes, self.reason, self.version = robot, size_bytes, reason, version
        super().__init__(f"{robot}: message of {size_bytes} B refused: {reason}")


class LinkError(FleetmapError):
    """The transport could not be opened or has failed; ``endpoint`` says which one."""

    def __init__(self, *, endpoint: str, reason: str) -> None:
        self.endpoint, self.reason = endpoint, reason
        super().__init__(f"{endpoint}: {reason}")


class NameInUse(LinkError):
    """A living peer of this fleet already has this robot's name."""

    def __init__(self, *, robot: str, fleet: str) -> None:
        self.robot, self.fleet = robot, fleet
        super().__init__(
            endpoint=fleet,
            reason=f"a living peer is already called {robot!r}: give this one another name, or stop the other; "
            'if_taken="join" joins beside one that hangs',
        )


class ConfigError(FleetmapError, ValueError):
    """An option has an impossible value."""

    def __init__(self, *, option: str, value: object, reason: str) -> None:
        self.option, self.value, self.reason = option, value, reason
        super().__init__(f"{option}={_shown(value)}: {reason}")


def reason_without_numbers(error: WireError | ConfigError) -> str:
    """A refusal's reason without its numbers, so that there are few of them to count."""
    return "".join(c for c in error.reason if not c.isdigit())[:40]


def _shown(value: object) -> str:
    """A value on one line: an array that was handed in by mistake would fill the screen."""
    text = " ".join(repr(value).split())
    return text if len(text) <= MAX_SHOWN else f"{text[: MAX_SHOWN - 3]}..."


class NoPath(FleetmapError):
    """No path: ``status`` is ``start_blocked``, ``goal_blocked``, ``unreachable`` or ``outside``."""

    def __init__(self, *, status: str, reason: str) -> None:
        self.status, self.reason = status, reason
        super().__init__(f"{status}: {reason}")
