"""Looks at pairs of maps, one after the other, in a thread that nobody waits for, and says what it finds."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial

from fleetmap.align.protocol import Alignment
from fleetmap.codecs.facts import FactsStep, alignments_of, verdicts_of
from fleetmap.model.errors import ConfigError
from fleetmap.model.threads import ProcessEnds, in_thread
from fleetmap.peer.pairs import Job, Pairs, Snapshot

logger = logging.getLogger(__name__)

LOOK_S = 0.5
"""Between two looks for a pair that is due, while none is."""
MOST_SAID, MOST_SAID_OF_ONE = 256, 24
"""Alignments and verdicts of one robot, and of these about any other one; a fleet of thirty has as many pairs for each
as it has robots."""
LEAST_REST_S = 0.01
SHARE = 3.0
"""After a job that took t it rests for so many times t: it takes at most a quarter of a core."""


class Aligner:
    """The worker of one peer.

    Parameters
    ----------
    robot : whose, for the log
    look : gives what is known now
    say : says facts
    clock : seconds, only ever growing
    """

    def __init__(
        self,
        robot: str,
        *,
        look: Callable[[], Awaitable[Snapshot]],
        say: Callable[[FactsStep], Awaitable[object]],
        clock: Callable[[], float],
    ) -> None:
        self._robot, self._look, self._say, self._clock = robot, look, say, clock
        self.pairs = Pairs()
        self._wake, self._waiting = asyncio.Event(), list[asyncio.Future[None]]()

    async def idle(self) -> None:
        """Wait until no pair is due; meanwhile it doesn't rest between two jobs."""
        found = asyncio.get_running_loop().create_future()
        self._waiting.append(found)
        self._wake.set()
        await found

    async def run(self) -> None:
        """Work for ever."""
        while True:
            waiting, self._waiting = self._waiting, []
            now = await self._look()
            await self._tell(self.pairs.tidy(now), now)
            # Of a thousand streams that takes a while.
            job = await in_thread(partial(self.pairs.next, now))
            if job is None:
                for found in waiting:
                    if not found.done():
                        found.set_result(None)
                await self._rest(LOOK_S)
                continue
            self._waiting = waiting + self._waiting
            began_s = self._clock()
            try:
                result = await in_thread(partial(work, job))
            except ProcessEnds:
                raise
            except Exception:  # a map that somebody sent costs its own place, and not this peer
                logger.exception("%s: %s and %s can't be aligned", self._robot, job.a.frame, job.b.frame)
                self.pairs.failed(job)
                result = None
            took_s = self._clock() - began_s
            if result is not None:
                logger.debug("%s: %s and %s: %s", self._robot, job.a.frame, job.b.frame, result.text)
                await self._tell(self.pairs.found(job, result, now.own), now, of=job.robot)
            await self._rest(SHARE * took_s)

    async def _tell(self, step: FactsStep, now: Snapshot, *, of: str = "") -> None:
        """Say it, unless too much is said already: strangers who invent robots must not fill this one's stream."""
        new = [key for key, value in step.items() if value is not None and key not in now.own.facts]
        alignments, verdicts = alignments_of(now.own.facts), verdicts_of(now.own.facts)
        of_one = sum(fact.other[0] == of for fact in alignments) + sum(each.about[0] == of for each in verdicts)
        is_enough = len(alignments) + len(verdicts) >= MOST_SAID or of_one >= MOST_SAID_OF_ONE
        if not step or (new and is_enough):
            return
        try:
            await self._say(step)
        except ConfigError as error:
            logger.warning("%s: an alignment isn't said: %s", self._robot, error)

    async def _rest(self, rest_s: float) -> None:
        """For so long, or until somebody waits."""
        if not self._waiting:
            self._wake.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(max(rest_s, LEAST_REST_S)):
                    await self._wake.wait()


def work(job: Job) -> Alignment:
    """Look at one pair."""
    from fleetmap.align.align import align_walls, check
    from fleetmap.align.walls import walls_of

    a, b = walls_of(job.a.vector_map), walls_of(job.b.vector_map)
    return align_walls(a, b, job.prior) if job.known is None else check(a, b, job.known.to_pose())
