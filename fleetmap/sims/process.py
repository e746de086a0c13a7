"""One robot of a simulated fleet in a process of its own: ``python -m fleetmap.sims.process NAME``.

It joins the fleet as any user's robot would, by ``fleetmap.join``; the parent only grants it time
(see ``pipe``).
"""

from __future__ import annotations

import asyncio
import logging
import math
import os
import signal
import sys
import threading
from contextlib import suppress
from dataclasses import asdict, astuple
from pathlib import Path

import numpy as np

from fleetmap.model.errors import FleetmapError
from fleetmap.model.lattice import FREE
from fleetmap.model.pose import Pose2
from fleetmap.peer import Peer, join
from fleetmap.sims.agent import Agent, Shared
from fleetmap.sims.config import HEARTBEAT_S, RobotProgress
from fleetmap.sims.explore import Explorer, Teammate
from fleetmap.sims.lidar import Lidar
from fleetmap.sims.pipe import MAX_LINE, line, parse
from fleetmap.sims.robot import Drive, Robot
from fleetmap.sims.worlds import World

GOAL_NEWS_M = 0.75
"""A goal nearer than this to the announced one is no news: half of what counts as the same place."""

ALIGN_S = 60.0
"""So long a round waits for what is found of where the others are: simulated time runs faster than that is found."""

EXIT_GRACE_S = 5.0
"""After the parent is gone, a process that has not ended by itself in this time is ended."""

logger = logging.getLogger(__name__)


class Child:
    """The robot, its peer, and the answers to the parent.

    Parameters
    ----------
    order : the parent's first message
    """

    def __init__(self, order: dict[str, object]) -> None:
        with np.load(str(order["world"])) as saved:
            world = World(saved["solid"], float(saved["resolution_m"]), Pose2(*saved["origin"].tolist()))
            self._sample_xy = saved["sample_xy"]
        start = Pose2(*(float(v) for v in order["start"]))  # type: ignore[attr-defined]
        rng = np.random.default_rng([int(str(order["seed"])), int(str(order["index"]))])
        self.name = str(order["robot"])
        lidar = Lidar(*(order[k] for k in ("range_m", "beams", "range_noise_m")))  # type: ignore[arg-type]
        drive = Drive(
            radius_m=float(str(order["radius_m"])),
            speed_mps=float(str(order["speed_mps"])),
            pose_noise_m=float(str(order["pose_noise_m"])),
        )
        self.robot = Robot(world, start, lidar, drive, rng)
        # Where the starts are known, the fleet's frame is the world's.
        known, self._T_world_robot = bool(order["known"]), start
        self.agent = Agent(self.robot, T_fleet_robot=start if known else Pose2(), explorer=Explorer(self.name))
        self.peer: Peer = join(
            self.name,
            fleet=str(order["fleet"]),
            start=start if known else None,
            # What the robots know of their starts is exact.
            start_sigma=(0.0, 0.0),
            connect=[str(order["endpoint"])],
            listen=[str(order["listen"])],
            profile="local",
            heartbeat_s=HEARTBEAT_S,
            # The robot asks for the fold when it is about to think; no other fold is needed.
            fold_interval_s=3600.0,
        )
        self._published = 0
        self._told_goal: tuple[float, float] | None = None

    async def answer(self, message: dict[str, object]) -> dict[str, object]:
        """What the parent's message asks for."""
        match message:
            case {"go": until_s}:
                return await self.go(float(str(until_s)))
            case {"settle": _}:
                if self.agent.unpublished:
                    await self.publish()
                return {"published": True}
            case {"sync": timeout_s}:
                return await self.sync(float(str(timeout_s)))
            case {"write": path}:
                return await self.write(Path(str(path)))
        raise ValueError(f"unknown message {message}")

    async def go(self, until_s: float) -> dict[str, object]:
        """Explore until ``until_s`` of simulated time, publishing when it is time to."""
        with suppress(TimeoutError):  # what isn't found in time is found in a later round
            await self.peer.aligned(ALIGN_S)
        await self.take_in()
        while self.agent.now_s < until_s - 1e-6:
            await asyncio.to_thread(self.agent.advance, until_s)
            if self.agent.publish_due:
                await self.publish()
            await self.tell_goal()
        return asdict(self.progress())

    async def publish(self) -> None:
        """Publish the own grid, say where the robot is, and take in what the others have said meanwhile."""
        pose = self.robot.believed
        await self.peer.publish(self.robot.mapper.grid())
        await self.peer.set_pose(pose)
        self._published += 1
        self.agent.published()
        await self.take_in()

    async def take_in(self) -> None:
        """The merged map and the teammates, as they are now."""
        merged = await self.peer.refresh()
        if not self._published and self.peer.T_merged_robot is None:
            return  # without a map of its own it is shown that of others, and doesn't know where it lies in it
        self.agent.find_itself(self.peer.T_merged_robot or Pose2())
        mates = [
            Teammate(mate.robot, (mate.pose.x_m, mate.pose.y_m), mate.goal_xy)
            for mate in self.peer.teammates(frame="fleet")
            if mate.pose is not None
        ]
        self.agent.shared = Shared(merged, mates)

    async def tell_goal(self) -> None:
        """Announce a goal that is new; staying near one costs nothing."""
        goal = self.agent.goal_xy
        told = self._told_goal
        if goal == told or (goal is not None and told is not None and math.dist(goal, told) < GOAL_NEWS_M):
            return
        self._told_goal = goal
        x, y = self.agent.T_fleet_robot.inverse().apply(goal if goal is not None else (0.0, 0.0))
        await self.peer.set_goal(None if goal is None else (float(x), float(y)))

    def progress(self) -> RobotProgress:
        """The figures of now, and the way since the last ones."""
        sizes = self.peer.stats()
        trail, self.agent.trail_xy = self.agent.trail_xy, []
        return RobotProgress(
            robot=self.name,
            pid=os.getpid(),
            state="idle" if self.agent.idle else "exploring",
            t_s=self.agent.now_s,
            x_m=self.robot.pose.x_m,
            y_m=self.robot.pose.y_m,
            covered=self.covered(),
            distance_m=self.robot.distance_m,
            collisions=self.robot.collisions,
            published=self._published,
            bytes_vector=sizes.bytes_vector,
            bytes_deltas=sizes.bytes_deltas,
            bytes_grid_gzip_full=sizes.baselines.get("grid_gzip_full", 0),
            bytes_grid_gzip_updates=sizes.baselines.get("grid_gzip_updates", 0),
            bytes_grid_exact_updates=sizes.baselines.get("grid_exact_updates", 0),
            sent={kind: count.to_json() for kind, count in sizes.sent.items()},
            grids={name: count.to_json() for name, count in sizes.grids.items()},
            explored_m2=sizes.explored_m2,
            members=len({robot for robot, _ in self.peer.revisions} | {self.name}),
            trail_xy=tuple((round(x, 3), round(y, 3)) for x, y in trail),
            frame=self.peer.frame,
            T_merged_robot=astuple(self.peer.T_merged_robot or Pose2()),
        )

    def covered(self) -> float:
        """Share of the sampled reachable cells that were free when the robot last looked at the map."""
        view = self.agent.view
        if view is None:
            return 0.0
        sample_xy = (self.agent.T_fleet_robot @ self._T_world_robot.inverse()).apply(self._sample_xy)
        cells = np.floor(sample_xy[:, ::-1] / view.resolution_m).astype(int) - view.low_yx
        inside = ((cells >= 0) & (cells < view.states_yx.shape)).all(axis=1)
        cells = cells[inside]
        return float((view.states_yx[cells[:, 0], cells[:, 1]] == FREE).sum() / len(self._sample_xy))

    async def sync(self, timeout_s: float) -> dict[str, object]:
        """The merged map of all that living peers hold, as digest and revisions; what is missing if it takes long."""
        try:
            await self.peer.aligned(timeout_s)
            merged = await self.peer.synced(timeout_s)
        except TimeoutError as error:
            return {"digest": "", "revisions": [], "missing": str(error)}
        revisions = [[robot, f"{r.life:016x}", r.seq, f"{r.digest:016x}"] for robot, r in self.peer.revisions]
        return {"digest": merged.digest, "revisions": revisions}

    async def write(self, path: Path) -> dict[str, object]:
        """Save the merged map."""
        from fleetmap.codecs.fmap import save_fmap

        await asyncio.to_thread(save_fmap, self.peer.merged, path)
        return {"edges": len(self.peer.merged), "frame": self.peer.frame, "stats": self.peer.stats().to_json()}


