"""Bands: a map made by deltas is the map that is built whole, and shares with its base what did not change."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.model.bands import Bands
from fleetmap.model.delta import MapDelta, apply, diff, find_rows
from fleetmap.model.errors import MapFormatError
from fleetmap.model.hashing import hash_ints
from fleetmap.model.lattice import MAX_COORDINATE, Lattice
from fleetmap.model.sort_kernels import order_of
from fleetmap.model.vectormap import VectorMap

LATTICE = Lattice(50_000)
COORDINATE = st.sampled_from([-MAX_COORDINATE, -130, -65, -64, -1, 0, 1, 63, 64, 127, 128, 1000, MAX_COORDINATE])
ROWS = st.lists(
    st.tuples(
        COORDINATE,
        COORDINATE,
        COORDINATE,
        COORDINATE,
        st.sampled_from([1, 2, 3, 5, 6, 7]),
        st.sampled_from([0, 4, 255]),
    ).filter(lambda r: r[:2] != r[2:4]),
    max_size=40,
)


def a_map(rows: list[tuple[int, ...]]) -> VectorMap:
    table = np.array(rows, np.int64).reshape(-1, 6)
    return VectorMap(LATTICE, table[:, :5], table[:, 5])


MAPS = ROWS.map(a_map)


def same(a: VectorMap, b: VectorMap) -> bool:
    """To the byte: bands, edges, thickness, digest."""
    return (
        a.digest == b.digest
        and a.bands.numbers == b.bands.numbers
        and all(p.tobytes() == q.tobytes() for p, q in zip(a.bands.parts, b.bands.parts, strict=True))
        and a.edges.tobytes() == b.edges.tobytes()
        and a.thickness.tobytes() == b.thickness.tobytes()
    )


def plain_rows(rows: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """The slow twin of ``canonical_rows``: of equal edges the first one stays."""
    turned: dict[tuple[int, ...], int] = {}
    for y0, x0, y1, x1, label, thickness in rows:
        back = (y0, x0) > (y1, x1)
        edge = (y1, x1, y0, x0, 3 * (label % 3) + label // 3) if back else (y0, x0, y1, x1, label)
        turned.setdefault(edge, thickness)
    return [(*edge, turned[edge]) for edge in sorted(turned)]


def plain_digest(vector_map: VectorMap) -> int:
    rows = np.column_stack([vector_map.edges, vector_map.thickness]).tolist()
    edges = sum(hash_ints(tuple(row[:5]), 2) + (hash_ints(tuple(row), 3) if row[5] else 0) for row in rows)
    return (VectorMap.empty(LATTICE).digest + edges) % 2**64


@given(ROWS)
def test_rows_are_those_of_the_slow_twin(rows: list[tuple[int, ...]]) -> None:
    whole = a_map(rows)
    found = np.column_stack([whole.edges, whole.thickness]).tolist()
    assert [tuple(row) for row in found] == plain_rows(rows)
    assert len(whole) == len(found)
    assert whole.digest == plain_digest(whole)


@settings(max_examples=200)
@given(st.lists(MAPS, min_size=2, max_size=5))
def test_maps_made_by_deltas_equal_maps_built_whole(maps: list[VectorMap]) -> None:
    made = maps[0]
    for new in maps[1:]:
        delta = diff(made, new)
        assert len(delta) == len(diff(VectorMap(LATTICE, made.edges, made.thickness), new))
        made = apply(made, delta)
        assert same(made, new)
        assert made.digest == plain_digest(new)


@given(MAPS, MAPS)
def test_untouched_bands_are_shared(old: VectorMap, new: VectorMap) -> None:
    delta = diff(old, new)
    touched = {y0 // 64 for rows in (delta.removed, delta.added, delta.rethickened) for y0 in rows[:, 0].tolist()}
    made = apply(old, delta)
    before, after = (dict(zip(m.bands.numbers, m.bands.parts, strict=True)) for m in (old, made))
    for number in before.keys() | after.keys():
        if number not in touched:
            assert before[number] is after[number]
    for rows in made.bands.differing(old.bands):
        assert {y0 // 64 for y0 in rows[:, 0].tolist()} <= touched


@given(MAPS, ROWS)
def test_places_are_those_in_the_canonical_order(whole: VectorMap, others: list[tuple[int, ...]]) -> None:
    needles = np.concatenate([whole.edges, a_map(others).edges])
    order = {tuple(row): place for place, row in enumerate(whole.edges.tolist())}
    places = [order.get(tuple(row), -1) for row in needles.tolist()]
    assert whole.bands.find(needles).tolist() == places
    assert find_rows(whole.edges, needles).tolist() == places
    there = np.array([place for place in places if place >= 0], np.int64)
    assert np.array_equal(whole.bands.take(there)[:, :5], whole.edges[there])


ROOM = a_map([(0, 0, 0, 9, 1, 4), (0, 9, 70, 9, 1, 4), (70, 0, 70, 9, 3, 4), (0, 0, 70, 0, 3, 4)])
NONE = np.zeros((0, 5), np.int32)
NO_DEPTHS = np.zeros(0, np.uint8)


def edges_of(*rows: tuple[int, ...]) -> np.ndarray:
    return np.array(rows, np.int32).reshape(-1, 5)


@pytest.mark.parametrize(
    ("delta", "reason"),
    [
        (MapDelta(edges_of((1, 0, 1, 9, 1)), NONE, NO_DEPTHS, NONE, NO_DEPTHS), "does not have"),
        (MapDelta(ROOM.edges[[1, 0]], NONE, NO_DEPTHS, NONE, NO_DEPTHS), "does not have"),
        (MapDelta(ROOM.edges[[0, 0]], NONE, NO_DEPTHS, NONE, NO_DEPTHS), "does not have"),
        (MapDelta(ROOM.edges[:1], NONE, NO_DEPTHS, ROOM.edges[:1], np.ones(1, np.uint8)), "does not have"),
        (MapDelta(NONE, ROOM.edges[:1], np.ones(1, np.uint8), NONE, NO_DEPTHS), "adds an edge twice"),
        (MapDelta(NONE, edges_of((5, 5, 6, 6, 1), (4, 4, 6, 6, 1)), np.ones(2, np.uint8), NONE, NO_DEPTHS), "order"),
        (MapDelta(NONE, edges_of((5, 5, 4, 4, 1)), np.ones(1, np.uint8), NONE, NO_DEPTHS), "upper end first"),
        (MapDelta(NONE, edges_of((5, 5, 5, 5, 1)), np.ones(1, np.uint8), NONE, NO_DEPTHS), "no length"),
        (MapDelta(NONE, edges_of((5, 5, 6, 6, 4)), np.ones(1, np.uint8), NONE, NO_DEPTHS), "label"),
        (MapDelta(NONE, edges_of((5, 5, 6, 2**31 - 1, 1)), np.ones(1, np.uint8), NONE, NO_DEPTHS), "farther"),
        (MapDelta(NONE, edges_of((-(2**31), 5, 6, 6, 1)), np.ones(1, np.uint8), NONE, NO_DEPTHS), "farther"),
        (MapDelta(NONE, ROOM.edges[:1], NO_DEPTHS, NONE, NO_DEPTHS), "as many"),
    ],
)
def test_a_delta_that_does_not_fit_is_refused(delta: MapDelta, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        apply(ROOM, delta)


def test_an_edge_may_go_and_come_back_thicker() -> None:
    delta = MapDelta(ROOM.edges[:1], ROOM.edges[:1], np.array([9], np.uint8), NONE, NO_DEPTHS)
    assert apply(ROOM, delta).thickness.tolist() == [9, *ROOM.thickness.tolist()[1:]]


def test_a_map_is_never_changed() -> None:
    with pytest.raises(AttributeError, match="never changed"):
        ROOM.profile = "full"
    with pytest.raises(ValueError, match="read-only"):
        ROOM.bands.parts[0][0, 0] = 5
    thicker = apply(ROOM, diff(ROOM, VectorMap(LATTICE, ROOM.edges, ROOM.thickness + np.uint8(1))))
    assert not any(part.flags.writeable for part in thicker.bands.parts)


def test_valid_rows_make_the_same_map_and_maps_survive_pickling() -> None:
    rows = np.column_stack([ROOM.edges, ROOM.thickness]).astype(np.int32)
    assert same(VectorMap.of_rows(LATTICE, rows), ROOM)
    assert same(pickle.loads(pickle.dumps(ROOM)), ROOM)
    assert Bands.of(rows).numbers == (0, 1)


@pytest.mark.parametrize("thickness", [-1, 256, 2**40])
def test_a_thickness_that_is_no_byte_is_refused(thickness: int) -> None:
    with pytest.raises(MapFormatError, match="thickness"):
        VectorMap(LATTICE, ROOM.edges, np.full(len(ROOM), thickness))


@pytest.mark.parametrize("least", [-(2**63), 2**63 - 1, -(2**31)])
def test_numbers_at_the_bounds_of_their_type_are_refused(least: int) -> None:
    with pytest.raises(MapFormatError, match="farther"):
        VectorMap(LATTICE, np.array([[least, 0, 1, 1, 1]]), np.zeros(1, np.uint8))


@given(st.lists(st.integers(-(2**60), 2**60), max_size=200), st.integers(1, 2**58))
def test_the_sort_is_stable(keys: list[int], coarse: int) -> None:
    array = np.array(keys, np.int64) // coarse
    assert order_of(array).tolist() == np.argsort(array, kind="stable").tolist()
