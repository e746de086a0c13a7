"""``McapFile``: a recording for ``ros2 bag``, Foxglove, Lichtblick and Rerun: MCAP of profile ros2, zstd chunks."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from fleetmap.bridges import cdr
from fleetmap.bridges.qos import Qos
from fleetmap.bridges.qos_yaml import offered_profiles
from fleetmap.model.errors import ConfigError
from fleetmap.version import __version__

CHUNK_BYTES = 128 << 10
"""Who is killed loses one."""


def check_out(path: Path) -> None:
    """Refuse what could not be recorded into, before there is anything to record.

    Raises
    ------
    ConfigError : another ending, no such folder, or mcap is not installed
    """
    if path.suffix != ".mcap":
        raise ConfigError(option="OUT.mcap", value=str(path), reason="expected a name that ends in .mcap")
    if not path.resolve().parent.is_dir():
        raise ConfigError(option="OUT.mcap", value=str(path), reason="there is no such folder")
    if importlib.util.find_spec("mcap") is None:
        raise cdr.missing("mcap")


class McapFile:
    """A file that is written; use it as ``with``. It is whole only when it is closed.

    Parameters
    ----------
    path : its name, ending in ``.mcap``; a file of that name is replaced

    Raises
    ------
    ConfigError : another ending, or mcap is not installed
    OSError : it can't be written, now or later; names it
    """

    def __init__(self, path: Path) -> None:
        check_out(path)
        self.path = path
        from mcap.writer import CompressionType, Writer

        self._store = cdr.typestore()
        self._file: IO[bytes] = path.open("wb")
        self._writer: Any = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=f"fleetmap {__version__}")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequences: dict[str, int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Write the index. May be called twice."""
        if not self._file.closed:
            with self._named():
                try:
                    self._writer.finish()
                finally:
                    self._file.close()

    def add_topic(self, topic: str, type_name: str, qos: Qos) -> None:
        """A channel of ROS messages; what is there already stays."""
        if topic in self._channels:
            return
        if type_name not in self._schemas:
            text, _ = self._store.generate_msgdef(type_name, ros_version=2)
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", text.encode())
        about = {"offered_qos_profiles": offered_profiles(qos), "topic_type_hash": cdr.HASHES[type_name]}
        self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[type_name], metadata=about)

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """One message of a channel that was added."""
        number = self._sequences[topic] = self._sequences.get(topic, -1) + 1
        with self._named():
            self._writer.add_message(self._channels[topic], stamp_ns, data, stamp_ns, number)

    def write_json(self, topic: str, stamp_ns: int, document: Mapping[str, object]) -> None:
        """One JSON document, in a channel of ``std_msgs/String``.

        Not in one of encoding ``json``: `ros2 bag` plays no file that has topics of several encodings (rosbag2 issues
        1245 and 1847; mended in August 2026, after all its releases), and rosbags opens none with a JSON schema.
        """
        text = cdr.make(cdr.TEXT, data=json.dumps(document, separators=(",", ":")))
        self.write(topic, stamp_ns, cdr.encode(text, cdr.TEXT))

    @contextmanager
    def _named(self) -> Iterator[None]:
        """What the system has against writing says which file."""
        try:
            yield
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self.path)) from None