async def serve(name: str) -> None:
    """Read the parent's messages until it closes the pipe; leave the fleet in any case."""
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader(limit=MAX_LINE)
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)

    def say(message: dict[str, object]) -> None:
        sys.stdout.buffer.write(line(message))
        sys.stdout.buffer.flush()

    child = Child(parse(await reader.readline()))
    async with child.peer:
        say({"ready": True})
        coming = asyncio.ensure_future(reader.readline())
        while (raw := await coming) and "close" not in (message := parse(raw)):
            coming = asyncio.ensure_future(reader.readline())
            answer = asyncio.ensure_future(child.answer(message))
            # Anything that comes while the robot is at work, or the pipe's end, means that nobody waits for it.
            await asyncio.wait({answer, coming}, return_when=asyncio.FIRST_COMPLETED)
            if not answer.done():
                answer.cancel()
                break
            say(answer.result())
        coming.cancel()
        end_soon()
    logger.info("%s: left the fleet", name)


def end_soon() -> None:
    """Make sure that this process ends, whatever its threads still do."""
    timer = threading.Timer(EXIT_GRACE_S, os._exit, (0,))
    timer.daemon = True
    timer.start()


def main() -> None:
    """Run one robot; its log goes to stderr."""
    # Ctrl-C reaches the whole process group: the parent decides how it ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    try:
        asyncio.run(serve(sys.argv[1]))
    except FleetmapError as error:
        logger.error("%s: %s", sys.argv[1], error)
        sys.exit(1)


if __name__ == "__main__":
    main()
