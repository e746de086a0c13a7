"""Which frames are connected, and where each lies: a pure function of the streams, by integers alone.

1. ``edges_of``: the best committed alignment of each pair of streams.
2. Cores: streams that confirmed alignments connect. Where a loop doesn't close, what more loops support wins.
3. Leaves: a core of one robot alone may hang itself on another one by its own word, and carries nobody with it.
4. The frame of each component; those with a start lie in one, the fleet's.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from fleetmap.codecs.facts import Facts
from fleetmap.engine.alignments import Edge, Said, edges_of, rank, said_by_all
from fleetmap.engine.stream import Key, Stream
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import FarPose, FixedPose, shift_round

LOOP_UM, LOOP_COS_Q30 = 300_000, 1_073_578_288
"""Around a loop of alignments one comes back to within so much of where one was, in the middle of what was aligned,
and to within one degree."""
ENOUGH = 8
"""So many robots that close triangles with an edge are beyond doubt; more aren't looked for."""


@dataclass(frozen=True, slots=True)
class Components:
    """Where all streams lie.

    Parameters
    ----------
    poses : (component, T_component_robot) of each stream; a component is named by its first stream
    said : what was said of all pairs
    lost : edges that contradict others, which count for more
    """

    poses: Mapping[Key, tuple[Key, FixedPose]]
    said: tuple[Said, ...] = ()
    lost: tuple[Edge, ...] = ()

    def members(self, key: Key) -> list[Key]:
        """The streams of one component, ascending."""
        if key not in self.poses:
            return [key]
        return sorted(other for other, (name, _) in self.poses.items() if name == self.poses[key][0])

    def pose(self, key: Key) -> FixedPose | None:
        """T_component_robot."""
        return self.poses[key][1] if key in self.poses else None


@dataclass(slots=True)
class Core:
    """Streams that are connected.

    Attributes
    ----------
    poses : where each lies in the frame of one of them, be that as far off as one of them says
    tree : the edges that connect them, one fewer than they are
    """

    poses: dict[Key, FarPose]
    tree: list[Edge] = field(default_factory=list)

    def robots(self) -> set[str]:
        """Whose."""
        return {robot for robot, _ in self.poses}

    def spread(self, start: Key, pose: FixedPose) -> dict[Key, FixedPose]:
        """Where each lies if one of them lies there: from that one on, so that what is far off moves nothing here.

        Raises
        ------
        ConfigError : one would lie beyond what a pose may be
        """
        beside: dict[Key, list[Edge]] = {}
        for edge in self.tree:
            beside.setdefault(edge.a, []).append(edge)
            beside.setdefault(edge.b, []).append(edge)
        placed, todo = {start: pose}, [start]
        while todo:
            key = todo.pop()
            for edge in beside.get(key, ()):
                other = edge.b if edge.a == key else edge.a
                if other not in placed:
                    placed[other] = placed[key] @ across(edge, key)
                    todo.append(other)
        return placed


def components_of(streams: Iterable[Stream]) -> Components:
    """All components of these streams."""
    by_key = {stream.key: stream for stream in sorted(streams, key=lambda s: s.key)}
    said = said_by_all(by_key.values())
    edges = edges_of(said, by_key.values())
    connected = {key for edge in edges for key in (edge.a, edge.b)}
    cores, lost = cores_of(sorted(connected), [edge for edge in edges if edge.confirmed])
    hooks = hang(cores, [edge for edge in edges if not edge.confirmed])
    placed: dict[Key, tuple[Key, FixedPose]] = {}
    fleet: dict[str, Key] = {}
    for core in cores:
        if id(core) not in hooks:
            placed |= in_a_frame(core, by_key, fleet)
    for key, stream in by_key.items():  # most of a thousand are by themselves
        if key not in connected:
            start = stream.start
            name = key if start is None else fleet.setdefault(stream.level, key)
            placed[key] = name, start or FixedPose()
    todo = [core for core in cores if id(core) in hooks]
    while todo:
        ready = [core for core in todo if hooks[id(core)].b in placed]
        for core in ready:
            edge = hooks[id(core)]
            name, T_name_b = placed[edge.b]
            try:
                pose = T_name_b @ edge.T_a_b.inverse()
            except ConfigError:
                name, pose = edge.a, FixedPose()
            try:
                placed |= {key: (name, there) for key, there in core.spread(edge.a, pose).items()}
            except ConfigError:
                placed |= {key: (key, FixedPose()) for key in core.poses}
        todo = [core for core in todo if core not in ready]
    return Components(placed, tuple(said), tuple(lost))


@dataclass(slots=True)
class Remembered:
    """The last two answers of ``components_of``: it depends on facts alone, and these seldom change."""

    _last: tuple[tuple[list[tuple[Key, Facts]], Components], ...] = ()

    def of(self, streams: Iterable[Stream]) -> Components:
        """All components of these streams. Any thread may call it."""
        given = list(streams)
        facts = [(stream.key, stream.facts) for stream in given]
        for known, components in self._last:
            if len(known) == len(facts) and all(a == c and b is d for (a, b), (c, d) in zip(known, facts, strict=True)):
                return components
        components = components_of(given)
        self._last = ((facts, components), *self._last[:1])
        return components


def in_a_frame(core: Core, streams: Mapping[Key, Stream], fleet: dict[str, Key]) -> dict[Key, tuple[Key, FixedPose]]:
    """Place a core in the frame of one of its streams; in no frame if that puts any of it beyond what a pose may be.

    Parameters
    ----------
    fleet : by level the stream that names the frame in which all starts lie; the first one is added
    """
    for frame, pose in frames_of(core, streams):
        try:
            poses = core.spread(frame, pose)
        except ConfigError:
            continue
        stream = streams[frame]
        name = frame if stream.start is None else fleet.setdefault(stream.level, frame)
        return {key: (name, there) for key, there in poses.items()}
    return {key: (key, FixedPose()) for key in core.poses}


