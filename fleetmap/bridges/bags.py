"""Bags: folders of ``ros2 bag``, ``.mcap`` and ``.db3`` alone, and ``.bag`` of ROS 1; read by rosbags."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from fleetmap.bridges import cdr
from fleetmap.model.errors import ConfigError, MapFormatError

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

FILES = (".mcap", ".db3", ".bag")


@dataclass(frozen=True, slots=True)
class Topic:
    """What a bag's index says of a topic."""

    name: str
    type_name: str
    messages: int


def is_bag(path: Path) -> bool:
    """Whether that is the name of a bag: a folder with ``metadata.yaml`` of rosbag2, or a file of one."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(path.glob("*.db3")) or any(path.glob("*.mcap"))
    return path.suffix in FILES


class Bag:
    """A bag that is read; use it as ``with``.

    Parameters
    ----------
    path : a folder or a file

    Raises
    ------
    ConfigError : rosbags is not installed
    MapFormatError : on entering: it is no bag, or damaged
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._store = cdr.typestore()
        self._reader: AnyReader | None = None

    def __enter__(self) -> Self:
        from rosbags.highlevel import AnyReader

        if not self.path.exists():
            raise MapFormatError(path=self.path, field="file", reason="missing: expected a bag")
        try:
            self._reader = AnyReader([self.path], default_typestore=self._store)
            self._reader.open()
        except Exception as error:  # of rosbags and all that it reads files with
            # What a recorder that was killed leaves has no end.
            mend = "if it was cut off, `mcap recover` or `ros2 bag reindex` may mend it"
            reason = f"no bag that can be read: {type(error).__name__}: {error}; {mend}"
            raise MapFormatError(path=self.path, field="file", reason=reason) from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._reader is not None:
            self._reader.close()

    @property
    def reader(self) -> AnyReader:
        """That of rosbags, while it is open."""
        if self._reader is None:
            raise MapFormatError(path=self.path, field="file", reason="is read outside of `with`")
        return self._reader

    @property
    def topics(self) -> list[Topic]:
        """All topics, by name."""
        found: dict[tuple[str, str], int] = {}
        for connection in self.reader.connections:
            key = connection.topic, str(connection.msgtype)
            found[key] = found.get(key, 0) + connection.msgcount
        return [Topic(*key, messages) for key, messages in sorted(found.items())]

    @property
    def span_ns(self) -> tuple[int, int]:
        """When the first and the last message were written; zeros if there are none."""
        return (int(self.reader.start_time), int(self.reader.end_time)) if self.reader.message_count else (0, 0)

    def messages(self, topics: Collection[str]) -> Iterator[tuple[Topic, int, bytes]]:
        """(topic, when in ns, bytes as they stand) of each message of these topics, in the order of time.

        Raises
        ------
        MapFormatError : the bag is damaged
        """
        connections = [c for c in self.reader.connections if c.topic in topics]
        try:
            for connection, stamp_ns, data in self.reader.messages(connections):
                # A topic may have connections of several types.
                yield Topic(connection.topic, str(connection.msgtype), connection.msgcount), int(stamp_ns), bytes(data)
        except Exception as error:  # of rosbags and all that it reads files with
            reason = f"damaged: {type(error).__name__}: {error}"
            raise MapFormatError(path=self.path, field="messages", reason=reason) from None

    def decode(self, topic: Topic, data: bytes) -> Any:
        """A message; of ROS 1 with the same fields.

        Raises
        ------
        MapFormatError : the bytes are none
        """
        try:
            return self.reader.deserialize(data, topic.type_name)
        except Exception as error:  # whatever rosbags has against bytes that may be anything
            reason = f"no {topic.type_name}: {type(error).__name__}: {error}"
            raise MapFormatError(path=self.path, field=topic.name, reason=reason) from None


def map_topics(bag: Bag, wanted: Collection[str] = ()) -> dict[str, str]:
    """Topics of grids -> that of their updates, which may be missing.

    Parameters
    ----------
    wanted : only these; all if empty

    Raises
    ------
    ConfigError : there are none, or not those that are wanted; says which there are
    """
    grids = [topic.name for topic in bag.topics if topic.type_name == cdr.MAP]
    for name in wanted:
        if name not in grids:
            raise ConfigError(option="topic", value=name, reason=f"no topic of grids in {bag.path}; {_there_is(bag)}")
    if not any(topic.messages for topic in bag.topics):
        raise MapFormatError(path=bag.path, field="messages", reason="there are none")
    if not grids:
        raise MapFormatError(path=bag.path, field="topics", reason=f"no {cdr.MAP} in it; {_there_is(bag)}")
    return {name: f"{name}_updates" for name in grids if not wanted or name in wanted}


def _there_is(bag: Bag) -> str:
    listed = [f"{topic.name} ({topic.type_name})" for topic in bag.topics]
    listed.sort(key=lambda text: cdr.MAP not in text)
    return f"there is {', '.join(listed[:8]) or 'nothing'}" + (" ..." if len(listed) > 8 else "")
