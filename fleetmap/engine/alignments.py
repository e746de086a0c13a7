"""What the streams say of pairs of frames, judged by what others say of that: the edges of the graph of frames.

An alignment counts only if one of the two robots says it. Another robot that looks at it may confirm it, and the other
robot of the pair may refuse it. So a stranger can say where it is itself, and nothing of two others.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from fleetmap.codecs.facts import About, AlignmentFact, Verdict, alignments_of, verdicts_of
from fleetmap.engine.stream import Key, Stream
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import FixedPose

SAME_UM, SAME_COS_Q30 = 100_000, 1_073_700_939
"""A verdict holds for a place that is so near to the one that was looked at, and turned by half a degree at most."""


@dataclass(frozen=True, slots=True)
class Said:
    """An alignment as it stands among all that is held.

    Parameters
    ----------
    author : whose stream says it
    fact : what is said
    confirmed_by : other robots that have looked, and found that it holds
    refused : the other robot of the pair has looked, and found that it doesn't
    explained_mm : the least that the author or one who confirms says is explained
    """

    author: Key
    fact: AlignmentFact
    confirmed_by: tuple[str, ...]
    refused: bool
    explained_mm: int

    @property
    def other(self) -> Key:
        """The other stream."""
        return self.fact.other[:2]


@dataclass(frozen=True, slots=True)
class Edge:
    """A committed alignment between two streams.

    Parameters
    ----------
    a, b : the streams; ``a`` says it
    T_a_b : between their robots' map frames
    middle_um : (x, y) in the map frame of ``a``, of what both have
    confirmed : by a robot other than that of ``a``
    explained_mm : how much wall it explains
    submaps : of ``a`` and ``b``, that were compared
    """

    a: Key
    b: Key
    T_a_b: FixedPose
    middle_um: tuple[int, int]
    confirmed: bool
    explained_mm: int
    submaps: tuple[str, str] = ("0", "0")


def said_by_all(streams: Iterable[Stream]) -> list[Said]:
    """All alignments between these streams, in order of their authors and keys; not those between two levels."""
    by_key = {stream.key: stream for stream in streams}
    verdicts: dict[About, list[tuple[str, Verdict]]] = {}
    for stream in by_key.values():
        for verdict in verdicts_of(stream.facts):
            if verdict.about[0] != stream.robot:
                verdicts.setdefault(verdict.about, []).append((stream.robot, verdict))
    found = []
    for key in sorted(by_key):
        for fact in alignments_of(by_key[key].facts):
            other = by_key.get(fact.other[:2])
            if other is None or other.key == key or other.level != by_key[key].level:
                continue
            on_this = [
                (robot, verdict.explained_mm)
                for robot, verdict in verdicts.get((*key, fact.subject), ())
                if near(verdict.T_own_other, fact.T_own_other, fact.middle_um, SAME_UM, SAME_COS_Q30)
            ]
            refused = any(robot == other.robot and explained_mm == 0 for robot, explained_mm in on_this)
            holds = {robot: explained_mm for robot, explained_mm in on_this if explained_mm > 0}
            least = min([fact.weight.explained, *holds.values()])
            found.append(Said(key, fact, tuple(sorted(holds)), refused, least))
    return found


def near(one: FixedPose, other: FixedPose, middle_um: tuple[int, int], most_um: int, least_cos_q30: int) -> bool:
    """Whether two poses T_a_b put what lies at ``middle_um`` in a, by the second one, at about the same place."""
    try:
        off = one @ other.inverse()
        x, y = off.apply_um(*middle_um)
    except ConfigError:  # beyond what a pose may be
        return False
    apart = (x - middle_um[0]) ** 2 + (y - middle_um[1]) ** 2
    return apart <= most_um**2 and off.cos_q30 >= least_cos_q30


def edges_of(said: Iterable[Said], streams: Iterable[Stream]) -> list[Edge]:
    """The best committed alignment of each pair of streams, best first.

    The order is total, and no peer's own: confirmed ones first, then the most explained, then by name.
    """
    by_key = {stream.key: stream for stream in streams}
    found = []
    for each in said:
        fact = each.fact
        if fact.outcome != "committed" or each.refused:
            continue
        T_a_own = by_key[each.author].anchor(fact.submap)
        T_b_other = by_key[each.other].anchor(fact.other[2])
        try:
            T_a_b = T_a_own @ fact.T_own_other @ T_b_other.inverse()
        except ConfigError:
            continue  # beyond what a pose may be: there is no such place
        middle_um = T_a_own.apply_um(*fact.middle_um)
        confirmed, submaps = bool(each.confirmed_by), (fact.submap, fact.other[2])
        found.append(Edge(each.author, each.other, T_a_b, middle_um, confirmed, each.explained_mm, submaps))
    found.sort(key=rank)
    best: dict[frozenset[Key], Edge] = {}
    for edge in found:
        best.setdefault(frozenset((edge.a, edge.b)), edge)
    return list(best.values())


def rank(edge: Edge) -> tuple[bool, int, Key, Key]:
    """Least comes first."""
    return not edge.confirmed, -edge.explained_mm, edge.a, edge.b
