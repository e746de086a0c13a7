"""Crossings are bounded: two small hostile maps don't take all memory, and honest ones beside them stay."""

import numpy as np

from fleetmap.merge import fold
from fleetmap.merge.arrange import affordable
from fleetmap.merge.fold import canonical
from fleetmap.merge.protocol import Source
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import FixedPose
from fleetmap.model.vectormap import VectorMap


def comb(teeth: int, *, length: int, upright: bool) -> VectorMap:
    """Free strips one cell wide, two cells apart."""
    k = np.arange(teeth) * 2
    low, high = np.zeros_like(k), np.full_like(k, length)
    sides = [(k, low, k, high, 1), (k + 1, low, k + 1, high, 3), (k, low, k + 1, low, 3), (k, high, k + 1, high, 1)]
    edges = np.concatenate([np.column_stack([y0, x0, y1, x1, low + label]) for y0, x0, y1, x1, label in sides])
    if upright:  # mirrored: left and right change places
        edges = np.column_stack([edges[:, [1, 0, 3, 2]], 4 - edges[:, 4]])
    return VectorMap(Lattice(50_000), edges.astype(np.int32), np.zeros(len(edges), np.uint8))


def source(robot: str, vector_map: VectorMap) -> Source:
    return Source((robot, 1, "0"), FixedPose(), vector_map)


def test_of_two_crossing_combs_one_is_left_out_and_honest_maps_stay() -> None:
    teeth = 1000
    room = source("honest", comb(1, length=40, upright=False))
    combs = [source(n, comb(teeth, length=2 * teeth, upright=n == "b")) for n in "ab"]
    kept = affordable(canonical([room, *combs]).placed)
    assert sorted(len(p.ends) for p in kept) == [4, 4 * teeth]
    assert [p.content() for p in affordable(canonical([*combs[::-1], room]).placed)] == [p.content() for p in kept]
    merged = fold([room, *combs])
    assert len(merged) <= 4 * teeth + 4
    assert [(frame[0], "cross" in reason) for frame, reason in merged.left_out] in ([("a", True)], [("b", True)])


def test_small_crossing_maps_are_all_kept() -> None:
    combs = [source("a", comb(20, length=40, upright=u)) for u in (False, True)]
    assert len(affordable(canonical(combs).placed)) == 2
