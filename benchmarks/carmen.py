"""What do real laser logs look like once they are mapped? CARMEN's text format in, a robot's own maps out.

Prints for each log its scans and beams, the way and the time, how often the robot would have published, and what it
knew in the end; ``--out`` keeps the last maps, to be looked at. ``replay`` is what ``deltas.py`` measures. ``--tiny``
writes a log of a simulated robot, and its map must be the one that the simulation makes of the same scans.

    python benchmarks/carmen.py [--logs LOG...] [--out FOLDER]

A line of a log is read as

    ROBOTLASER1 laser_type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode
        num_readings [ranges] num_remissions [remissions] laser_pose(x y theta) robot_pose(x y theta)
        tv rv forward_safety side_safety turn_axis ipc_timestamp ipc_hostname logger_timestamp

in metres, radians and seconds; lines of any other kind are passed over. The poses are taken as they stand: where they
are raw odometry they drift, and the map smears.
"""

from __future__ import annotations

import argparse
import gzip
import itertools
import math
import os
import tempfile
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import UNKNOWN
from fleetmap.model.map_server import save_map
from fleetmap.model.pose import Pose2, wrap
from fleetmap.sims.agent import PUBLISH_EVERY_M, PUBLISH_EVERY_S
from fleetmap.sims.lidar import Lidar
from fleetmap.sims.mapping import Mapper
from fleetmap.sims.worlds import choose_starts, make_world

REACH_M = 10.0
"""Returns beyond it say no more than that the way there is free: the reach of the simulated robots."""

NOT_SEEN_M = -math.inf
"""The mapper's votes go to what lies before a range or just behind it: with this one, to nothing."""

FINER = 9
"""The mapper's beams go evenly around; so many to one of the log's, so that each finds its nearest. Odd: no beam of
the mapper then lies halfway between two of the log's."""

STILL_M, STILL_RAD = 0.001, 0.001
"""A robot that moves less from scan to scan stands: odometry is never quite still."""

FINEST_RAD = 1e-4
"""Least distance between beams that is read, so that all around stays small; a quarter of a degree is 0.0044."""


@dataclass(frozen=True, slots=True)
class Scan:
    """What a line of a log says.

    Parameters
    ----------
    start_rad, step_rad : of the first beam, from straight ahead, and from one to the next; counter-clockwise
    maximum_m : a range that isn't below it means that nothing returned
    ranges_m : (n,) one a beam
    pose : of the laser, in the log's frame
    stamp_s : when it was taken
    """

    start_rad: float
    step_rad: float
    maximum_m: float
    ranges_m: NDArray[np.float64]
    pose: Pose2
    stamp_s: float

    def has_seen(self) -> bool:
        """Whether anything returned."""
        return bool((self.ranges_m < self.maximum_m).any())


class Fields:
    """The words of one line, taken in their order, each under its name."""

    def __init__(self, path: Path, line: int, words: list[str]) -> None:
        self.path, self.line, self.words = path, line, iter(words)

    def refuse(self, name: str, reason: str) -> MapFormatError:
        """The error that says where."""
        return MapFormatError(path=self.path, field=f"line {self.line}, {name}", reason=reason)

    def word(self, name: str) -> str:
        """The next word, whatever it is."""
        for word in self.words:
            return word
        raise self.refuse(name, "missing: the line ends before it")

    def number(self, name: str, *, least: float = -math.inf) -> float:
        """The next word as a finite number."""
        word = self.word(name)
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if math.isfinite(value) and value >= least:
            return value
        at_least = f", at least {least:g}" if least > -math.inf else ""
        raise self.refuse(name, f"expected a finite number{at_least}; found {word!r}")

    def numbers(self, count: str, name: str) -> list[float]:
        """As many numbers from 0 as the next word says."""
        word = self.word(count)
        if not word.isdecimal():
            raise self.refuse(count, f"expected a whole number; found {word!r}")
        return [self.number(f"{name}[{k}]", least=0.0) for k in range(int(word))]

    def end(self) -> None:
        """Nothing may be left."""
        if rest := list(self.words):
            raise self.refuse("end of the line", f"{len(rest)} words more than the format has, from {rest[0]!r} on")