def cores_of(streams: Iterable[Key], edges: Sequence[Edge]) -> tuple[list[Core], list[Edge]]:
    """Connect streams, the most supported edges first; and the edges that contradict those before them."""
    of = {key: Core({key: FarPose()}) for key in streams}
    lost = []
    for edge in by_support(edges):
        one, other = of[edge.a], of[edge.b]
        if one is other:
            if not closes(edge, one.poses[edge.a].inverse(), one.poses[edge.b]):
                lost.append(edge)
            continue
        T_one_other = one.poses[edge.a] @ edge.T_a_b @ other.poses[edge.b].inverse()
        if len(other.poses) > len(one.poses):  # one who says that it is far off moves nobody else
            one, other, T_one_other = other, one, T_one_other.inverse()
        moved = {key: T_one_other @ pose for key, pose in other.poses.items()}
        one.poses |= moved
        one.tree += [*other.tree, edge]
        of |= dict.fromkeys(moved, one)
    return list({id(core): core for core in of.values()}.values()), lost


def by_support(edges: Sequence[Edge]) -> list[Edge]:
    """The edges by how many robots close a triangle with each, then by rank.

    Of a stream with several submaps those by another one than its best come after all others: how its submaps lie to
    each other is its own word, and mustn't move two others.
    """
    ways: dict[Key, dict[Key, FixedPose]] = {}
    for edge in edges:
        for key in (edge.a, edge.b):
            ways.setdefault(key, {})
        try:
            ways[edge.b][edge.a] = edge.T_a_b.inverse()
        except ConfigError:
            continue
        ways[edge.a][edge.b] = edge.T_a_b
    by_rank = sorted(edges, key=lambda edge: (-support(edge, ways), rank(edge)))
    best: dict[Key, str] = {}
    for edge in by_rank:
        for key, submap in zip((edge.a, edge.b), edge.submaps, strict=True):
            best.setdefault(key, submap)
    return sorted(by_rank, key=lambda edge: (best[edge.a], best[edge.b]) != edge.submaps)


def support(edge: Edge, ways: Mapping[Key, Mapping[Key, FixedPose]]) -> int:
    """How many other robots' ways from a to b say the same, ``ENOUGH`` at most."""
    robots: set[str] = set()
    for third, T_a_third in ways[edge.a].items():
        T_third_b = ways[third].get(edge.b)
        if T_third_b is None or third[0] in robots or third[0] in (edge.a[0], edge.b[0]):
            continue
        if closes(edge, T_a_third, T_third_b):
            robots.add(third[0])
            if len(robots) == ENOUGH:
                break
    return len(robots)


def across(edge: Edge, start: Key) -> FixedPose:
    """From the other end of an edge into the frame of this one."""
    return edge.T_a_b if edge.a == start else edge.T_a_b.inverse()


def closes(edge: Edge, T_a_c: FixedPose, T_c_b: FixedPose) -> bool:
    """Whether an edge says the same as the way by another frame.

    In plain numbers: of 150 robots that have all found each other it is asked a hundred thousand times.
    """
    there, (x, y) = edge.T_a_b, edge.middle_um
    c, s = there.cos_q30, there.sin_q30
    from_x, from_y = x - there.x_um, y - there.y_um
    in_b = shift_round(c * from_x + s * from_y, 30), shift_round(c * from_y - s * from_x, 30)
    back_x, back_y = T_a_c.apply_um(*T_c_b.apply_um(*in_b))
    if (back_x - x) ** 2 + (back_y - y) ** 2 > LOOP_UM**2:
        return False
    cos_q60 = T_a_c.cos_q30 * T_c_b.cos_q30 - T_a_c.sin_q30 * T_c_b.sin_q30
    sin_q60 = T_a_c.sin_q30 * T_c_b.cos_q30 + T_a_c.cos_q30 * T_c_b.sin_q30
    return cos_q60 * c + sin_q60 * s >= LOOP_COS_Q30 << 60


def hang(cores: Sequence[Core], edges: Sequence[Edge]) -> dict[int, Edge]:
    """Cores of one robot hang themselves on others, each by the best of its own edges: by the identity of the core."""
    of = {key: core for core in cores for key in core.poses}
    hooks: dict[int, Edge] = {}
    for edge in edges:
        core, end = of[edge.a], of[edge.b]
        while id(end) in hooks:
            end = of[hooks[id(end)].b]
        if core.robots() == {edge.a[0]} and id(core) not in hooks and end is not core:
            hooks[id(core)] = edge
    return hooks


def frames_of(core: Core, streams: Mapping[Key, Stream]) -> Iterator[tuple[Key, FixedPose]]:
    """Streams that may give a component its frame, the first one that fits does, and where each lies there.

    That of the smallest robot name, its first life; if any has a start, of those. Of the core alone: who hangs itself
    on it turns nobody's map.
    """
    keys = sorted(core.poses)
    started = [key for key in keys if streams[key].start is not None]
    for robot in dict.fromkeys(robot for robot, _ in started or keys):
        first = first_life([streams[key] for key in started or keys if key[0] == robot])
        yield first.key, first.start or FixedPose()


def first_life(lives: Sequence[Stream]) -> Stream:
    """The one that was before the others: a life names those before it. Of several the one with the least number."""
    known = {stream.life for stream in lives}
    return min(lives, key=lambda s: (len((s.names | s.supersedes.keys()) & known - {s.life}), s.life))
