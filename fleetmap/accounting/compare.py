"""What a robot sent beside what it would have sent as grids: payload and wire, both sides by one estimator."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from fleetmap.accounting.ledger import Count
from fleetmap.accounting.wire import Transport, WireBytes, grids_instead, wire_bytes

BASELINES = {"grid_gzip_full": "full", "grid_gzip_updates": "updates", "grid_exact_updates": "exact"}
"""Names of grids, and of the ratios to them."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Bytes to one receiver.

    Parameters
    ----------
    vector : payload that was sent
    wire : the same on an IP link
    grids : by name, the payload of the grids alone
    wire_grids : by name, on an IP link: the grids, and all that a fleet of grids says besides
    time_s : how long the robots were there, all together
    """

    vector: int
    wire: WireBytes
    grids: Mapping[str, int]
    wire_grids: Mapping[str, int]
    time_s: float

    def ratio(self, name: str) -> float | None:
        """How many times the payload the grids would have been."""
        return self.grids[name] / self.vector if self.vector else None

    def wire_ratio(self, name: str) -> float | None:
        """The same on the wire."""
        return self.wire_grids[name] / self.wire.total if self.wire.total else None


def compare(
    sent: Mapping[str, Count], grids: Mapping[str, Count], time_s: float, transport: Transport | None = None
) -> Comparison:
    """One robot's side.

    Parameters
    ----------
    sent, grids : as in ``Stats``
    time_s : how long it was there; heartbeats are as ``sent`` has them
    """
    return Comparison(
        sum(count.size_bytes for count in sent.values()),
        wire_bytes(sent, time_s, transport),
        {name: count.size_bytes for name, count in grids.items()},
        {name: wire_bytes(grids_instead(sent, count), time_s, transport).total for name, count in grids.items()},
        time_s,
    )


def together(parts: Iterable[Comparison]) -> Comparison:
    """A fleet's: each robot's share, added up."""
    listed = list(parts)

    def added(tables: Iterable[Mapping[str, int]]) -> dict[str, int]:
        total: dict[str, int] = {}
        for table in tables:
            for name, size_bytes in table.items():
                total[name] = total.get(name, 0) + size_bytes
        return total

    return Comparison(
        sum(part.vector for part in listed),
        WireBytes(*(sum(column) for column in zip(*(part.wire for part in listed), strict=True))),
        added(part.grids for part in listed),
        added(part.wire_grids for part in listed),
        sum(part.time_s for part in listed),
    )


def with_heartbeats(sent: Mapping[str, Count], time_s: float, every_s: float) -> dict[str, Count]:
    """As ``sent``, with the heartbeats of another time: a simulated fleet lives faster than its heart beats."""
    beats = sent.get("digest")
    if beats is None or beats.messages == 0:
        return dict(sent)
    number = max(1, round(time_s / every_s))
    size_bytes = round(beats.size_bytes / beats.messages * number)
    return {**sent, "digest": replace(beats, messages=number, size_bytes=size_bytes, segments=number)}