def read_scan(fields: Fields) -> Scan:
    """What follows the word ROBOTLASER1.

    Raises
    ------
    MapFormatError : a field is missing or impossible
    """
    fields.word("laser_type")
    start_rad = fields.number("start_angle")
    fields.number("field_of_view")
    step_rad = fields.number("angular_resolution", least=FINEST_RAD)
    maximum_m = fields.number("maximum_range", least=0.0)
    fields.number("accuracy")
    fields.word("remission_mode")
    ranges = fields.numbers("num_readings", "ranges")
    # 361 readings, one a degree, go once around: the last looks where the first does.
    if not 0.0 <= (len(ranges) - 1) * step_rad < 2 * math.pi + step_rad / 2:
        raise fields.refuse("num_readings", f"expected 1 to a full turn, {step_rad} rad apart; found {len(ranges)}")
    fields.numbers("num_remissions", "remissions")
    pose = Pose2(*(fields.number(f"laser_pose {axis}") for axis in ("x", "y", "theta")))
    for name in ("robot_pose x", "robot_pose y", "robot_pose theta"):
        fields.number(name)
    for name in ("tv", "rv", "forward_safety", "side_safety", "turn_axis"):
        fields.number(name)
    stamp_s = fields.number("ipc_timestamp")
    fields.word("ipc_hostname")
    fields.number("logger_timestamp")
    fields.end()
    return Scan(start_rad, step_rad, maximum_m, np.array(ranges, np.float64), pose, stamp_s)


def read_log(path: Path) -> Iterator[Scan]:
    """Read the scans of a log, ``.log`` or ``.log.gz``.

    Raises
    ------
    MapFormatError : a line is malformed, time runs backwards, or there is no scan at all
    """
    raw = path.read_bytes()
    if path.suffix == ".gz":
        try:
            raw = gzip.decompress(raw)
        except (OSError, EOFError, zlib.error) as error:
            raise MapFormatError(path=path, field="gzip", reason=str(error)) from None
    stamp_s = -math.inf
    for line, text in enumerate(raw.splitlines(), 1):
        words = text.decode("ascii", "replace").split()
        if words[:1] != ["ROBOTLASER1"]:
            continue
        fields = Fields(path, line, words[1:])
        scan = read_scan(fields)
        if scan.stamp_s < stamp_s:
            raise fields.refuse("ipc_timestamp", f"expected {stamp_s} or later; found {scan.stamp_s}")
        stamp_s = scan.stamp_s
        yield scan
    if stamp_s == -math.inf:
        raise MapFormatError(path=path, field="ROBOTLASER1", reason="no line of this kind")


