"""The ledger: every payload, counted where it is sent, received or dropped, by kind and by robot.

Beside it stand the baselines: what the same map updates would have cost as gzipped grids. One receiver is
counted on both sides.
"""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

from fleetmap.accounting.wire import segments

MAX_SERIES = 4096
"""Points kept of the time series; when it is full, every other one is dropped."""
MAX_KEYS = 4096
"""Different (robot, kind) pairs that are counted apart; all others count under ``other``."""


K = TypeVar("K")


@dataclass(slots=True)
class Count:
    """Messages, their payload bytes, and the TCP segments that they take; only ever grows."""

    messages: int = 0
    size_bytes: int = 0
    segments: int = 0

    def add(self, size_bytes: int) -> None:
        """Count one more message."""
        self.messages += 1
        self.size_bytes += size_bytes
        self.segments += segments(size_bytes)

    def to_json(self) -> list[int]:
        """[messages, bytes, segments]."""
        return [self.messages, self.size_bytes, self.segments]


@dataclass(frozen=True, slots=True)
class Stats:
    """What a ledger held at one moment. Every number only grows.

    Parameters
    ----------
    sent : by kind: ``delta``, ``snapshot``, ``repair``, ``digest``, ``want``, ``list``, ``relay``
    received, dropped : by (robot, kind); a drop's kind ends in its reason, as in ``delta/seq``
    grids : by name, e.g. ``grid_gzip_full``: what the updates that were published would have been as grids
    baselines_missing : by name, updates that ``grids`` doesn't hold, as the codec refused the grid
    watched : answers to watchers (``fleetmap stats --fleet``); they are not in ``sent``: who watches causes them
    explored_m2 : free floor in the grids that were published last; 0 if none was
    series : (t_s, bytes_vector, bytes_deltas, baselines...) each time an update was published
    """

    sent: Mapping[str, Count]
    received: Mapping[tuple[str, str], Count]
    dropped: Mapping[tuple[str, str], Count]
    grids: Mapping[str, Count]
    baselines_missing: Mapping[str, int]
    watched: Count
    explored_m2: float
    series: tuple[tuple[float, Mapping[str, int]], ...]

    @property
    def baselines(self) -> dict[str, int]:
        """Payload bytes by name, e.g. ``grid_gzip_full``."""
        return {name: count.size_bytes for name, count in self.grids.items()}

    @property
    def bytes_vector(self) -> int:
        """Every payload byte handed to the link, to one receiver; answers to watchers are not in it."""
        return sum(count.size_bytes for count in self.sent.values())

    @property
    def bytes_deltas(self) -> int:
        """The bytes of published deltas alone."""
        return self.sent["delta"].size_bytes if "delta" in self.sent else 0

    def to_json(self) -> dict[str, object]:
        """The same as plain lists and dictionaries."""

        def by_robot(counts: Mapping[tuple[str, str], Count]) -> dict[str, dict[str, list[int]]]:
            out: defaultdict[str, dict[str, list[int]]] = defaultdict(dict)
            for (robot, kind), count in sorted(counts.items()):
                out[robot][kind] = count.to_json()[:2]
            return dict(out)

        return {
            "bytes_vector": self.bytes_vector,
            "bytes_deltas": self.bytes_deltas,
            "sent": {kind: count.to_json() for kind, count in sorted(self.sent.items())},
            "grids": {name: count.to_json() for name, count in sorted(self.grids.items())},
            "watched": self.watched.to_json(),
            "explored_m2": round(self.explored_m2, 2),
            "received": by_robot(self.received),
            "dropped": by_robot(self.dropped),
            **{f"bytes_{name}": size for name, size in sorted(self.baselines.items())},
            "baselines_missing": dict(sorted(self.baselines_missing.items())),
            "series": [[t_s, dict(sizes)] for t_s, sizes in self.series],
        }


@dataclass(slots=True)
class Ledger:
    """Counts payloads; may be used from several threads."""

    _sent: defaultdict[str, Count] = field(default_factory=lambda: defaultdict(Count))
    _received: dict[tuple[str, str], Count] = field(default_factory=dict)
    _dropped: dict[tuple[str, str], Count] = field(default_factory=dict)
    _grids: defaultdict[str, Count] = field(default_factory=lambda: defaultdict(Count))
    _missing: defaultdict[str, int] = field(default_factory=lambda: defaultdict(int))
    _watched: Count = field(default_factory=Count)
    _explored_m2: dict[str, float] = field(default_factory=dict)
    _series: list[tuple[float, dict[str, int]]] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def sent(self, kind: str, size_bytes: int) -> None:
        """A payload was handed to the link."""
        with self._lock:
            self._sent[kind].add(size_bytes)

    def received(self, robot: str, kind: str, size_bytes: int) -> None:
        """A payload came from the link."""
        with self._lock:
            self._bounded(self._received, robot, kind).add(size_bytes)

    def dropped(self, robot: str, kind: str, size_bytes: int, *, reason: str) -> None:
        """A payload was not used: a duplicate, malformed, out of order, or a queue was full."""
        with self._lock:
            self._bounded(self._dropped, robot, f"{kind}/{reason}").add(size_bytes)

    def watched(self, size_bytes: int) -> None:
        """A watcher's question was answered."""
        with self._lock:
            self._watched.add(size_bytes)

    def explored(self, submap: str, area_m2: float) -> None:
        """A grid was published that holds so much free floor."""
        with self._lock:
            self._explored_m2[submap] = area_m2

    def published(self, t_s: float, baselines: Mapping[str, int], *, missing: Iterable[str] = ()) -> None:
        """An update was published. What changed nothing costs nothing, and is no message.

        Parameters
        ----------
        t_s : when
        baselines : what it would have cost otherwise, bytes by name
        missing : names of the baselines that can't be said of it
        """
        with self._lock:
            for name in missing:
                self._missing[name] += 1
            for name, size_bytes in baselines.items():
                grids = self._grids[name]
                if size_bytes > 0:
                    grids.add(size_bytes)
            vector = sum(count.size_bytes for count in self._sent.values())
            sizes = {name: count.size_bytes for name, count in self._grids.items()}
            self._series.append((t_s, {"vector": vector, "deltas": self._sent["delta"].size_bytes, **sizes}))
            if len(self._series) > MAX_SERIES:
                del self._series[::2]

    def stats(self) -> Stats:
        """An immutable copy of all counts."""
        with self._lock:
            return Stats(
                _copy(self._sent),
                _copy(self._received),
                _copy(self._dropped),
                _copy(self._grids),
                dict(self._missing),
                replace(self._watched),
                sum(self._explored_m2.values()),
                tuple((t_s, dict(sizes)) for t_s, sizes in self._series),
            )

    def said(self) -> tuple[dict[str, Count], dict[str, Count], Count, float]:
        """``sent``, ``grids``, ``watched`` and ``explored_m2`` of the statistics, without all that may be long."""
        with self._lock:
            return _copy(self._sent), _copy(self._grids), replace(self._watched), sum(self._explored_m2.values())

    @staticmethod
    def _bounded(counts: dict[tuple[str, str], Count], robot: str, kind: str) -> Count:
        key = (robot, kind)
        if key not in counts and len(counts) >= MAX_KEYS:
            key = ("other", "other")
        return counts.setdefault(key, Count())


def _copy(counts: Mapping[K, Count]) -> dict[K, Count]:
    return {key: replace(count) for key, count in counts.items()}
