"""``fleetmap.sync.join``: the same as ``fleetmap.join``, for programs without asyncio.

A thin facade: it owns a thread with an event loop, and forwards to the ``Peer`` in it.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterator
from concurrent.futures import CancelledError, Future, wait
from types import TracebackType
from typing import TYPE_CHECKING, Self, TypeVar

from fleetmap.accounting import Stats
from fleetmap.model.checks import check_number
from fleetmap.model.errors import LinkError
from fleetmap.model.grid_like import GridLike
from fleetmap.model.interrupts import interrupts_later
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap
from fleetmap.peer import Change, Peer, PeerInfo, TeammateInfo
from fleetmap.peer.alignments import AlignmentInfo
from fleetmap.peer.health import Problem
from fleetmap.peer.join import make_peer
from fleetmap.peer.options import JoinOptions, taking
from fleetmap.peer.peer import NOT_OPEN

if TYPE_CHECKING:
    from fleetmap.planners.protocol import Path

T = TypeVar("T")

WAIT_S = 0.2
"""How soon an interrupt is noticed at the latest."""


class SyncPeer:
    """A ``Peer`` behind blocking calls. Use it as ``with``, or ``close`` it; any thread may call it.

    Every method does what the one of the same name does in ``fleetmap.peer.Peer``, and raises the same errors.
    """

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, name=f"fleetmap-sync-{peer.robot}", daemon=True)
        self._closed, self._lock, self._pid = False, threading.Lock(), os.getpid()
        self._thread.start()
        try:
            self._run(peer.__aenter__)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the fleet, and end the thread. May be called twice."""
        if self._pid != os.getpid():  # the thread is in the process that this one was forked from
            return
        with interrupts_later(), self._lock:
            if self._closed:
                return
            self._closed = True
            left = asyncio.run_coroutine_threadsafe(self._leave(), self._loop)
            # An interrupt ends the wait below; the thread goes on, and ends by itself.
            left.add_done_callback(lambda _: self._loop.call_soon_threadsafe(self._loop.stop))
        _wait(left)
        self._thread.join()

    def publish(
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
        """Share a map; False if nothing changed."""
        return self._run(
            lambda: self._peer.publish(
                source,
                resolution_m=resolution_m,
                origin=origin,
                submap=submap,
                anchor=anchor,
                supersedes=supersedes,
                free_below=free_below,
                occupied_above=occupied_above,
            )
        )

    def set_pose(self, pose: Pose2) -> None:
        """Announce where the robot is, in its map frame."""
        self._run(lambda: self._peer.set_pose(pose))

    def set_goal(self, goal_xy: tuple[float, float] | None) -> None:
        """Announce where the robot is going, in its map frame; None: nowhere."""
        self._run(lambda: self._peer.set_goal(goal_xy))

    def set_start(self, start: Pose2 | FixedPose | None) -> None:
        """Announce where the own map frame lies in the fleet's."""
        self._run(lambda: self._peer.set_start(start))

    def forget(self, robot: str, *, everywhere: bool = False) -> None:
        """Leave what a robot has said so far out of the merged map; of the own name, end the former lives."""
        self._run(lambda: self._peer.forget(robot, everywhere=everywhere))

    def saw(self, robot: str, pose: Pose2, *, sigma: tuple[float, float] = (0.3, 0.2)) -> None:
        """Say where a living teammate is, in the own map frame, that was seen just now."""
        self._run(lambda: self._peer.saw(robot, pose, sigma=sigma))

    def saw_landmark(self, name: str, pose: Pose2 | None, *, sigma: tuple[float, float] = (0.1, 0.05)) -> None:
        """Say where a landmark is in the own map frame; None: that isn't known any more."""
        self._run(lambda: self._peer.saw_landmark(name, pose, sigma=sigma))

    def aligned(self, timeout_s: float = 10.0) -> None:
        """Wait until this robot has looked at every pair of maps that is its to look at, as they are now."""
        self._run(lambda: self._peer.aligned(timeout_s))

    def synced(self, timeout_s: float = 10.0, *, at_least: int = 0) -> MergedMap:
        """Wait until all that living peers hold now is held here, too."""
        return self._run(lambda: self._peer.synced(timeout_s, at_least=at_least))

    def refresh(self) -> MergedMap:
        """Fold all that is held now."""
        return self._run(self._peer.refresh)

    def changes(self, timeout_s: float | None = None) -> Iterator[Change]:
        """What robots' new maps did to the merged one; ends when none comes for ``timeout_s``."""
        if timeout_s is not None:
            check_number("timeout_s", timeout_s, expected="seconds, 0 or more", fits=lambda s: s >= 0)
        changes, turn = self._peer.changes(), asyncio.Lock()
        try:
            while True:
                try:
                    yield self._run(lambda: _next(changes, turn, timeout_s))
                except (TimeoutError, StopAsyncIteration):
                    return
        finally:
            with contextlib.suppress(LinkError):
                self._run(lambda: _end(changes, turn))

    def plan(
        self,
        start_xy: tuple[float, float],
        goal_xy: tuple[float, float],
        *,
        radius_m: float,
        margin_m: float = 0.0,
        frame: str = "robot",
    ) -> Path:
        """A path on ``merged`` for a disc of that radius."""
        return self._peer.plan(start_xy, goal_xy, radius_m=radius_m, margin_m=margin_m, frame=frame)

    @property
    def merged(self) -> MergedMap:
        """The merged map of the own component as it was folded last."""
        return self._peer.merged

    @property
    def life(self) -> int:
        """Which run of this robot's map frame it is."""
        return self._peer.life

    @property
    def T_fleet_robot(self) -> Pose2 | None:  # noqa: N802 - the field's notation
        """Where the own map frame lies in the fleet's; None while it is unknown."""
        return self._peer.T_fleet_robot

    @property
    def peers(self) -> list[PeerInfo]:
        """All other robots that are known, living and absent."""
        return self._peer.peers

    @property
    def maps(self) -> dict[str, dict[str, VectorMap]]:
        """By robot, the submaps of all others as they are held now."""
        return self._peer.maps

    @property
    def alignments(self) -> list[AlignmentInfo]:
        """What was found of each pair of frames: where one lies in the other, or why not."""
        return self._peer.alignments

    @property
    def T_merged_robot(self) -> Pose2 | None:  # noqa: N802 - the field's notation
        """Where the own map frame lies in ``merged``; None while nothing says that."""
        return self._peer.T_merged_robot

    @property
    def T_view_fleet(self) -> Pose2:  # noqa: N802 - the field's notation
        """From the frame of ``merged`` into one that doesn't jump."""
        return self._peer.T_view_fleet

    @property
    def frame(self) -> str | None:
        """Whose map frame ``merged`` has; None: the fleet's, that of the starts."""
        return self._peer.frame

    def teammates(self, *, frame: str = "robot") -> list[TeammateInfo]:
        """Living robots with the pose and the goal that they announced last."""
        return self._peer.teammates(frame=frame)

    def health(self) -> tuple[Problem, ...]:
        """What is wrong now; empty if nothing is."""
        return self._peer.health()

    def stats(self) -> Stats:
        """Bytes sent, received and dropped, and what gzipped grids would have cost."""
        return self._peer.stats()

    def _run(self, call: Callable[[], Coroutine[object, object, T]]) -> T:
        """The result of a call in the loop's thread; an interrupt cancels it."""
        closed = LinkError(endpoint=self._peer.fleet, reason="the peer is closed")
        if self._pid != os.getpid():
            raise LinkError(endpoint=self._peer.fleet, reason=NOT_OPEN["forked"])
        future: Future[T] | None = None
        try:
            # Later: an interrupt between the call's begin and the future's would leave a call that nobody can cancel.
            with interrupts_later(), self._lock:
                if self._closed:
                    raise closed
                future = asyncio.run_coroutine_threadsafe(call(), self._loop)
            return _wait(future)
        except CancelledError:
            raise closed from None
        except BaseException:
            if future is not None:
                future.cancel()
            raise

    def _serve(self) -> None:
        self._loop.run_forever()
        self._loop.close()

    async def _leave(self) -> None:
        """Close the peer, and end the calls of other threads that still wait: the loop stops after this."""
        await self._peer.close()
        waiting = asyncio.all_tasks() - {asyncio.current_task()}
        for task in waiting:
            task.cancel()
        await asyncio.gather(*waiting, return_exceptions=True)


def _wait(future: Future[T]) -> T:
    # In turns: an interrupt that strikes just before Python waits for a lock is noticed when that wait is over.
    while not wait([future], WAIT_S).done:
        pass
    return future.result()


async def _next(changes: AsyncGenerator[Change, None], turn: asyncio.Lock, timeout_s: float | None) -> Change:
    async with turn, asyncio.timeout(timeout_s):
        return await anext(changes)


async def _end(changes: AsyncGenerator[Change, None], turn: asyncio.Lock) -> None:
    async with turn:  # a reader that was interrupted has some steps to go
        await changes.aclose()


@taking(JoinOptions)
def join(options: JoinOptions) -> SyncPeer:
    """Join a fleet and connect: ``with fleetmap.sync.join("r7") as peer: ...``.

    The options are those of ``fleetmap.join``, one by one: ``help(fleetmap.JoinOptions)``.

    Raises
    ------
    ConfigError : an option has an impossible value
    NameInUse : a living peer has this name
    LinkError : the transport could not be opened
    """
    return SyncPeer(make_peer(options))
