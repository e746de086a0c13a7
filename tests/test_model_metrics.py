import math
from dataclasses import asdict, astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fleetmap.model.errors import MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.metrics import compare
from fleetmap.model.pose import Pose2

R = math.hypot(20, 20)


def grid(rows: list[str], *, x: float = 0.0, y: float = 0.0, resolution_m: float = 1.0) -> OccupancyGrid:
    """Rows from the top down: '#' occupied, '.' free, '?' unknown."""
    states = np.array([[".#?".index(c) for c in row] for row in reversed(rows)], np.uint8)
    return OccupancyGrid.from_states(states, resolution_m, Pose2(x, y))


def scores(a: OccupancyGrid, b: OccupancyGrid) -> dict[str, float]:
    return asdict(compare(a, b))


def states_grids(max_side: int = 7) -> st.SearchStrategy[OccupancyGrid]:
    shapes = st.tuples(st.integers(1, max_side), st.integers(1, max_side))
    states = shapes.flatmap(lambda shape: arrays(np.uint8, shape, elements=st.sampled_from([FREE, OCCUPIED, UNKNOWN])))
    offsets = st.tuples(st.integers(-4, 4), st.integers(-4, 4))
    return st.builds(lambda s, o: OccupancyGrid.from_states(s, 0.05, Pose2(o[0] * 0.05, o[1] * 0.05)), states, offsets)


@settings(deadline=None)  # the first call imports scipy
@given(states_grids())
def test_a_map_is_100_per_cent_like_itself(a: OccupancyGrid) -> None:
    assert astuple(compare(a, a)) == pytest.approx((100,) * 7)


def test_distances_by_hand() -> None:
    a = grid(["#....", "....#"])
    b = grid(["#....", "..#.."])
    result = scores(a, b)
    assert result["MS"] == pytest.approx(80)
    # (0, top) finds itself; (4, bottom) is 2 cells from (2, bottom)
    assert result["OPDF"] == pytest.approx(100 * (1 - (0 + 2) / 2 / R))
    assert result["OPDF_reverse"] == pytest.approx(100 * (1 - (0 + 2) / 2 / R))
    # of a's 8 free cells only (2, bottom) is not free in b; its neighbour is
    assert result["UPDF"] == pytest.approx(100 * (1 - 1 / 8 / R))


def test_correlation_by_hand() -> None:
    a, b = grid(["##.?"]), grid(["#..?"])
    values_a, values_b = [1, 1, 0, 0.5], [1, 0, 0, 0.5]
    result = scores(a, b)
    assert result["CC"] == pytest.approx(100 * np.corrcoef(values_a, values_b)[0, 1])
    assert result["PC"] == pytest.approx(100 * np.corrcoef([1, 1, 0, 0], [1, 0, 0, 0])[0, 1])


def test_a_distance_counts_at_most_r() -> None:
    a, b = grid(["#" + "?" * 60]), grid(["?" * 60 + "#"])
    assert scores(a, b)["OPDF"] == pytest.approx(0)


def test_forward_forgives_missing_walls_and_reverse_does_not() -> None:
    part, whole = grid(["#........"]), grid(["#.......#"])
    assert scores(part, whole)["OPDF"] == pytest.approx(100)
    assert scores(part, whole)["OPDF_reverse"] == pytest.approx(100 * (1 - 4 / R))


def test_an_empty_class_against_a_filled_one_is_0_and_against_an_empty_one_100() -> None:
    free, wall, unknown = grid(["..."]), grid(["###"]), grid(["???"])
    result = scores(free, wall)
    assert (result["OPDF"], result["OPDF_reverse"], result["UPDF"], result["UPDF_reverse"]) == (0, 0, 0, 0)
    result = scores(free, unknown)
    assert (result["OPDF"], result["OPDF_reverse"], result["UPDF"], result["UPDF_reverse"]) == (100, 100, 0, 0)


def test_correlation_without_variance_is_100_for_equal_maps_and_0_otherwise() -> None:
    assert scores(grid([".."]), grid([".."]))["CC"] == 100
    assert scores(grid([".."]), grid(["##"]))["CC"] == 0
    assert scores(grid([".."]), grid([".#"]))["CC"] == 0
    assert scores(grid([".."]), grid(["??"]))["PC"] == 100


