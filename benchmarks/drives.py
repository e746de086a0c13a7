"""A recorded drive as a fleet: when robots that don't know where they started find that they are in one building.

Each log is cut into as many stretches of equal way as there are robots; no two share a scan. Each robot drives its
stretch from a frame of its own, all at once, in memory, and publishes as a simulated one does. After each round every
pair that is due is looked at. Prints for each log and number of robots, round by round where something changed, which
robots have found each other; what was said of the pairs that hadn't, the last time; after how much way of each robot
they were one; and how far off the robots then are along their whole ways, by the poses of the log: where these are raw
odometry, they bend the maps, too, and there is no truth to be had.

    python benchmarks/drives.py [--logs LOG...] [--robots 2 3] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import os
import tempfile
from collections.abc import Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from carmen import Scan, grids_of, read_log, write_simulated
from numpy.typing import NDArray

import fleetmap
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.pose import Pose2
from fleetmap.peer import Peer
from fleetmap.peer.memory_link import LoopClock, MemoryHub

PATIENCE_S = 120.0
STANDING_M = 1e-6
"""A scan counts as so much way at least, so that one who only turns has a way, too."""


@dataclass(frozen=True)
class Drive:
    """One robot's stretch.

    Parameters
    ----------
    T_log_robot : where the robot starts in the log's frame
    places_xy : (n, 2) metres: where it went, in its own frame
    grids : what it publishes
    """

    T_log_robot: Pose2
    places_xy: NDArray[np.float64]
    grids: Sequence[OccupancyGrid]


def way_m(scans: Sequence[Scan]) -> NDArray[np.float64]:
    """(n,) metres driven before each scan."""
    places = np.array([(scan.pose.x_m, scan.pose.y_m) for scan in scans])
    return np.concatenate([[0.0], np.hypot(*np.diff(places, axis=0).T).cumsum()])


def cut(scans: Sequence[Scan], robots: int) -> list[Drive]:
    """A log as several robots' drives, each in the frame of its first scan."""
    progress = way_m(scans) + np.arange(len(scans)) * STANDING_M
    share = np.minimum((progress / progress[-1] * robots).astype(int), robots - 1)
    drives = []
    for k in range(robots):
        part = [scan for scan, of in zip(scans, share, strict=True) if of == k]
        T_log_robot = part[0].pose
        own = [replace(scan, pose=T_log_robot.inverse() @ scan.pose) for scan in part]
        places = np.array([(scan.pose.x_m, scan.pose.y_m) for scan in own])
        drives.append(Drive(T_log_robot, places, list(grids_of(own))))
    return drives


def groups(peers: Sequence[Peer]) -> list[str]:
    """Which robots have found each other, as the first one that is in a group sees it."""
    frames: dict[str, list[str]] = {}
    for peer in peers:
        frames.setdefault(peer.frame, []).append(peer.robot)
    return sorted("+".join(robots) for robots in frames.values())


def off_m(peers: Sequence[Peer], drives: Sequence[Drive]) -> list[float]:
    """For each pair of one group: how far off the second one's way is at most, as the first one sees it."""
    found = []
    for (a, one), (b, other) in combinations(zip(peers, drives, strict=True), 2):
        if a.frame == b.frame and a.T_merged_robot is not None and b.T_merged_robot is not None:
            T_a_b = a.T_merged_robot.inverse() @ b.T_merged_robot
            truth = one.T_log_robot.inverse() @ other.T_log_robot
            apart = T_a_b.apply(other.places_xy) - truth.apply(other.places_xy)
            found.append(round(float(np.hypot(*apart.T).max()), 3))
    return found


def said(peers: Sequence[Peer]) -> dict[str, str]:
    """Of each pair that isn't merged, what was found."""
    found = {}
    for alignment in peers[0].alignments:
        if alignment.outcome != "committed":
            found[f"{alignment.a[0]}-{alignment.b[0]}"] = f"{alignment.outcome}: {alignment.text}"
    return found


