"""Which pairs of frames a peer looks at, when again, and what it says of them: no thread, no clock.

A pair is looked at by one of its two robots, the one with the smaller name; if the other one isn't there, by the one
that is. Who is the other one of the pair, or else the smallest name that is there, looks at what was found, and says
whether it holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

import numpy as np

from fleetmap.align.accept import strength
from fleetmap.align.protocol import Alignment, Prior
from fleetmap.codecs.facts import (
    About,
    AlignmentFact,
    FactsStep,
    Verdict,
    alignment_of,
    alignments_of,
    drop_alignment,
    drop_verdict,
    set_alignment,
    set_verdict,
    verdicts_of,
)
from fleetmap.engine import Engine
from fleetmap.engine.alignments import SAME_COS_Q30, SAME_UM, Said, near
from fleetmap.engine.stream import Key, Stream
from fleetmap.model.frame import Frame
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import VectorMap
from fleetmap.peer.align_facts import as_fact, exact, moved_m, prior_of, prior_of_starts

LEAST_WALL_M, MOST_WALL_M, MOST_M2, MOST_CELLS = 5.0, 10_000.0, 90_000.0, 36_000_000
"""A map with less wall, or more, or in a larger box, in square metres or its cells, is looked at with nobody: two of
200 m by 200 m take 200 MB for a second or two, two of 400 m by 400 m 600 MB for five."""
GROWN, GROWN_AFTER_REFUSAL = 1.1, 1.2
"""A pair is looked at again when either map has so many times as much wall."""
GAINED, GAINED_M = 1.2, 10.0
"""What was found is true when it is found again after what both have has grown so much, or by so much wall."""
CERTAIN, CERTAIN_RIVAL = 50.0, 0.2
"""A place so strong (``accept.strength``), of which the next best one explains so little, is enough the first time."""
LOOK_ANEW = 2.0
"""A place that is known is looked up, and others aren't looked at, until so many times as much wall is explained."""
MOVED_UM, MOVED_COS_Q30 = 30_000, 1_073_740_189
"""A place that is found again is said anew if it moved so far in the middle of what both have, or by 0.1 degrees."""
KEPT = ("committed", "provisional")
"""Outcomes with a place that is likely to be true."""
AGREES_M = 0.05
"""A start that is off by no more, or by no more than four standard deviations, says as much as an alignment could."""


@dataclass(frozen=True, slots=True)
class Side:
    """One map of a pair, as it was when it was looked at."""

    frame: Frame
    vector_map: VectorMap
    wall_m: float


