"""``Peer``: one robot in the fleet, for asyncio. A thin shell: the engine decides, the link carries.

The engine runs in a thread of its own, one call at a time, and the fold in another, so that the event loop
never waits for either.
"""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Generator, Iterable
from contextlib import suppress
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, ParamSpec, Self, TypeVar

from fleetmap.accounting import Ledger, Stats
from fleetmap.codecs.facts import FactsStep, Seen, set_landmark, set_sighting
from fleetmap.codecs.names import check_name
from fleetmap.engine import (
    Alive,
    Answer,
    Ask,
    Chain,
    Engine,
    Event,
    Input,
    LifeChanged,
    LookAgain,
    MapChanged,
    PeersChanged,
    Put,
    Reply,
    ReplyEnd,
    Stream,
)
from fleetmap.engine.neighbours import MAX_NEIGHBOURS
from fleetmap.engine.quota import Quota
from fleetmap.engine.view import View, view
from fleetmap.model.checks import check_count, check_number, check_type, check_xy
from fleetmap.model.errors import ConfigError, FleetmapError, LinkError, NameInUse, NoPath
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.grid_like import GridLike, as_grid
from fleetmap.model.kernel_cache import AGENT, modules_of
from fleetmap.model.kernel_compiler import compile_in_thread
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.threads import ProcessEnds, Worker, in_thread, may_be_dropped
from fleetmap.model.vectormap import VectorMap
from fleetmap.peer.aligner import Aligner
from fleetmap.peer.alignments import AlignmentInfo, alignment_infos
from fleetmap.peer.changes import Change, ChangeQueue, RevisionVector
from fleetmap.peer.figures import own_figures
from fleetmap.peer.folder import Folder
from fleetmap.peer.health import Problem, problems
from fleetmap.peer.inbox import Inbox
from fleetmap.peer.info import (
    PeerInfo,
    TeammateInfo,
    is_fleet,
    maps_of,
    peer_infos,
    placed_in,
    teammate_infos,
)
from fleetmap.peer.link import Link, Network
from fleetmap.peer.namesake import answers
from fleetmap.peer.options import HOW_TO_POSE, JoinOptions, fixed_pose, micro
from fleetmap.peer.pairs import Snapshot, snapshot
from fleetmap.peer.profiles import HEARTBEAT_S
from fleetmap.peer.publisher import GridPublisher

if TYPE_CHECKING:
    from fleetmap.planners.protocol import Path

logger = logging.getLogger(__name__)

TICK_S = 0.1
SLICE = 64
"""Items that the engine takes at a time: between two slices the user has a turn."""
HEALTH_S = 1.0
"""Between two looks for what is wrong."""
LOOK_PAUSE_S = 1.0
"""At least so long between two looks at all tokens."""
LAST_WORD_S = 0.3
"""So long ``close`` waits for the engine to say what it held back; it may be in a kernel, which can't be stopped."""

NOT_OPEN = {
    "new": "the peer is not connected yet: `async with fleetmap.join(...) as peer`, or `peer = await join(...)`",
    "closed": "the peer is closed: join again",
    "forked": "the peer is in the process that this one was forked from: no thread of it runs here",
}

P = ParamSpec("P")
R = TypeVar("R")


