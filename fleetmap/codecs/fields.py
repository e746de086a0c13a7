"""A delta as a few lists of small numbers, and back: what all payload modes share. How a mode writes them is its own.

Removed edges are named by their place in the base's canonical order and added ones as chains. Chains of a closed
boundary start where a removed edge ended, so their roots are small numbers and not coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.chains import DIRECTED_LABELS, Chain, find_chains
from fleetmap.model.arcs import flip
from fleetmap.model.delta import MapDelta, find_rows
from fleetmap.model.lattice import MAX_COORDINATE
from fleetmap.model.vectormap import VectorMap, canonical_edges


@dataclass(frozen=True, eq=False, slots=True)
class DeltaFields:
    """The numbers of a delta, int64.

    Parameters
    ----------
    removed : (R,) places of the removed edges in the base, ascending
    known_roots : (K,) ranks among the endpoints of the removed edges, ascending; a rank may occur twice
    absolute_roots : (A, 2) steps (dy, dx), each from the root before it
    heads : (C,) one number a chain: continues + 2 (label class + 3 (edges - 1))
    steps : (E, 2) steps (dy, dx), one for each added edge in the order of the chains
    runs : (T, 2) thickness and number of edges
    rethickened : (H, 2) place in the base, ascending, and new thickness
    thick_frontiers : whether the runs speak of frontiers too
    """

    removed: NDArray[np.int64]
    known_roots: NDArray[np.int64]
    absolute_roots: NDArray[np.int64]
    heads: NDArray[np.int64]
    steps: NDArray[np.int64]
    runs: NDArray[np.int64]
    rethickened: NDArray[np.int64]
    thick_frontiers: bool

    @property
    def counts(self) -> tuple[int, int, int, int, int, int]:
        """R, K, A, C, T and H; the number of steps follows from the heads."""
        return (
            len(self.removed),
            len(self.known_roots),
            len(self.absolute_roots),
            len(self.heads),
            len(self.runs),
            len(self.rethickened),
        )


def to_fields(delta: MapDelta, base: VectorMap) -> DeltaFields:
    """The numbers of a delta against ``base``; the same delta always has the same ones."""
    known = endpoints(delta.removed)
    chains = find_chains(delta.added, map(tuple, known.tolist()))
    starts = np.array([c.points[0] for c in chains if not c.continues], np.int64).reshape(-1, 2)
    ranks = _rank_among(known, starts)
    order = np.array([i for c in chains for i in c.edges], np.int64)
    thick_frontiers = bool((delta.added_thickness[_is_frontier(delta.added)] > 0).any())
    thickness = delta.added_thickness[order]
    if not thick_frontiers:
        thickness = thickness[~_is_frontier(delta.added[order])]
    return DeltaFields(
        find_rows(base.edges, delta.removed).astype(np.int64),
        ranks[ranks >= 0],
        np.diff(np.concatenate([_reference(delta.removed), starts[ranks < 0]]), axis=0),
        np.array([_head(c) for c in chains], np.int64),
        _steps(chains),
        _runs(thickness),
        np.column_stack([find_rows(base.edges, delta.rethickened), delta.rethickened_to]).astype(np.int64),
        thick_frontiers,
    )


def to_delta(fields: DeltaFields, base: VectorMap) -> MapDelta:
    """The delta whose numbers these are, against the same base.

    Raises
    ------
    ValueError : the numbers don't fit each other or the base (``MapFormatError`` is one, too)
    """
    removed = base.edges[_checked(fields.removed, len(base))]
    known = endpoints(removed)
    absolute = _reference(removed) + np.cumsum(fields.absolute_roots, axis=0)
    roots = np.concatenate([known[_checked(fields.known_roots, len(known))], absolute])
    added, labels = _chains_to_edges(fields, roots)
    values, lengths = fields.runs.T
    has_thickness = np.ones(len(added), bool) if fields.thick_frontiers else labels != DIRECTED_LABELS[1]
    if (values > 255).any() or (lengths > len(added)).any() or lengths.sum() != has_thickness.sum():
        raise ValueError("the thickness runs don't fit the added edges")
    thickness = np.zeros(len(added), np.uint8)
    thickness[has_thickness] = np.repeat(values, lengths)
    rethickened, rethickened_to = fields.rethickened.T
    if (rethickened_to > 255).any():
        raise ValueError("a thickness is above 255 quarters of a cell")
    if len(added) and np.abs(added[:, :4]).max() > MAX_COORDINATE:
        raise ValueError(f"a coordinate is farther than {MAX_COORDINATE} cells from the lattice's origin")
    edges, edge_thickness = canonical_edges(added.astype(np.int32), thickness)
    if len(edges) != len(added):
        raise ValueError("an edge is added twice")
    return MapDelta(
        removed,
        edges,
        edge_thickness,
        base.edges[_checked(rethickened, len(base))],
        rethickened_to.astype(np.uint8),
    )


def endpoints(edges: NDArray[np.int32]) -> NDArray[np.int64]:
    """(v, 2) the vertices (y, x) of some edges, ascending, each once."""
    return np.unique(edges[:, :4].reshape(-1, 2).astype(np.int64), axis=0)


def edges_per_chain(heads: NDArray[np.int64]) -> NDArray[np.int64]:
    """(C,) number of edges of each chain."""
    return (heads >> 1) // 3 + 1


def _chains_to_edges(fields: DeltaFields, roots: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(m, 5) edges, first vertex first as walked, and (m,) their directed labels."""
    heads = fields.heads
    continues, label_code, counts = heads & 1, (heads >> 1) % 3, edges_per_chain(heads)
    if len(heads) and continues[0]:
        raise ValueError("a chain has no root")
    if int((continues == 0).sum()) != len(roots):
        raise ValueError("the number of roots is not the number of walks")
    walk = np.repeat(np.cumsum(continues == 0) - 1, counts)
    ends = np.cumsum(fields.steps, axis=0)
    before = ends - fields.steps
    first_of_walk = np.searchsorted(walk, np.arange(len(roots)))
    shift = (roots - before[first_of_walk])[walk] if len(walk) else np.zeros((0, 2), np.int64)
    labels = np.array(DIRECTED_LABELS)[np.repeat(label_code, counts)]
    return np.column_stack([before + shift, ends + shift, labels]), labels


