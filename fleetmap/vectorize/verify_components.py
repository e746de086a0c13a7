"""Whether the free faces of a vector map are the components of free cells: none lost, split or wrongly joined.

An edge may be epsilon off, so cells near a boundary may lie in another face than the rest of their component.
Cells that are *deep*, more than epsilon from all that isn't free, may not: they say which face is their
component's. A component without any is in the face that most of its cells are in or, if that won't do, in one
near it that no other component is in: the question is whether some assignment keeps all promises.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import OCCUPIED
from fleetmap.vectorize.verify_cells import GridCells
from fleetmap.vectorize.verify_cover import UNIT
from fleetmap.vectorize.verify_faces import Faces

Defects = list[tuple[str, NDArray[np.float64]]]
"""What is wrong, and where: (y, x) in cells of the lattice."""

SETTLE_ROUNDS = 4
"""A thin component that finds its face may show the way to the next one; so often is enough for real maps."""


def find_component_defects(
    cells: GridCells, edges: NDArray[np.int64], faces: Faces, is_free: NDArray[np.bool_]
) -> Defects:
    """Find components of free cells and free faces that don't correspond.

    1. Each component that is no speck lies in exactly one free face.
    2. Components in one face are connected: directly where they meet at a corner whose two other cells are not
       occupied, or through each other, free specks near that face, or unknown specks that have become part of it.
    3. A free face without such a component has a free speck of its own near it.

    Parameters
    ----------
    edges : (n, 4) rows (y0, x0, y1, x1) in 1/32 cells of the lattice
    is_free : (faces.count,) which faces are free
    """
    components = _Components(cells, edges, faces, is_free)
    split, deep_face = components.follow_deep_cells()
    by_share = components.add_thin(deep_face)
    defects = components.defects_of(components.settle(by_share))
    if defects:
        matched = components.settle(components.match_thin(deep_face, by_share))
        defects = min(defects, components.defects_of(matched), key=len)
    return split + defects


class _Components:
    """Components by their labels in ``GridCells``, and the free face (or -1) that each cell's centre lies in."""

    def __init__(self, cells: GridCells, edges: NDArray[np.int64], faces: Faces, is_free: NDArray[np.bool_]) -> None:
        self.cells, self.is_free = cells, is_free
        face = cells.faces_of_cells(edges, faces)
        self.face: NDArray[np.int64] = np.where(is_free[face], face, -1)
        self.is_speck: NDArray[np.bool_] = np.zeros(len(cells.sizes), bool)
        self.is_speck[cells.speck.ravel()] = True
        self.is_speck[0] = False
        number = np.arange(len(cells.sizes))
        self.is_free_speck = self.is_speck & (number <= cells.free_count)
        self.must_keep = ~self.is_speck & (number > 0) & (number <= cells.free_count)
        self.deep: NDArray[np.bool_] = self.must_keep[cells.labels] & ~cells.near_others()
        self.is_thin = self.must_keep.copy()
        self.is_thin[cells.labels[self.deep]] = False
        self.near = self._near(edges, faces)
        became = (cells.speck > 0) & (self.face >= 0)
        self.opened = _unique_pairs(cells.speck[became], self.face[became], faces.count)
        self.links = self._links()

    def follow_deep_cells(self) -> tuple[Defects, NDArray[np.int64]]:
        """Components whose deep cells are not all in one free face, and (labels,) the face of each, -1 without."""
        pairs, counts = np.unique(
            np.column_stack([self.cells.labels[self.deep], self.face[self.deep]]), axis=0, return_counts=True
        )
        face_of = _most(pairs, counts, len(self.is_speck))
        defects: Defects = []
        for component, face in pairs[face_of[pairs[:, 0]] != pairs[:, 1]].tolist():
            here = self.deep & (self.cells.labels == component) & (self.face == face)
            detail = "a part of a component of free cells lies in " + (
                "another free face than the rest" if face >= 0 else "no free face"
            )
            defects.append((detail, self._place(here)))
        lost = np.setdiff1d(pairs[:, 0], np.flatnonzero(face_of >= 0))
        defects += [("a component of free cells lies in no free face", self._place_of(c)) for c in lost.tolist()]
        return defects, face_of

    def add_thin(self, face_of: NDArray[np.int64]) -> NDArray[np.int64]:
        """Assign each thin component to the face that has most of its cells, if any has."""
        thin = self.is_thin[self.cells.labels] & (self.face >= 0)
        pairs, counts = np.unique(
            np.column_stack([self.cells.labels[thin], self.face[thin]]), axis=0, return_counts=True
        )
        return np.where(self.is_thin, _most(pairs, counts, len(face_of)), face_of)

    def match_thin(self, face_of: NDArray[np.int64], by_share: NDArray[np.int64]) -> NDArray[np.int64]:
        """Assign thin components to faces near them so that as few faces as may be have nothing of their own.

        Those that meet count as one, since they may share a face; with deep cells among them they need none.
        """
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        size = len(face_of)
        links = self.links[(self.must_keep | self.is_free_speck)[self.links].all(axis=1)]
        graph = coo_array((np.ones(len(links), bool), tuple(links.T)), shape=(size, size))
        group = connected_components(graph, directed=False)[1].astype(np.int64)
        may_match = np.zeros(size, bool)
        may_match[group[self.is_thin | self.is_free_speck]] = True
        may_match[group[self.must_keep & ~self.is_thin]] = False
        needy = self.is_free.copy()
        needy[face_of[face_of >= 0]] = False
        matched = _match(
            np.unique(np.column_stack([group[self.near[:, 0]], self.near[:, 1]]), axis=0), needy, may_match
        )
        takes = self.near[self.is_thin[self.near[:, 0]] & (matched[group[self.near[:, 0]]] == self.near[:, 1])]
        result = by_share.copy()
        result[takes[:, 0]] = takes[:, 1]
        return result

    def settle(self, face_of: NDArray[np.int64]) -> NDArray[np.int64]:
        """Move thin components that are connected to nothing in their face to one near them where they are.

        Those that are nowhere may have a face near them to themselves, if one is left over.
        """
        face_of = face_of.copy()
        for _ in range(SETTLE_ROUNDS):
            loose = self.is_thin & (face_of < 0)
            loose[self._strays(face_of)] = True
            loose &= self.is_thin
            if not loose.any():
                break
            fixed = np.flatnonzero(self.must_keep & ~loose & (face_of >= 0))
            nodes, part = self._connect(fixed, face_of, loose)
            is_fixed = np.isin(nodes[:, 0], fixed)
            company = np.bincount(part, self.cells.sizes[nodes[:, 0]] * is_fixed).astype(np.int64)[part]
            options = loose[nodes[:, 0]] & (company > 0)
            moved = _most(nodes[options], company[options], len(face_of))
            alone = loose & (moved < 0)
            needy = self.is_free.copy()
            needy[face_of[fixed]] = False
            moved[alone] = _match(self.near, needy, alone)[alone]
            face_of[moved >= 0] = moved[moved >= 0]
        return face_of

    def defects_of(self, face_of: NDArray[np.int64]) -> Defects:
        """What is wrong if components that must be kept are in the faces ``face_of``, (labels,)."""
        nowhere = np.flatnonzero(self.is_thin & (face_of < 0)).tolist()
        detail = "a component of free cells has no free face near it"
        defects: Defects = [(detail, self._place_of(component)) for component in nowhere]
        detail = "a component of free cells shares a face with others that it is not connected to"
        defects += [(detail, self._place_of(component)) for component in self._strays(face_of).tolist()]
        # Faces that must have come from free specks.
        needy = self.is_free.copy()
        needy[face_of[self.must_keep & (face_of >= 0)]] = False
        needy[self.face[self.deep & (self.face >= 0)]] = False  # they are told of where components are split
        served = _match(self.near, needy, self.is_free_speck)
        needy[served[served >= 0]] = False
        defects += [("a free face without free cells of its own", self.vertex_of[f]) for f in np.flatnonzero(needy)]
        return defects

    def _strays(self, face_of: NDArray[np.int64]) -> NDArray[np.int64]:
        """The components that are not connected, within their face, to the largest part of what is there."""
        kept = np.flatnonzero(self.must_keep & (face_of >= 0))
        nodes, part = self._connect(kept, face_of, np.zeros_like(self.is_thin))
        is_kept = self.must_keep[nodes[:, 0]]
        nodes, part = nodes[is_kept], part[is_kept]
        size = np.bincount(part, self.cells.sizes[nodes[:, 0]])[part]
        order = np.lexsort((part, size, nodes[:, 1]))  # the last one of each face is of its largest part
        largest = np.full(len(self.is_free), -1, np.int64)
        largest[nodes[order, 1]] = part[order]
        strays: NDArray[np.int64] = nodes[part != largest[nodes[:, 1]], 0]
        return strays

    def _connect(
        self, kept: NDArray[np.int64], face_of: NDArray[np.int64], loose: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(n, 2) nodes (component, face), and the connected part of its face that each belongs to.

        ``kept`` ones are in their faces, free specks and ``loose`` ones in each that is near them.
        """
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        near = self.near[(self.is_free_speck | loose)[self.near[:, 0]]]
        nodes = np.unique(np.concatenate([np.column_stack([kept, face_of[kept]]), self.opened, near]), axis=0)
        if len(nodes) == 0:
            return nodes, np.zeros(0, np.int64)
        keys = nodes[:, 0] * len(self.is_free) + nodes[:, 1]
        first, last = (np.searchsorted(nodes[:, 0], self.links[:, 0], side) for side in ("left", "right"))
        tail = _ranges(first, last)
        wanted = np.repeat(self.links[:, 1], last - first) * len(self.is_free) + nodes[tail, 1]
        head = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        linked = keys[head] == wanted
        graph = coo_array(
            (np.ones(np.count_nonzero(linked), bool), (tail[linked], head[linked])), shape=(len(nodes), len(nodes))
        )
        return nodes, connected_components(graph, directed=False)[1].astype(np.int64)

    def _near(self, edges: NDArray[np.int64], faces: Faces) -> NDArray[np.int64]:
        """(n, 2) ascending (component, free face) that are within reach, for thin components and specks."""
        reach = math.ceil(self.cells.epsilon_cells) + 1
        wanted = self.is_speck | self.is_thin
        labels = np.pad(np.where(wanted[self.cells.labels], self.cells.labels, 0), reach)
        face = np.pad(self.face, reach, constant_values=-1)
        # A face may be too thin for the centre of any cell, so the cells along its edges count as well.
        beside = np.concatenate([faces.left, faces.right])
        both = np.tile(edges, (2, 1))[self.is_free[beside]]
        beside = beside[self.is_free[beside]]
        self.vertex_of: NDArray[np.float64] = np.zeros((faces.count, 2))
        self.vertex_of[beside] = both[:, :2] / UNIT
        steps = np.abs(both[:, 2:] - both[:, :2]).max(axis=1) // UNIT
        which = np.repeat(np.arange(len(both)), steps + 1)
        along = (_ranges(np.zeros_like(steps), steps + 1) / steps[which])[:, None]
        points = both[which, :2] + along * (both[which, 2:] - both[which, :2])
        place = np.floor((points - self.cells.origin_yx) / UNIT).astype(np.int64)
        py, px = np.clip(place, 0, np.array(self.face.shape) - 1).T + reach
        py, px, at_edge = np.unique(np.stack([py, px, beside[which]]), axis=1)

        y, x = np.nonzero(labels)
        found = [np.zeros((0, 2), np.int64)]
        for dy in range(-reach, reach + 1):
            for dx in range(-reach, reach + 1):
                found.append(_unique_pairs(labels[y, x], face[y + dy, x + dx], faces.count))
                found.append(_unique_pairs(labels[py + dy, px + dx], at_edge, faces.count))
        pairs = np.unique(np.concatenate(found), axis=0)
        return pairs[pairs[:, 0] > 0]

    def _links(self) -> NDArray[np.int64]:
        """(n, 2) components, specks among them, that meet: at a side, or at a corner without an occupied cell."""
        labels = np.where((self.must_keep | self.is_speck)[self.cells.labels], self.cells.labels, 0)
        open_ = self.cells.states != OCCUPIED
        # Corners: both other cells open. The last two are the corners' own.
        both = open_[:-1, 1:] & open_[1:, :-1]
        other = open_[:-1, :-1] & open_[1:, 1:]
        meetings = (
            (labels[:-1], labels[1:], True),
            (labels[:, :-1], labels[:, 1:], True),
            (labels[:-1, :-1], labels[1:, 1:], both),
            (labels[:-1, 1:], labels[1:, :-1], other),
        )
        found = []
        for a, b, may in meetings:
            meet = (a != b) & (a > 0) & (b > 0) & may
            found.append(np.column_stack([a[meet], b[meet]]))
        return np.unique(np.concatenate(found), axis=0)

    def _place_of(self, component: int) -> NDArray[np.float64]:
        return self._place(self.cells.labels == component)

    def _place(self, here: NDArray[np.bool_]) -> NDArray[np.float64]:
        """The centre of the first of these cells."""
        place: NDArray[np.float64] = (np.argwhere(here)[0] * UNIT + UNIT // 2 + self.cells.origin_yx) / UNIT
        return place


def _unique_pairs(components: NDArray[np.int64], faces: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """(n, 2) the different pairs with a face >= 0; ``count`` is more than any face."""
    key = np.unique((components * count + faces)[faces >= 0])
    return np.column_stack([key // count, key % count])


def _most(pairs: NDArray[np.int64], counts: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """(size,) for each component in (component, face) the face >= 0 that counts most, -1 for others."""
    face_of = np.full(size, -1, np.int64)
    order = np.argsort(counts, kind="stable")
    order = order[pairs[order, 1] >= 0]
    face_of[pairs[order, 0]] = pairs[order, 1]  # the last one stays
    return face_of


def _match(pairs: NDArray[np.int64], faces: NDArray[np.bool_], components: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(labels,) the face, or -1, of each component in a largest matching by the (component, face) allowed."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    component, face = pairs[components[pairs[:, 0]] & faces[pairs[:, 1]]].T
    graph = csr_array((np.ones(len(face), bool), (component, face)), shape=(len(components), len(faces)))
    matched: NDArray[np.int64] = maximum_bipartite_matching(graph, perm_type="column").astype(np.int64)
    return matched


def _ranges(first: NDArray[np.int64], last: NDArray[np.int64]) -> NDArray[np.int64]:
    """All whole numbers of each range, one range after the other."""
    length = last - first
    step: NDArray[np.int64] = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
    return step + np.repeat(first, length)