class Peer:
    """A robot of the fleet. Made by ``fleetmap.join``; use it as ``async with``, or await it and ``close`` it.

    Parameters
    ----------
    options : what ``join`` was told
    link : the transport
    seed : 16 random bytes, of which the life is made; never shown
    clock : seconds, only ever growing

    Attributes
    ----------
    stepped : notified after everything that the engine did, for programs that wait for a state of ``peers``
    """

    def __init__(
        self, options: JoinOptions, *, link: Link, seed: bytes, clock: Callable[[], float] = time.monotonic
    ) -> None:
        robot = options.robot
        self.robot, self.fleet, self.level = robot, options.fleet, options.level
        self._clock, self._link, self._if_taken = clock, link, options.if_taken
        self._ledger = Ledger()
        self._engine = Engine(
            robot,
            chain=Chain(seed),
            level=options.level,
            start=fixed_pose("start", options.start),
            start_sigma=options.start_sigma_micro,
            heartbeat_s=options.heartbeat_s or HEARTBEAT_S[options.profile],
            quota=Quota(options.budget_Bps, options.max_rate_hz),
            ledger=self._ledger,
            allow=options.allow,
            limits=options.limits,
        )
        self._publisher = GridPublisher(self._ledger, baselines=options.baselines, robot=robot)
        self._folder = Folder(robot, self._look, interval_s=options.fold_interval_s, clock=clock)
        self._aligner = Aligner(robot, look=self._look_at_pairs, say=self._say, clock=clock)
        self.stepped, self._steps = asyncio.Condition(), 0
        self._look_due = asyncio.Event()
        self._network = Network(reached=not options.connect)
        self._connect = ", ".join(options.connect)
        self._tasks: list[asyncio.Task[None]] = []
        self._failure: FleetmapError | None = None
        self._state = "new"
        self._closing: asyncio.Task[None] | None = None

    # Life

    def __await__(self) -> Generator[object, None, Self]:
        """``peer = await fleetmap.join(...)``; call ``close`` when done."""
        return self._open().__await__()

    async def __aenter__(self) -> Self:
        return await self._open()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def _open(self) -> Self:
        if self._state != "new":
            raise LinkError(endpoint=self.fleet, reason="a peer can be opened once; call join again")
        self._state, self._opened_s, self._pid = "open", self._clock(), os.getpid()
        self._worker = Worker(f"fleetmap-{self.robot}")
        self._inbox = Inbox(asyncio.get_running_loop(), self._ledger, self._figures)
        try:
            # Now: a peer that lives can't stop for a minute when the first record comes.
            await compile_in_thread(modules_of(*AGENT))
            tokens = await self._link.open(self._inbox)
            # Alone: whoever runs never gives way, and a token is no proof that somebody runs.
            namesakes = [token for token in tokens if token[0] == self.robot]
            if self._if_taken == "refuse" and await answers(self._link, namesakes):
                raise NameInUse(robot=self.robot, fleet=self.fleet)
            await self._link.show(self._engine.own.life)
            for token in tokens:
                self._inbox.deliver(Alive(*token))
            works = (self._pump, self._look_for_tokens, self._look_after, self._folder.run, self._aligner.run)
            self._tasks = [asyncio.create_task(self._guard(work)) for work in works]
            for task in self._tasks:
                task.add_done_callback(_look_at)
                may_be_dropped(task)
            await asyncio.sleep(0)  # they begin: cancelled before, they would leave the peer open
        except BaseException:
            await self.close()
            raise
        return self

    async def close(self) -> None:
        """Leave the fleet; the map stays with the others. May be called twice; goes on if the caller gives up."""
        self._look_for_fork()
        if self._state == "open":
            # Before the state: a task that asked the engine once more would take the closed peer for a failure.
            for task in self._tasks:
                task.cancel()
            self._closing = asyncio.ensure_future(self._leave())
        if self._state != "forked":
            self._state = "closed"
        if self._closing is not None and not self._closing.done():
            await asyncio.shield(self._closing)

    async def _leave(self) -> None:
        def send_waiting() -> None:
            self._engine.send_waiting(self._clock())
            self._carry_out()

        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._tasks and self._failure is None:
            with suppress(TimeoutError):
                async with asyncio.timeout(LAST_WORD_S):
                    await self._worker.run(send_waiting)
        self._inbox.close()
        await self._link.close()
        self._worker.stop()
        self._folder.close()
        await self._notify()

    # Say

    async def publish(
        self,
        source: GridLike | VectorMap,
        *,
        resolution_m: float | None = None,
        origin: Pose2 | None = None,
        submap: str = "0",
        anchor: Pose2 | FixedPose | None = None,
        supersedes: bool = False,
        free_below: float | None = None,
        occupied_above: float | None = None,
    ) -> bool:
        """Share a map. A grid is vectorized; what changed since the last one goes to the fleet.

        Parameters
        ----------
        source : the submap as it is now: an ``OccupancyGrid``, anything shaped like ``nav_msgs/OccupancyGrid``, an
            array (height, width) with ``resolution_m``, the path of a map_server YAML, or a ``VectorMap``
        resolution_m, origin : of an array: metres a cell, and where the lower left corner of cell (0, 0) lies
        submap : its name, for robots that have several
        anchor : T_robot_submap; a correction of it resends no geometry
        supersedes : this map replaces what the own former lives said: they end with it, at every peer
        free_below, occupied_above : per cent, instead of the grid's own; see ``OccupancyGrid``. The first grid of a
            submap whose thresholds leave hardly any free or occupied cell is warned of, with ``MapWarning``

        Returns
        -------
        bool : False if nothing changed, and so nothing is sent. With a budget or a highest rate it may be sent later:
            then it is the difference to what was sent last, and what came between is left out.

        Raises
        ------
        LinkError : the peer is closed
        ConfigError, MapFormatError : the map or a name is not what it must be; or the map has more edges than a peer
            takes (``max_edges`` and ``max_edges_in_square`` of ``join``); or it would extend farther than
            5243 m, by itself or together with another map of its component: more than the fleet lattice holds.
            Wherever that lies: 500 km from the origin are fine
        """
        self._check()
        check_name("submap", submap)
        fixed = fixed_pose("anchor", anchor) or FixedPose()
        if isinstance(source, VectorMap):
            of_grids = {"free_below": free_below, "occupied_above": occupied_above, "resolution_m": resolution_m}
            for option, value in {**of_grids, "origin": origin}.items():
                if value is not None:
                    raise ConfigError(option=option, value=value, reason="is for grids; a vector map has states only")
            given: OccupancyGrid | VectorMap = source
        else:
            read = partial(as_grid, source, resolution_m=resolution_m, origin=origin)
            # An array is copied now: the caller may use it again as soon as this gives way.
            grid = await in_thread(read) if isinstance(source, str | os.PathLike) else read()
            given = grid.with_thresholds(free_below=free_below, occupied_above=occupied_above)
        return await self._publisher.publish(
            submap, given, partial(self._run_publish, fixed, supersedes), clock=self._clock
        )

    async def set_pose(self, pose: Pose2) -> None:
        """Announce where the robot is, in its map frame. It goes within a twentieth of ``heartbeat_s``."""
        self._check()
        check_type("pose", pose, Pose2, hint=HOW_TO_POSE)
        await self._run(self._engine.set_pose, pose.x_m, pose.y_m, pose.yaw_rad)

    async def set_goal(self, goal_xy: tuple[float, float] | None) -> None:
        """Announce where the robot is going, in its map frame; None: nowhere."""
        self._check()
        goal_xy = None if goal_xy is None else check_xy("goal_xy", goal_xy)
        await self._run(self._engine.set_goal, goal_xy)

    async def set_start(self, start: Pose2 | FixedPose | None) -> None:
        """Announce where the own map frame lies in the fleet's.

        Raises
        ------
        ConfigError : it is more than 17592 km from the origin, or the own maps would extend farther than 5243 m
            together with another map of the component
        """
        self._check()
        await self._run(self._engine.set_start, fixed_pose("start", start))

    async def saw(self, robot: str, pose: Pose2, *, sigma: tuple[float, float] = (0.3, 0.2)) -> None:
        """Say where a living teammate is, in the own map frame, that was seen just now: its map lies accordingly.

        Parameters
        ----------
        sigma : standard deviations: metres along each axis, and radians

        Raises
        ------
        ConfigError : it hasn't announced where it is in its own map (``set_pose``), or a number is none
        """
        self._check()
        there, exactness = _fixed("pose", pose), micro("sigma", sigma)
        check_name("robot", robot)

        def say() -> None:
            mate = self._engine.teammates.by_name.get(robot)
            if mate is None or mate.pose is None:
                raise ConfigError(option="robot", value=robot, reason="expected a teammate that announces its pose")
            x_mm, y_mm, yaw_mrad = mate.pose
            T_mate_there = FixedPose.from_pose(Pose2(x_mm * 1e-3, y_mm * 1e-3, yaw_mrad * 1e-3))
            self._engine.say(set_sighting(robot, mate.life, Seen(there, exactness, T_mate_there)))

        await self._run(say)

    async def saw_landmark(self, name: str, pose: Pose2 | None, *, sigma: tuple[float, float] = (0.1, 0.05)) -> None:
        """Say where a landmark is in the own map frame, as a tag on a wall; None: that isn't known any more.

        Where another robot has seen the same one, their maps are looked for accordingly.

        Parameters
        ----------
        sigma : standard deviations: metres along each axis, and radians

        Raises
        ------
        ConfigError : it is no name, or a number is none
        """
        self._check()
        seen = None if pose is None else Seen(_fixed("pose", pose), micro("sigma", sigma))
        await self._run(self._engine.say, set_landmark(name, seen))

    async def forget(self, robot: str, *, everywhere: bool = False) -> None:
        """Leave what a robot has said so far out of the merged map. One that lives is back with its next word.

        Parameters
        ----------
        robot : whose. The own name: what the own former lives said ends, at every peer. To be called when a robot that
            started anew sees free space where a former life saw a wall that is gone
        everywhere : at every peer, and not only here; the others still hold the map, and who forgets the forgetting
            robot has it back. A robot that lives hears of it, and stays in the map

        Raises
        ------
        ConfigError : no map of that robot is held
        """
        self._check()
        check_name("robot", robot)
        await self._run(self._engine.forget, robot, everywhere=everywhere)

    # See

    @property
    def merged(self) -> MergedMap:
        """The merged map of the own component as it was folded last; ``refresh`` brings it up to date."""
        return self._folder.merged

    @property
    def revisions(self) -> RevisionVector:
        """What ``merged`` was made of."""
        return self._folder.revisions

    @property
    def life(self) -> int:
        """Which run of this robot's map frame it is: 64 random bits, drawn when it joined."""
        return self._engine.own.life

    @property
    def T_fleet_robot(self) -> Pose2 | None:  # noqa: N802 - the field's notation
        """Where the own map frame lies in the fleet's; None while it is unknown."""
        return placed_in(self._engine).get(self._engine.own.key)

    @property
    def T_merged_robot(self) -> Pose2 | None:  # noqa: N802 - the field's notation
        """The same as ``merged`` was folded: where robots have found each other since, that is in another frame."""
        placed = self._folder.view.T_merged_robot
        return None if placed is None else placed.to_pose()

    @property
    def frame(self) -> str | None:
        """Whose map frame ``merged`` has, of robots that found each other; None: the fleet's, that of the starts."""
        return self._folder.view.frame

    @property
    def T_view_fleet(self) -> Pose2:  # noqa: N802 - the field's notation
        """From the frame of ``merged`` into one that doesn't jump: as the own start has it, or else the own map frame.

        When robots find each other, the frame of ``merged`` may become another one's.
        """
        own, placed = self._engine.own, self.T_merged_robot
        if placed is None:
            return Pose2()
        return (own.start.to_pose() if own.start is not None else Pose2()) @ placed.inverse()

    @property
    def alignments(self) -> list[AlignmentInfo]:
        """What was found of each pair of frames, by whichever robot looked: where one lies in the other, or why not."""
        return alignment_infos(self._engine)

    @property
    def peers(self) -> list[PeerInfo]:
        """All other robots that are known, living and absent, by name."""
        return peer_infos(self._engine)

    @property
    def maps(self) -> dict[str, dict[str, VectorMap]]:
        """By robot, the submaps of all others as they are held now, each in its own frame.

        Of the life that runs, or of an absent robot the one with the most edges.
        """
        return maps_of(self._engine)

    @property
    def streams(self) -> tuple[Stream, ...]:
        """All that is held of all robots and the own one, life by life, as values that never change."""
        held = {stream.key: stream for stream in (*self._engine.holdings.streams(), self._engine.own)}
        return tuple(stream for _, stream in sorted(held.items()))

    def teammates(self, *, frame: str = "robot") -> list[TeammateInfo]:
        """Living robots with the pose and the goal that they announced last.

        Parameters
        ----------
        frame : ``robot`` for the own map frame, ``fleet`` for the fleet's. A robot whose frame has no known
            relation to it is left out.
        """
        return teammate_infos(self._engine, frame=frame, now_s=self._clock())

    def stats(self) -> Stats:
        """Bytes sent, received and dropped, and what gzipped grids would have cost."""
        return self._ledger.stats()

    def health(self) -> tuple[Problem, ...]:
        """What is wrong now, in words that say what to do; empty if nothing is. Any thread may ask."""
        return problems(self._engine, self._folder.left_out, self._network.problems)

    async def changes(self) -> AsyncGenerator[Change, None]:
        """What any robot's new map did to the merged one; ``merged`` holds it when the change is yielded.

        A reader that is slow gets one value for all that it missed. Ends when the peer is closed.

        Raises
        ------
        LinkError : the peer is not connected yet
        """
        if self._state == "new":
            self._check()
        reader = ChangeQueue()
        self._folder.readers.add(reader)
        if self._state == "closed" or self._failure is not None:
            reader.close()
        try:
            while (change := await reader.take()) is not None:
                yield change
            if self._failure is not None:
                raise self._failure
        finally:
            self._folder.readers.discard(reader)

    async def refresh(self) -> MergedMap:
        """Fold all that is held now; ``merged`` is that map afterwards."""
        self._check()
        return await self._folder.refresh()

    async def aligned(self, timeout_s: float = 10.0) -> None:
        """Wait until this robot has looked at every pair of maps that is its to look at, as they are now.

        Raises
        ------
        TimeoutError : there are more than it can look at in that time
        """
        self._check()
        check_number("timeout_s", timeout_s, expected="seconds, 0 or more", fits=lambda s: s >= 0)
        try:
            async with asyncio.timeout(timeout_s):
                await self._aligner.idle()
        except TimeoutError:
            raise TimeoutError(
                f"{self.robot}: after {timeout_s} s some pairs of maps are still to be looked at"
            ) from None

    async def synced(self, timeout_s: float = 10.0, *, at_least: int = 0) -> MergedMap:
        """Wait until all that living peers hold now is held here, too; returns the merged map of it.

        Parameters
        ----------
        timeout_s : how long to wait
        at_least : so many living peers must be seen first

        Raises
        ------
        TimeoutError : something is still missing, or disputed among the others, or nobody was ever reached at the
            endpoints of ``connect``; the message says what
        """
        self._check()
        check_number("timeout_s", timeout_s, expected="seconds, 0 or more", fits=lambda s: s >= 0)
        check_count("at_least", at_least, most=MAX_NEIGHBOURS)

        def missing() -> list[str]:
            seen = len(self._engine.living() - {self.robot})
            if self._connect and not self._engine.living():
                why = [problem.text for problem in self._network.problems]
                if why or not self._network.reached:
                    return why or [f"anybody at {self._connect}"]
            return [f"{at_least - seen} more peers"] if seen < at_least else self._engine.lacking()

        await self._run(self._ask_lists)
        lacking: list[str] = []
        try:
            async with asyncio.timeout(timeout_s):
                while True:
                    step = self._steps
                    lacking = await self._read(missing)
                    self._check()
                    if not lacking:
                        break
                    async with self.stepped:
                        await self.stepped.wait_for(lambda: self._steps != step)  # noqa: B023 - awaited here
        except TimeoutError:
            raise TimeoutError(f"{self.robot}: after {timeout_s} s still missing: {', '.join(lacking)}") from None
        return await self.refresh()

    def plan(
        self,
        start_xy: tuple[float, float],
        goal_xy: tuple[float, float],
        *,
        radius_m: float,
        margin_m: float = 0.0,
        frame: str = "robot",
    ) -> Path:
        """A path on ``merged`` for a disc of that radius; ``refresh`` brings that up to date.

        Parameters
        ----------
        start_xy, goal_xy : metres, in the own map frame, or in the fleet's with ``frame="fleet"``
        radius_m, margin_m : distance to keep from every obstacle edge

        Raises
        ------
        NoPath : its ``status`` says why
        """
        from fleetmap.peer.planning import plan_in_frame

        start_xy, goal_xy = check_xy("start_xy", start_xy), check_xy("goal_xy", goal_xy)
        T_merged_robot = self.T_merged_robot or Pose2()
        T_frame_merged = Pose2() if is_fleet(frame) else T_merged_robot.inverse()
        if not self._folder.folded:
            raise NoPath(
                status="outside",
                reason="nothing has been merged yet: call refresh(), or wait for changes(), and plan then",
            )
        if not is_fleet(frame) and self.T_merged_robot is None and self.frame != self.robot:
            raise NoPath(
                status="outside",
                reason="this robot has neither a map nor a start, and nothing says where it lies in the merged map: "
                'publish a map, or plan in the frame of that, with frame="fleet"',
            )
        try:
            return plan_in_frame(
                self.merged, start_xy, goal_xy, T_frame_fleet=T_frame_merged, radius_m=radius_m, margin_m=margin_m
            )
        except NoPath as error:
            if self._folder.is_of(view(self._engine)):
                raise
            reason = f"{error.reason}; maps have changed since these were merged: call refresh(), and plan again"
            raise NoPath(status=error.status, reason=reason) from None

    # How it works

    def _check(self) -> None:
        self._look_for_fork()
        if self._failure is not None:
            raise self._failure
        if self._state != "open":
            raise LinkError(endpoint=self.fleet, reason=NOT_OPEN[self._state])

    def _look_for_fork(self) -> None:
        if self._state == "open" and self._pid != os.getpid():
            self._state = "forked"

    async def _run(self, call: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Run an engine call in the engine's thread, then do what came out of it, even if the caller gives up."""

        def run() -> tuple[R, list[Event]]:
            result = call(*args, **kwargs)
            return result, self._carry_out()

        async def finish() -> R:
            result, events = await self._read(run)
            await self._handle(events)
            return result

        task = asyncio.ensure_future(finish())
        may_be_dropped(task)
        return await asyncio.shield(task)

    async def _read(self, call: Callable[[], R]) -> R:
        """Ask the engine something, in its thread: nothing changes meanwhile."""
        if self._state != "open":
            raise LinkError(endpoint=self.fleet, reason=NOT_OPEN[self._state])
        return await self._worker.run(call)

    def _figures(self) -> bytes:
        told = [problem.text for problem in self.health()]
        return own_figures(self._engine, told, age_s=self._clock() - self._opened_s)

    async def _look(self) -> View:
        return await self._read(partial(view, self._engine))

    async def _look_at_pairs(self) -> Snapshot:
        return await self._read(partial(snapshot, self._engine))

    async def _say(self, step: FactsStep) -> None:
        await self._run(self._engine.say, step)

    async def _run_publish(self, anchor: FixedPose, supersedes: bool, submap: str, vector_map: VectorMap) -> bool:
        return await self._run(
            self._engine.publish, submap, vector_map, anchor=anchor, supersedes=supersedes, now_s=self._clock()
        )

    def _ask_lists(self) -> None:
        self._engine.ask_lists(now_s=self._clock())
        self._engine.tick(self._clock())

    def _carry_out(self) -> list[Event]:
        """Hand the engine's outputs to the link; the events are left."""
        events: list[Event] = []
        for output in self._engine.take_outputs():
            match output:
                case Put(life, kind, payload):
                    self._link.put(life, kind, payload)
                case Ask(ask_id, robot, life, kind, payload):
                    self._link.ask(
                        (robot, life),
                        kind,
                        payload,
                        on_reply=partial(self._take_reply, ask_id),
                        on_end=partial(self._take_reply, ask_id, None),
                    )
                case Answer(reply, payloads, last):
                    reply(payloads, last=last)
                case event:
                    events.append(event)
        return events

    async def _handle(self, events: Iterable[Event]) -> None:
        for event in events:
            match event:
                case MapChanged():
                    self._folder.add([event])
                case PeersChanged(robot, alive) if robot == self.robot:
                    logger.warning("%s: another peer of this name is %s", robot, "alive" if alive else "gone")
                case PeersChanged(robot, alive, via):
                    by_way = f", by way of {via}" if via else ""
                    logger.info("%s: %s is %s%s", self.robot, robot, "alive" if alive else "absent", by_way)
                case LifeChanged(life):
                    await self._link.show(life)
                case LookAgain():
                    self._look_due.set()
        await self._notify()

    async def _notify(self) -> None:
        async with self.stepped:
            self._steps += 1
            self.stepped.notify_all()

    async def _fail(self, error: FleetmapError) -> None:
        """Leave the fleet; every call raises this error from now on."""
        logger.error("%s: %s", self.robot, error)
        self._failure = error
        self._folder.close()
        await self._link.close()

    async def _guard(self, work: Callable[[], Awaitable[None]]) -> None:
        """A task that should run until the peer is closed: if it fails, that is seen."""
        try:
            await work()
        except asyncio.CancelledError:
            if self._state == "open":
                # Not by ``close``: the loop comes to its end, and nobody will be left to close this peer.
                self._state = "closed"
                self._tasks = [task for task in self._tasks if task is not asyncio.current_task()]
                for task in self._tasks:
                    task.cancel()
                await self._leave()
            raise
        except ProcessEnds:
            return
        except Exception as error:
            logger.exception("%s: internal error", self.robot)
            await self._fail(LinkError(endpoint=self.fleet, reason=f"internal error: {error!r}"))
            await self._notify()

    async def _pump(self) -> None:
        """Feed the engine with what the link delivers, and with the time."""
        ticked_s = self._clock()
        while True:
            items = await self._inbox.take(max(0.0, ticked_s + TICK_S - self._clock()))
            now_s = self._clock()
            if now_s >= ticked_s + TICK_S:
                ticked_s = now_s
            for first in range(0, len(items), SLICE):
                await self._run(self._feed, items[first : first + SLICE], now_s)
            if not items and ticked_s == now_s:
                await self._run(self._feed, (), now_s)

    async def _look_for_tokens(self) -> None:
        """See who is there for whom there was no room. Beside the pump, and not for each of a thousand that leave."""
        while True:
            await self._look_due.wait()
            self._look_due.clear()
            for token in await self._link.tokens():
                self._inbox.deliver(Alive(*token))
            await asyncio.sleep(LOOK_PAUSE_S)

    async def _look_after(self) -> None:
        """Notice what is wrong, and tell of it in the log, a line once until it is over."""
        told: set[tuple[str, str]] = set()
        failed = False
        while True:
            await asyncio.sleep(HEALTH_S)
            heard = await self._read(self._engine.addresses)
            before = self._network
            try:
                self._network = await self._link.look(self._engine.living() - {self.robot}, heard)
                failed = False
            except Exception:  # to be told what is wrong is no reason to end
                if not failed:
                    logger.exception("%s: what is wrong with the network could not be found out", self.robot)
                failed = True
            if self._network.addresses != before.addresses:
                await self._run(self._engine.set_addresses, self._network.addresses)
            found = {(problem.kind, problem.robot): problem.text for problem in self.health()}
            for key, text in found.items():
                if key not in told:
                    logger.warning("%s: %s", self.robot, text)
            for kind, robot in sorted(told - found.keys()):
                logger.info("%s: over: %s%s", self.robot, kind, f" ({robot})" if robot else "")
            told = set(found)

    def _feed(self, items: Iterable[Input], now_s: float) -> None:
        for item in items:
            self._engine.receive(item, now_s=now_s)
        self._engine.tick(now_s)

    def _take_reply(self, ask_id: int, payload: bytes | None) -> None:
        self._inbox.deliver(ReplyEnd(ask_id) if payload is None else Reply(ask_id, payload))


def _fixed(option: str, pose: Pose2) -> FixedPose:
    return FixedPose.from_pose(check_type(option, pose, Pose2, hint=HOW_TO_POSE))


def _look_at(task: asyncio.Task[None]) -> None:
    """Take note of how a task ended. An interrupt may strike in any of them; it is told of where the loop runs."""
    if not task.cancelled():
        task.exception()
