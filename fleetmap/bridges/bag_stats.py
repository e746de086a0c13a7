"""What a bag's maps cost, and what they would have cost: as vectors, as gzipped grids, and as gzipped rectangles.

Two processes, one for the vectors and one for the grids, read the bag side by side; each keeps one map at a time.
"""

from __future__ import annotations

import multiprocessing
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Protocol

from fleetmap.bridges import cdr
from fleetmap.bridges.bags import Bag, map_topics
from fleetmap.bridges.grids import LatestMap
from fleetmap.model.errors import ConfigError, FleetmapError, MapFormatError, MapWarning
from fleetmap.model.grid import FREE_BELOW, OCCUPIED_ABOVE, OccupancyGrid, check_thresholds
from fleetmap.model.lattice import FREE
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import VectorMap

TELL_S = 0.3
"""How often a process says how far it is."""
POINTS = 600
"""Of each curve over time."""
FEW = 100
"""So few messages are looked at sooner than two processes are there."""


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Which cells are free and which occupied; None: as the grids are read elsewhere.

    Raises
    ------
    ConfigError : not 0 < free_below <= occupied_above < 100
    """

    free_below: float | None = None
    occupied_above: float | None = None

    def __post_init__(self) -> None:
        free, occupied = self.free_below, self.occupied_above
        check_thresholds(FREE_BELOW if free is None else free, OCCUPIED_ABOVE if occupied is None else occupied)


class Side(Protocol):
    """One way to send a topic's maps, a payload each."""

    def add(self, grid: OccupancyGrid) -> dict[str, int]:
        """Bytes that this map adds, by name."""

    def tell(self, cost: TopicCost) -> None:
        """Add the last map to what is said at the end."""


class Grids:
    """Whole grids and rectangles, as ``/map`` and ``/map_updates`` by gzip -6; and what was in the bag."""

    def __init__(self) -> None:
        self._before: OccupancyGrid | None = None

    def add(self, grid: OccupancyGrid) -> dict[str, int]:
        """Sizes of this grid."""
        from fleetmap.codecs.baselines import gzip_changed_rectangle, gzip_grid

        before, self._before = self._before, grid
        return {"grid_gzip_full": gzip_grid(grid), "grid_gzip_updates": gzip_changed_rectangle(before, grid)}

    def tell(self, cost: TopicCost) -> None:
        """The last grid."""
        grid = self._before
        if grid is not None:
            free_m2 = float((grid.states_yx() == FREE).sum()) * grid.resolution_m**2
            cost.about = {"width": grid.width, "height": grid.height, "resolution_m": grid.resolution_m}
            cost.about["explored_m2"] = free_m2


class Vectors:
    """The records that a robot would have sent: the same vectorizer and engine, with nobody to hear them."""

    def __init__(self) -> None:
        from fleetmap.engine import Chain, Engine
        from fleetmap.vectorize import Vectorizer

        self._engine = Engine("r0", chain=Chain(bytes(16)), start=FixedPose())
        self._engine.take_outputs()
        self._vectorizer, self._records = Vectorizer(), 0

    def add(self, grid: OccupancyGrid) -> dict[str, int]:
        """The size of its record; 0 if nothing changed."""
        from fleetmap.engine import Put
        from fleetmap.vectorize import Vectorizer

        try:
            vector_map = self._vectorizer.update(grid)
        except ConfigError:  # another resolution or rotation: it starts anew, as in `publish`
            self._vectorizer = Vectorizer()
            vector_map = self._vectorizer.update(grid)
        self._engine.publish("0", vector_map)
        sizes = [
            len(put.payload) for put in self._engine.take_outputs() if isinstance(put, Put) and put.kind == "delta"
        ]
        self._records += len(sizes)
        return {"vector": sum(sizes)}

    def tell(self, cost: TopicCost) -> None:
        """The last map, and how often it was sent."""
        cost.vector_map = self._engine.own.submaps.get("0")
        edges = 0 if cost.vector_map is None else len(cost.vector_map)
        cost.about = {"edges": edges, "records": self._records}