async def settle(peers: Sequence[Peer]) -> None:
    """Until all pairs that are due are looked at, what was found is confirmed, and all know it."""
    for _ in range(3):  # one finds, another one confirms, and with one map more again
        for peer in peers:
            await peer.aligned(PATIENCE_S)
        for peer in peers:
            await peer.synced(PATIENCE_S, at_least=len(peers) - 1)


async def fleet(drives: Sequence[Drive]) -> dict[str, Any]:
    """What comes of it."""
    hub = MemoryHub(LoopClock())
    way = [float(np.hypot(*np.diff(drive.places_xy, axis=0).T).sum()) for drive in drives]
    rounds: list[dict[str, Any]] = []
    one: float | None = None
    async with AsyncExitStack() as stack:
        names = [f"r{k + 1}" for k in range(len(drives))]
        peers = [await stack.enter_async_context(fleetmap.join(name, link=hub.link(name))) for name in names]
        most = max(len(drive.grids) for drive in drives)
        for k in range(most):
            for peer, drive in zip(peers, drives, strict=True):
                if k < len(drive.grids):
                    await peer.publish(drive.grids[k])
            await settle(peers)
            now = groups(peers)
            if not rounds or rounds[-1]["together"] != now:
                driven_m = round(float(np.mean(way)) * (k + 1) / most, 1)
                before = rounds[-1]["apart"] if rounds else {}
                rounds.append({"driven_m": driven_m, "together": now, "off_m": off_m(peers, drives), "before": before})
                one = driven_m if len(now) == 1 else None
            rounds[-1]["apart"] = said(peers)
        return {
            "way_m": [round(metres, 1) for metres in way],
            "publishes": [len(drive.grids) for drive in drives],
            "one_after_m": one,
            "off_m_in_the_end": off_m(peers, drives),
            "apart_in_the_end": said(peers),
            "rounds": rounds,
        }


def show(name: str, found: dict[str, Any]) -> None:
    """One log and number of robots, for people."""
    one = "never one" if found["one_after_m"] is None else f"one after {found['one_after_m']} m each"
    ways = ", ".join(f"{metres:.0f} m" for metres in found["way_m"])
    print(
        f"{name}: {len(found['way_m'])} robots ({ways}): {one}; off at most {found['off_m_in_the_end']} m", flush=True
    )
    for each in found["rounds"]:
        print(f"  {each['driven_m']:5.1f} m: {', '.join(each['together'])}")
        for pair, text in each["before"].items():
            print(f"           before, {pair}: {text}")
    for pair, text in found["apart_in_the_end"].items():
        print(f"    in the end, {pair}: {text}")


def main() -> None:
    """Drive them all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", nargs="*", type=Path, default=[], help="logs instead of FLEETMAP_DATA's")
    parser.add_argument("--robots", nargs="*", type=int, default=[2, 3])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--tiny", action="store_true", help="a simulated log: for the tests")
    options = parser.parse_args()
    logging.getLogger("fleetmap").setLevel(logging.ERROR)  # what isn't merged yet is printed here
    paths = options.logs
    if not paths and not options.tiny and (folder := os.environ.get("FLEETMAP_DATA")):
        paths = sorted(Path(folder).glob("logs/*.log.gz"))
    document: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as temporary:
        if options.tiny:
            paths, options.robots = [Path(temporary) / "simulated.log.gz"], [2]
            write_simulated(paths[0])
        if not paths:
            parser.error("no logs: name some with --logs, or set FLEETMAP_DATA")
        for path in paths:
            name = path.name.removesuffix(".gz").removesuffix(".log")
            scans = [scan for scan in read_log(path) if scan.has_seen()]
            for robots in options.robots:
                found = asyncio.run(fleet(cut(scans, robots)))
                document[f"{name}, {robots} robots"] = found
                if not options.json:
                    show(name, found)
    if options.json:
        print(json.dumps(document, indent=1))


if __name__ == "__main__":
    main()