def _reference(removed: NDArray[np.int32]) -> NDArray[np.int64]:
    """(1, 2) where the absolute roots are counted from."""
    return removed[:1, :2].astype(np.int64) if len(removed) else np.zeros((1, 2), np.int64)


def _head(chain: Chain) -> int:
    return int(chain.continues) + 2 * (DIRECTED_LABELS.index(chain.label) + 3 * (len(chain.edges) - 1))


def _steps(chains: list[Chain]) -> NDArray[np.int64]:
    steps = [np.diff(np.array(c.points, np.int64), axis=0) for c in chains]
    return np.concatenate(steps) if steps else np.zeros((0, 2), np.int64)


def _is_frontier(edges: NDArray[np.int32]) -> NDArray[np.bool_]:
    return np.isin(edges[:, 4], (DIRECTED_LABELS[1], flip(DIRECTED_LABELS[1])))


def _rank_among(known: NDArray[np.int64], points: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) place of each point among ascending known ones; -1 where it is not one of them."""
    places = {point: i for i, point in enumerate(map(tuple, known.tolist()))}
    return np.array([places.get(tuple(point), -1) for point in points.tolist()], np.int64)


def _checked(places: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    # A running sum of numbers below 2^35 may overflow only after it has passed the count.
    if len(places) and (places.min() < 0 or places.max() >= count):
        raise ValueError(f"a place is not below {count}")
    return places


def _runs(values: NDArray[np.uint8]) -> NDArray[np.int64]:
    """(r, 2) rows (value, length)."""
    starts = np.flatnonzero(np.diff(values.astype(np.int64), prepend=-1))
    return np.column_stack([values[starts], np.diff(starts, append=len(values))]).astype(np.int64)