SIDES: dict[str, Callable[[], Side]] = {"grids": Grids, "vectors": Vectors}


@dataclass(slots=True)
class TopicCost:
    """One topic of grids, with its updates.

    Parameters
    ----------
    name : of the topic
    messages, size_bytes : in the bag, as its index counts: whole maps and updates
    refused : messages that were no maps, and the first reason
    warning : what was to be said of its first map; empty: nothing
    sizes : by name, the sum of all payloads
    series : (seconds from the bag's begin, sizes so far)
    about : figures of the last map
    vector_map : the last map; None if there was none
    """

    name: str
    messages: int = 0
    updates: int = 0
    size_bytes: int = 0
    refused: int = 0
    reason: str = ""
    warning: str = ""
    sizes: dict[str, int] = field(default_factory=dict)
    series: list[tuple[float, dict[str, int]]] = field(default_factory=list)
    about: dict[str, Any] = field(default_factory=dict)
    vector_map: VectorMap | None = None


@dataclass(slots=True)
class BagCost:
    """A whole bag."""

    path: Path
    duration_s: float
    topics: list[TopicCost]


def judge(
    path: Path,
    *,
    topics: list[str],
    thresholds: Thresholds = Thresholds(),
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> BagCost:
    """Read a bag once for each side, both at a time.

    Parameters
    ----------
    topics : of grids; all if empty
    on_progress : told how many messages of how many both sides have looked at

    Raises
    ------
    MapFormatError : no bag, damaged, or without grids
    ConfigError : a topic that isn't in it
    """
    with Bag(path) as bag:
        wanted = map_topics(bag, topics)
        counts = {topic.name: topic.messages for topic in bag.topics}
        begin_ns, end_ns = bag.span_ns
    total = sum(counts.get(name, 0) for pair in wanted.items() for name in pair) * len(SIDES)
    if total <= FEW * len(SIDES):
        parts = {side: _costs(path, wanted, make, thresholds, lambda seen: None) for side, make in SIDES.items()}
    else:
        parts = _side_by_side(path, wanted, thresholds, total, on_progress)
    joined = [_joined(*topic) for topic in zip(*parts.values(), strict=True)]
    for topic in joined:
        if topic.warning:
            warnings.warn(f"{path}: {topic.name}: {topic.warning}", MapWarning, stacklevel=2)
    return BagCost(path, (end_ns - begin_ns) / 1e9, joined)


def _side_by_side(
    path: Path,
    wanted: dict[str, str],
    thresholds: Thresholds,
    total: int,
    on_progress: Callable[[int, int], None],
) -> dict[str, list[TopicCost]]:
    """By side, what it found; each in a process of its own."""
    # Spawned: this process may have threads of libraries that don't survive a fork.
    context = multiprocessing.get_context("spawn")
    workers, done = {}, dict.fromkeys(SIDES, 0)
    results: dict[str, list[TopicCost]] = {}
    try:
        for side in SIDES:
            here, there = context.Pipe(duplex=False)
            process = context.Process(target=_work, args=(there, side, path, wanted, thresholds), daemon=True)
            process.start()
            there.close()
            workers[here] = (side, process)
        waiting = list(workers)
        while waiting:
            for connection in wait(waiting):
                assert isinstance(connection, Connection)
                side = workers[connection][0]
                try:
                    told = connection.recv()
                except EOFError:
                    raise MapFormatError(path=path, field="messages", reason=f"the process for {side} ended") from None
                if isinstance(told, str):
                    raise MapFormatError(path=path, field="messages", reason=told)
                if isinstance(told, int):
                    done[side] = told
                    on_progress(sum(done.values()), total)
                else:
                    results[side] = told
                    waiting.remove(connection)
    finally:
        for connection, (_, process) in workers.items():
            connection.close()
            process.terminate()
            process.join()
    return {side: results[side] for side in SIDES}


def _joined(first: TopicCost, *others: TopicCost) -> TopicCost:
    """The sides of one topic together; they have read the same messages."""
    for other in others:
        first.sizes |= other.sizes
        first.warning = first.warning or other.warning
        if other.refused > first.refused:
            first.refused, first.reason = other.refused, other.reason
        first.about |= other.about
        first.vector_map = other.vector_map if first.vector_map is None else first.vector_map
        first.series = [(t, {**a, **b}) for (t, a), (_, b) in zip(first.series, other.series, strict=True)]
    return first


def _work(told: Connection, side: str, path: Path, wanted: dict[str, str], thresholds: Thresholds) -> None:
    """One side, in a process of its own."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, which ends this one
    try:
        told.send(_costs(path, wanted, SIDES[side], thresholds, told.send))
    except FleetmapError as error:
        told.send(error.reason if isinstance(error, MapFormatError) else str(error))
    except BrokenPipeError:
        return


def _costs(
    path: Path,
    wanted: dict[str, str],
    make_side: Callable[[], Side],
    thresholds: Thresholds,
    tell: Callable[[int], None],
) -> list[TopicCost]:
    costs = {name: TopicCost(name) for name in wanted}
    sides = {name: make_side() for name in wanted}
    of_update = {updates: name for name, updates in wanted.items()}
    seen, told_s = 0, time.monotonic()
    with Bag(path) as bag:
        begin_ns, end_ns = bag.span_ns
        step_s = (end_ns - begin_ns) / 1e9 / POINTS
        for name, stamp_ns, size_bytes, grid in _grids(bag, wanted, of_update, costs):
            cost = costs[name]
            cost.size_bytes += size_bytes
            if grid is not None:
                grid = grid.with_thresholds(free_below=thresholds.free_below, occupied_above=thresholds.occupied_above)
                # Caught: what a process of its own warns of, nobody hears.
                with warnings.catch_warnings(record=True) as said:
                    warnings.simplefilter("always", MapWarning)
                    try:
                        added = sides[name].add(grid)
                    except (ConfigError, MapFormatError) as error:  # a place beyond all bounds
                        added = {}
                        cost.refused += 1
                        cost.reason = cost.reason or str(error)
                cost.warning = cost.warning or "; ".join(str(each.message) for each in said)
                for kind, size in added.items():
                    cost.sizes[kind] = cost.sizes.get(kind, 0) + size
            t_s = (stamp_ns - begin_ns) / 1e9
            point = t_s, {"bag": cost.size_bytes, **cost.sizes}
            if len(cost.series) > 1 and t_s - cost.series[-2][0] < step_s:
                cost.series[-1] = point
            else:
                cost.series.append(point)
            seen += 1
            if time.monotonic() - told_s > TELL_S:
                told_s = time.monotonic()
                tell(seen)
    tell(seen)
    for name, side in sides.items():
        side.tell(costs[name])
    return list(costs.values())


def _grids(
    bag: Bag, wanted: dict[str, str], of_update: dict[str, str], costs: dict[str, TopicCost]
) -> Iterator[tuple[str, int, int, OccupancyGrid | None]]:
    """(topic, when, bytes, the map after it) of each message; None where it was no map."""
    latest = {name: LatestMap() for name in wanted}
    for topic, stamp_ns, data in bag.messages([*wanted, *of_update]):
        name = of_update.get(topic.name, topic.name)
        cost, grid = costs[name], None
        try:
            message = bag.decode(topic, data)
            if topic.type_name == cdr.MAP:
                cost.messages += 1
                latest[name].replace(message)
            elif topic.type_name == cdr.MAP_UPDATE:
                cost.updates += 1
                latest[name].update(message)
            grid = latest[name].take()
        except MapFormatError as error:
            cost.refused += 1
            cost.reason = cost.reason or str(error)
        yield name, stamp_ns, len(data), grid