@dataclass(frozen=True, slots=True)
class Job:
    """Something to look at.

    Parameters
    ----------
    a, b : the maps; what is found is where b lies in a
    prior : about where that may be
    starts : the prior are the starts of both robots
    known : the place that was found before, if only that is to be looked at
    about : whose alignment is looked at, of another robot; None: an own one is to be found
    """

    a: Side
    b: Side
    prior: Prior | None = None
    starts: bool = False
    known: FixedPose | None = None
    about: About | None = None

    @property
    def robot(self) -> str:
        """For whose sake."""
        return self.b.frame[0] if self.about is None else self.about[0]


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What is known now.

    Parameters
    ----------
    own : what this robot says
    streams : all that are merged if they can be placed, without the own one
    said : the alignments of all
    there : the streams of robots that are there
    held : all streams that are held, also those that are left out of the merged map
    """

    own: Stream
    streams: Sequence[Stream]
    said: Sequence[Said]
    there: frozenset[Key]
    held: frozenset[Key]


def snapshot(engine: Engine) -> Snapshot:
    """What an engine knows now."""
    own, streams = engine.own, [s for s in engine.placed_streams() if s.key != engine.own.key]
    there = frozenset(stream.key for stream in streams if engine.is_there(stream.key))
    held = frozenset(stream.key for stream in engine.holdings.streams())
    return Snapshot(own, streams, engine.components().said, there, held)


@dataclass(slots=True)
class Look:
    """The last look at a pair.

    Parameters
    ----------
    walls_m : of both maps then
    first_m : how much wall was explained when the place was found first
    whole_m : and when all places were looked at last
    prior : what was told of it then
    """

    walls_m: tuple[float, float]
    first_m: float = 0.0
    whole_m: float = 0.0
    prior: Prior | None = None


@dataclass(slots=True)
class Pairs:
    """The pairs of one peer: when it looked at them. What it found stands in its stream.

    Attributes
    ----------
    looks : of own maps and those of others
    judged : of alignments of others: the place that was looked at, and how much wall both maps had then
    served : by robot when something was last looked at for its sake: who says much isn't served before the others
    """

    looks: dict[tuple[Frame, Frame], Look] = field(default_factory=dict)
    judged: dict[About, tuple[FixedPose, tuple[float, float]]] = field(default_factory=dict)
    served: dict[str, int] = field(default_factory=dict)

    def tidy(self, now: Snapshot) -> FactsStep:
        """Forget streams that aren't held any more; what is to be taken back of what was said of them."""
        self.looks = {pair: look for pair, look in self.looks.items() if pair[1][:2] in now.held}
        self.judged = {about: judged for about, judged in self.judged.items() if about[:2] in now.held}
        robots = {robot for robot, _ in now.held}
        self.served = {robot: when for robot, when in self.served.items() if robot in robots}
        merged = {stream.key for stream in now.streams}
        step: dict[bytes, bytes | None] = {}
        for fact in alignments_of(now.own.facts):
            # Who is forgotten here may not be elsewhere, and there a place tells.
            if fact.other[:2] not in (now.held if fact.outcome == "committed" else merged):
                step |= drop_alignment(fact.submap, fact.other)
        for verdict in verdicts_of(now.own.facts):
            if verdict.about[:2] not in now.held:
                step |= drop_verdict(verdict.about)
        return step

    def next(self, now: Snapshot) -> Job | None:
        """What is to be looked at next: robots by turns, of each its word first, then the pair that has grown most."""
        words, pairs = self._to_confirm(now), self._to_find(now)
        robots = words.keys() | pairs.keys()
        if not robots:
            return None
        robot = min(robots, key=lambda robot: (self.served.get(robot, 0), robot))
        self.served[robot] = max(self.served.values(), default=0) + 1
        return words[robot] if robot in words else self._search(now, *pairs[robot][1:])

    def _to_confirm(self, now: Snapshot) -> dict[str, Job]:
        """By author one of the alignments that are to be judged."""
        streams = {stream.key: stream for stream in (*now.streams, now.own)}
        due: dict[str, Job] = {}
        for said in now.said:
            if said.author[0] in due or said.fact.outcome != "committed" or not self._is_judge(said, now):
                continue
            author, other = streams.get(said.author), streams.get(said.other)
            a, b = _side(author, said.fact.submap), _side(other, said.fact.other[2])
            if a is None or b is None:
                continue
            about = *said.author, said.fact.subject
            place, judged = said.fact.T_own_other, self.judged.get(about)
            if judged is not None:
                same = near(judged[0], place, said.fact.middle_um, SAME_UM // 2, SAME_COS_Q30)
                if same and _growth(judged[1], (a, b)) < GROWN:
                    continue
            due[said.author[0]] = Job(a, b, known=place, about=about)
        return due

    def _is_judge(self, said: Said, now: Snapshot) -> bool:
        me, author, other = now.own.robot, said.author[0], said.other[0]
        if me == author:
            return False
        there = {robot for robot, _ in now.there} | {me}
        return me == (other if other in there and other != author else min(there - {author}))

    def _to_find(self, now: Snapshot) -> dict[str, tuple[float, Side, Side, Stream]]:
        """By robot the pair that has grown most, of those that have grown enough, and how much."""
        due: dict[str, tuple[float, Side, Side, Stream]] = {}
        for stream in now.streams:
            if (
                stream.level != now.own.level
                or exact(now.own, stream)
                or (stream.key in now.there and stream.robot < now.own.robot)
            ):
                continue
            for name in sorted(now.own.submaps):
                for theirs in sorted(stream.submaps):
                    a, b = _side(now.own, name), _side(stream, theirs)
                    if a is None or b is None:
                        continue
                    urgency = self._urgency(a, b, now.own, stream)
                    if urgency > max(1.0, due[stream.robot][0] if stream.robot in due else 0.0):
                        due[stream.robot] = urgency, a, b, stream
        return due

    def _search(self, now: Snapshot, a: Side, b: Side, stream: Stream) -> Job:
        """Where a map of another robot lies in an own one."""
        look, fact, known = self.looks.get((a.frame, b.frame)), _said(now.own, a, b), None
        if look is not None and fact is not None and fact.outcome == "committed":
            known = fact.T_own_other if fact.weight.explained / 1e3 < LOOK_ANEW * look.whole_m else None
        starts = prior_of_starts(now.own, a.frame[2], stream, b.frame[2])
        if starts is not None:
            return Job(a, b, starts, starts=True)
        return Job(a, b, prior_of(now.own, a.frame[2], stream, b.frame[2]), known=known)

    def _urgency(self, a: Side, b: Side, own: Stream, other: Stream) -> float:
        """More than 1: the pair is to be looked at."""
        look = self.looks.get((a.frame, b.frame))
        if look is None:
            return float("inf")
        fact = _said(own, a, b)
        kept = fact is not None and fact.outcome in KEPT
        is_sure = fact is not None and fact.outcome == "committed"
        if not is_sure and (prior := prior_of(own, a.frame[2], other, b.frame[2])) is not None and prior != look.prior:
            return float("inf")
        return _growth(look.walls_m, (a, b)) / (GROWN if kept else GROWN_AFTER_REFUSAL)

    def failed(self, job: Job) -> None:
        """Note that a pair can't be looked at, as these maps are."""
        walls_m = job.a.wall_m, job.b.wall_m
        if job.about is not None and job.known is not None:
            self.judged[job.about] = job.known, walls_m
        else:
            self.looks.setdefault((job.a.frame, job.b.frame), Look(walls_m)).walls_m = walls_m

    def found(self, job: Job, result: Alignment, own: Stream) -> FactsStep:
        """Note what was found, and what is to be said of it; nothing if the own stream says that already."""
        walls_m = job.a.wall_m, job.b.wall_m
        if job.about is not None:
            assert job.known is not None
            holds = result.outcome == "committed" and _is_at(result, job.known, SAME_UM)
            explained_mm = round(result.evidence.explained_m * 1e3) if holds and result.evidence else 0
            self.judged[job.about] = job.known, walls_m
            verdict = Verdict(job.about, job.known, explained_mm)
            before = next((verdict for verdict in verdicts_of(own.facts) if verdict.about == job.about), None)
            return {} if before is not None and _judges_as_much(before, verdict) else set_verdict(verdict)
        return self._found(job, result, walls_m, _said(own, job.a, job.b))

    def _found(
        self, job: Job, result: Alignment, walls_m: tuple[float, float], before: AlignmentFact | None
    ) -> FactsStep:
        pair = job.a.frame, job.b.frame
        look = self.looks.setdefault(pair, Look(walls_m))
        if job.known is not None and result.outcome != "committed":
            # Where it was it isn't any more: all other places are looked at, with the next job.
            look.walls_m, look.whole_m = (0.0, 0.0), 0.0
            return {}
        look.walls_m, look.prior = walls_m, job.prior
        explained_m = result.evidence.explained_m if result.evidence else 0.0
        if job.known is None:
            look.whole_m = explained_m
        outcome = self._outcome(job, result, look, explained_m, before)
        if outcome is None:
            return drop_alignment(job.a.frame[2], job.b.frame) if before is not None else {}
        after = as_fact(job.a.frame[2], job.b.frame, result, outcome)
        if before is not None and _says_as_much(before, after):
            return {}
        return set_alignment(after)

    def _outcome(
        self, job: Job, result: Alignment, look: Look, explained_m: float, before: AlignmentFact | None
    ) -> str | None:
        """What is said; None: nothing."""
        if job.starts and job.prior is not None:
            # A start: only one that the maps contradict is worth a word.
            off_m, sigma_m = moved_m(result, job.prior.T_a_b)
            return "committed" if result.outcome == "committed" and off_m > max(AGREES_M, 4 * sigma_m) else None
        if result.outcome != "committed" or result.T_a_b is None:
            look.first_m = 0.0
            return result.outcome
        again = before is not None and before.outcome in KEPT and _is_at(result, before.T_own_other, 3 * SAME_UM)
        if not again:
            look.first_m = explained_m
        second_m = result.second.explained_m if result.second else 0.0
        strong = result.evidence is not None and strength(result.evidence) >= CERTAIN
        certain = strong and second_m <= CERTAIN_RIVAL * explained_m
        grown = again and explained_m >= min(GAINED * look.first_m, look.first_m + GAINED_M)
        was = again and before is not None and before.outcome == "committed"
        told = job.prior is not None
        return "committed" if certain or grown or was or told else "provisional"


def _says_as_much(before: AlignmentFact, after: AlignmentFact) -> bool:
    """Whether another fact isn't worth its bytes."""
    if before.outcome != after.outcome:
        return False
    one, other = sorted((before.weight.explained, after.weight.explained))
    if other > 1.5 * one + 1000:
        return False
    if after.outcome not in KEPT:
        return True
    return near(before.T_own_other, after.T_own_other, after.middle_um, MOVED_UM, MOVED_COS_Q30)


def _judges_as_much(before: Verdict, after: Verdict) -> bool:
    """Whether another verdict isn't worth its bytes."""
    one, other = sorted((before.explained_mm, after.explained_mm))
    return before.T_own_other == after.T_own_other and (one > 0) == (other > 0) and other <= 1.5 * one + 1000


def _is_at(result: Alignment, place: FixedPose, most_um: int) -> bool:
    """Whether that is about where it was found."""
    if result.T_a_b is None:
        return False
    return near(FixedPose.from_pose(result.T_a_b), place, _middle_um(result), most_um, SAME_COS_Q30)


def _middle_um(result: Alignment) -> tuple[int, int]:
    x, y = result.middle_xy
    return round(x * 1e6), round(y * 1e6)


def _side(stream: Stream | None, submap: str) -> Side | None:
    """A map that is worth a look."""
    vector_map = None if stream is None else stream.submaps.get(submap)
    if stream is None or vector_map is None:
        return None
    if vector_map.bounds_yx is None:
        return None
    y0, x0, y1, x1 = vector_map.bounds_yx
    cells = (y1 - y0) * (x1 - x0)
    if cells > MOST_CELLS or cells * (vector_map.lattice.resolution_um / 1e6) ** 2 > MOST_M2:
        return None
    wall_m = wall_of(vector_map)
    fits = LEAST_WALL_M <= wall_m <= MOST_WALL_M
    return Side((stream.robot, stream.life, submap), vector_map, wall_m) if fits else None


def _said(own: Stream, a: Side, b: Side) -> AlignmentFact | None:
    """What the own stream says of a pair."""
    return alignment_of(own.facts, a.frame[2], b.frame)


def _growth(before_m: tuple[float, float], sides: tuple[Side, Side]) -> float:
    """How many times as much wall the map has that has grown more."""
    return max(side.wall_m / max(wall_m, 1e-3) for wall_m, side in zip(before_m, sides, strict=True))


_walls_m: WeakKeyDictionary[VectorMap, float] = WeakKeyDictionary()


def wall_of(vector_map: VectorMap) -> float:
    """Metres of obstacle edges."""
    if vector_map not in _walls_m:
        segments = vector_map.segments_xy[vector_map.obstacle]
        _walls_m[vector_map] = float(np.hypot(*np.moveaxis(segments[:, 1] - segments[:, 0], -1, 0)).sum())
    return _walls_m[vector_map]