def test_the_rest_of_the_union_is_unknown() -> None:
    a, b = grid(["..", ".."]), grid(["..", ".."], x=1.0, y=1.0)
    result = scores(a, b)  # 3 x 3 cells: one common, 6 of one map only, 2 of none
    assert result["MS"] == pytest.approx(100 * 3 / 9)
    assert result["UPDF"] == pytest.approx(100 * (1 - (0 + 1 + 1 + 2) / 4 / R))


def test_the_lattice_is_that_of_the_second_map() -> None:
    fine = grid(["..##", "..##"], resolution_m=0.5)
    coarse = grid([".#"], resolution_m=1.0)
    assert scores(fine, coarse)["MS"] == 100
    assert scores(coarse, fine)["MS"] == 100


def test_an_offset_of_rounding_adds_no_cells() -> None:
    a, b = grid([".#."], x=1e-3, y=-1e-3), grid([".#."])
    assert astuple(compare(a, b)) == (100,) * 7


def test_a_quarter_turn_is_undone() -> None:
    upright = grid(["#.", "..", "?."])
    # The same cells, stored from the corner (2, 0), rows running along -x and columns along +y.
    turned = OccupancyGrid(np.rot90(upright.cells_yx, 1)[::1], 1.0, Pose2(2.0, 0.0, math.pi / 2))
    assert scores(turned, upright)["MS"] == 100
    assert scores(upright, turned)["MS"] == 100


def test_maps_too_far_apart_are_refused() -> None:
    with pytest.raises(MapFormatError, match="at most"):
        compare(grid(["."]), grid(["."], x=1e6, y=1e6))
    with pytest.raises(MapFormatError, match="at most"):
        compare(grid(["."], x=1e300), grid(["."], resolution_m=1e-300))


def brute_force(a: OccupancyGrid, b: OccupancyGrid) -> list[float]:
    def cells(g: OccupancyGrid) -> dict[tuple[int, int], int]:
        j0, i0 = round(g.origin.x_m / 0.05), round(g.origin.y_m / 0.05)
        return {(i0 + i, j0 + j): int(s) for (i, j), s in np.ndenumerate(g.states_yx())}

    cells_a, cells_b = cells(a), cells(b)
    rows, columns = zip(*(cells_a.keys() | cells_b.keys()), strict=True)
    union = [(i, j) for i in range(min(rows), max(rows) + 1) for j in range(min(columns), max(columns) + 1)]
    states = [(cells_a.get(c, UNKNOWN), cells_b.get(c, UNKNOWN)) for c in union]

    def correlation(value: dict[int, float]) -> float:
        u, v = (np.array([value[pair[k]] for pair in states]) for k in (0, 1))
        if len(set(u)) == 1 or len(set(v)) == 1:
            return 100.0 * bool((u == v).all())
        return float(100 * np.corrcoef(u, v)[0, 1])

    def score(k: int, state: int) -> float:
        source = [c for c, pair in zip(union, states, strict=True) if pair[k] == state]
        target = [c for c, pair in zip(union, states, strict=True) if pair[1 - k] == state]
        if not source or not target:
            return 100.0 * (not source and not target)
        nearest = [min(abs(i - p) + abs(j - q) for p, q in target) for i, j in source]
        return float(100 * (1 - np.mean(np.minimum(nearest, R)) / R))

    return [
        100 * float(np.mean([u == v for u, v in states])),
        correlation({FREE: 0.0, UNKNOWN: 0.5, OCCUPIED: 1.0}),
        correlation({FREE: 0.0, UNKNOWN: 0.0, OCCUPIED: 1.0}),
        score(0, OCCUPIED),
        score(0, FREE),
        score(1, OCCUPIED),
        score(1, FREE),
    ]


@settings(deadline=None)
@given(states_grids(), states_grids())
def test_compare_agrees_with_brute_force(a: OccupancyGrid, b: OccupancyGrid) -> None:
    assert astuple(compare(a, b)) == pytest.approx(brute_force(a, b), abs=1e-9)