def all_around(scan: Scan) -> tuple[NDArray[np.float64], Pose2]:
    """The scan as the mapper wants it: ranges all around in even steps, and the pose whose heading is the first.

    What returned nothing counts as not seen. Taken for free, as in the simulation, it cuts rays through walls: a real
    laser gets nothing back from some of them, either.
    """
    beams = round(FINER * 2 * math.pi / scan.step_rad)
    turned = np.arange(beams) * (2 * math.pi / beams)
    nearest = ((turned + scan.step_rad / 2) % (2 * math.pi) // scan.step_rad).astype(np.int64)
    ranges_m = np.where(scan.ranges_m < scan.maximum_m, np.minimum(scan.ranges_m, REACH_M), NOT_SEEN_M)
    around_m = np.append(ranges_m, NOT_SEEN_M)[np.minimum(nearest, len(ranges_m))]
    return around_m, Pose2(scan.pose.x_m, scan.pose.y_m, wrap(scan.pose.yaw_rad + scan.start_rad))


def replay(path: Path, *, cell_m: float = 0.05, steps: int | None = None) -> Iterator[OccupancyGrid]:
    """The grids that the log's robot would have published, by the rule of ``Agent.publish_due``.

    Parameters
    ----------
    path : the log
    cell_m : metres a cell
    steps : end after so many grids; None: with the log

    Yields
    ------
    OccupancyGrid : the first scan's, then one whenever enough way or time on the way has passed, then the last

    Raises
    ------
    MapFormatError : as ``read_log``; or no scan saw anything
    """
    nothing = True
    for grid in itertools.islice(grids_of(read_log(path), cell_m=cell_m), steps):
        yield grid
        nothing = False
    if nothing:
        raise MapFormatError(path=path, field="ranges", reason="nothing returned in any scan")


def grids_of(scans: Iterable[Scan], *, cell_m: float = 0.05) -> Iterator[OccupancyGrid]:
    """The grids that a robot with these scans would have published: nothing of none that saw anything."""
    mapper = Mapper(Lidar(range_m=REACH_M), resolution_m=cell_m)
    before = None
    way_m, on_the_way_s = 0.0, 0.0
    due = True
    for scan in scans:
        if not scan.has_seen():
            continue  # nothing to map, and the mapper's grid can't grow by nothing
        if before is not None:
            moved_m = math.dist((before.pose.x_m, before.pose.y_m), (scan.pose.x_m, scan.pose.y_m))
            way_m += moved_m
            # The log doesn't tell whether the robot has a goal: it is on its way while its pose changes.
            if moved_m > STILL_M or abs(wrap(scan.pose.yaw_rad - before.pose.yaw_rad)) > STILL_RAD:
                on_the_way_s += scan.stamp_s - before.stamp_s
        mapper.add(*all_around(scan))
        due = before is None or way_m >= PUBLISH_EVERY_M or on_the_way_s >= PUBLISH_EVERY_S
        before = scan
        if due:
            yield mapper.grid()
            way_m, on_the_way_s = 0.0, 0.0
    if not due:
        yield mapper.grid()


def write_simulated(path: Path) -> OccupancyGrid:
    """Write the log of a simulated robot that turns on the spot and sees 270 degrees; its map."""
    rng = np.random.default_rng(0)
    world = make_world("office", size_m=10.0, seed=1)
    start = choose_starts(world, 1, radius_m=0.2, rng=rng)[0]
    lidar = Lidar(range_m=REACH_M)
    ahead = np.arange(-270, 270)  # of 720 beams
    mapper = Mapper(lidar)
    lines = ["# of a simulation"]
    for k in range(8):
        pose = Pose2(start.x_m, start.y_m, wrap(start.yaw_rad + 0.1 * k))
        ranges_m = lidar.scan(world, pose, rng=rng)
        around_m = np.full(lidar.beams, NOT_SEEN_M)
        around_m[ahead] = np.where(ranges_m < lidar.range_m, ranges_m, NOT_SEEN_M)[ahead]
        mapper.add(around_m, pose)
        step_rad = 2 * math.pi / lidar.beams
        head = f"0 {ahead[0] * step_rad} {len(ahead) * step_rad} {step_rad} {lidar.range_m} 0.02 0 {len(ahead)}"
        xyt = f"{pose.x_m} {pose.y_m} {pose.yaw_rad}"
        lines.append(f"ROBOTLASER1 {head} {' '.join(map(str, ranges_m[ahead]))} 0 {xyt} {xyt} 0 0 0 0 0 {k} robot {k}")
    path.write_bytes(gzip.compress("\n".join(lines).encode()))
    return mapper.grid()


def look(path: Path, out: Path | None) -> OccupancyGrid:
    """Print what a log holds and gives; the last map."""
    scans = list(read_log(path))
    places = np.array([(scan.pose.x_m, scan.pose.y_m) for scan in scans])
    way_m = float(np.hypot(*np.diff(places, axis=0).T).sum())
    grids = list(replay(path))
    known_m2 = float((grids[-1].states_yx() != UNKNOWN).sum()) * grids[-1].resolution_m ** 2
    name = path.name.removesuffix(".gz").removesuffix(".log")
    print(
        f"{name:26s}{len(scans):5d} scans of {len(scans[0].ranges_m)} beams, {way_m:.1f} m in "
        f"{scans[-1].stamp_s - scans[0].stamp_s:.0f} s: {len(grids)} publishes, {known_m2:.0f} m2 known",
        flush=True,
    )
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        save_map(grids[-1], out / f"{name}.yaml", image="png")
    return grids[-1]


def main() -> None:
    """Map each log, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", nargs="*", type=Path, default=[], help="logs instead of FLEETMAP_DATA's")
    parser.add_argument("--out", type=Path, help="folder for the last maps, as map_server's")
    parser.add_argument("--tiny", action="store_true", help="a simulated log: for the tests")
    options = parser.parse_args()
    if options.tiny:
        with tempfile.TemporaryDirectory() as temporary:
            path = Path(temporary) / "simulated.log.gz"
            expected = write_simulated(path)
            assert np.array_equal(look(path, options.out).cells_yx, expected.cells_yx)
        return
    paths = options.logs
    if not paths and (folder := os.environ.get("FLEETMAP_DATA")):
        paths = sorted(Path(folder).glob("logs/*.log.gz"))
    if not paths:
        parser.error("no logs: name some with --logs, or set FLEETMAP_DATA")
    for path in paths:
        look(path, options.out)


if __name__ == "__main__":
    main()
