"""Whether the free faces of a vector map are the components of free cells: none lost, split or wrongly joined.

An edge may be epsilon off, so cells near a boundary may lie in another face than the rest of their component.
Cells that are *deep*, more than epsilon from all that isn't free, may not: they say which face is their
component's. A component without any is in the face that most of its cells are in or, if that won't do, in one
near it that no other component is in: the question is whether some assignment keeps all promises.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import FREE, OCCUPIED
from fleetmap.vectorize.verify_cells import GridCells
from fleetmap.vectorize.verify_cover import UNIT, Segments
from fleetmap.vectorize.verify_faces import Faces
from fleetmap.vectorize.verify_reach import match, most, pairs_cut, pairs_that_fit, pairs_within_reach, ranges

Defects = list[tuple[str, NDArray[np.float64]]]
"""What is wrong, and where: (y, x) in cells of the lattice."""

MOST_TRIES = 200
"""So many other assignments of thin components are tried where the first one has defects."""

SETTLE_ROUNDS = 4
"""A thin component that finds its face may show the way to the next one; so often is enough for real maps."""


def find_component_defects(
    cells: GridCells,
    edges: Segments,
    faces: Faces,
    is_free: NDArray[np.bool_],
    face_of: NDArray[np.int32],
    deep: NDArray[np.bool_],
) -> Defects:
    """Find components of free cells and free faces that don't correspond.

    1. Each component that is no speck lies in exactly one free face.
    2. Components in one face are connected: directly where they meet at a corner whose two other cells are not
       occupied, or through each other, free specks near that face, or unknown specks that have become part of it.
    3. A free face without such a component has a free speck of its own near it.

    Parameters
    ----------
    is_free : (faces.count,) which faces are free
    face_of : (height + 2, width + 2) the face that each cell's centre lies in
    deep : (height + 2, width + 2) cells more than epsilon away from those of other states
    """
    components = _Components(cells, edges, faces, is_free, face_of, deep)
    split, deep_face = components.follow_deep_cells()
    by_share = components.add_thin(deep_face)
    defects = components.defects_of(by_share)
    if defects:
        # Components without deep cells, and specks, may belong to any face near them: mostly that is not needed. Those
        # that fit are tried first, since there are fewer.
        within = pairs_within_reach(cells, edges, faces, is_free, components.face, components.is_thin)
        fitting = pairs_that_fit(cells, edges, faces, is_free, components.is_thin, within)
        components.open_specks(pairs_cut(cells, edges, faces, is_free), within)
        for near in (fitting, within):
            components.near = near
            if defects:
                settled = components.settle(by_share)
                defects = min(defects, components.repair(settled), key=len)
    return split + defects


class _Components:
    """Components by their labels in ``GridCells``, and the free face (or -1) that each cell's centre lies in."""

    def __init__(
        self,
        cells: GridCells,
        edges: Segments,
        faces: Faces,
        is_free: NDArray[np.bool_],
        face_of: NDArray[np.int32],
        deep: NDArray[np.bool_],
    ) -> None:
        self.cells, self.faces, self.is_free = cells, faces, is_free
        self.face: NDArray[np.int32] = np.where(is_free, np.arange(faces.count), -1).astype(np.int32)[face_of]
        number = np.arange(len(cells.sizes))
        self.is_free_speck = cells.is_speck & (number <= cells.free_count)
        self.must_keep = ~cells.is_speck & (number > 0) & (number <= cells.free_count)
        self.deep = deep & (cells.states == FREE)  # no specks among them
        self.deep_pairs, self.deep_counts = self._pairs_in(self.deep)
        self.is_thin = self.must_keep.copy()
        self.is_thin[self.deep_pairs[:, 0]] = False
        self.thin_pairs, self.thin_counts = self._pairs_in(self.is_thin[cells.labels] & (self.face >= 0))
        self.opened, _ = self._pairs_in(cells.in_speck & (self.face >= 0))
        self.near = np.concatenate([self.thin_pairs, self.opened])
        self.near = self.near[np.argsort(self.near[:, 0], kind="stable")]
        """(n, 2) (component, free face) that are within reach, for thin components and specks."""
        self.vertex_of: NDArray[np.float64] = np.zeros((faces.count, 2))
        """(faces.count, 2) a vertex (y, x) of each free face, in cells of the lattice."""
        self.vertex_of[faces.left] = self.vertex_of[faces.right] = edges[:, :2] / UNIT
        self.links = self._links()

    def follow_deep_cells(self) -> tuple[Defects, NDArray[np.int64]]:
        """Components whose deep cells are not all in one free face, and (labels,) the face of each, -1 without."""
        pairs = self.deep_pairs
        face_of = most(pairs, self.deep_counts, len(self.must_keep))
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
        return np.where(self.is_thin, most(self.thin_pairs, self.thin_counts, len(face_of)), face_of)

    def open_specks(self, cut: NDArray[np.int64], within: NDArray[np.int64]) -> None:
        """Let specks connect also where a part of them is in the face, or where they may be, beside thin components."""
        beside_thin = np.zeros(len(self.is_thin), bool)
        for a, b in ((0, 1), (1, 0)):
            beside_thin[self.links[self.is_thin[self.links[:, a]], b]] = True
        maybe = within[(beside_thin & self.cells.is_speck)[within[:, 0]]]
        self.opened = np.unique(np.concatenate([self.opened, cut, maybe]), axis=0)

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
            moved = most(nodes[options], company[options], len(face_of))
            alone = loose & (moved < 0)
            needy = self.is_free.copy()
            needy[face_of[fixed]] = False
            taken = self._match_groups(needy, alone)
            moved[alone] = taken[alone]
            face_of[moved >= 0] = moved[moved >= 0]
        return face_of

    def _match_groups(self, needy: NDArray[np.bool_], alone: NDArray[np.bool_]) -> NDArray[np.int64]:
        """(labels,) needy faces for components that are alone; those that meet count as one, and share what is near."""
        from fleetmap.vectorize.verify_faces_kernels import join_all

        group = join_all(self.links[alone[self.links].all(axis=1)], len(alone))
        near = self.near[alone[self.near[:, 0]]]
        pairs = np.unique(np.column_stack([group[near[:, 0]], near[:, 1]]), axis=0)
        matched = match(pairs, needy, alone)
        takes = near[matched[group[near[:, 0]]] == near[:, 1]]
        taken = np.full(len(alone), -1, np.int64)
        taken[takes[:, 0]] = takes[:, 1]
        return taken

    def repair(self, face_of: NDArray[np.int64]) -> Defects:
        """What is wrong after thin components have changed their faces, one or some at a time, wherever that helps."""
        defects = self.defects_of(face_of)
        seen = {face_of.tobytes()}
        waiting = [face_of]
        while defects and waiting:
            for trial in self._moves(waiting.pop(0)):
                if len(seen) >= MOST_TRIES:
                    return defects
                if trial.tobytes() in seen:
                    continue
                seen.add(trial.tobytes())
                now = self.defects_of(trial)
                if len(now) < len(defects):
                    defects, waiting = now, [trial]
                    break
                if len(now) == len(defects):
                    waiting.append(trial)
        return defects

    def _moves(self, face_of: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
        """Assignments in which a face that has none takes a thin component near it, and that one's face another one.

        And so on, until a face has more than one, or the component was nowhere. Then those in which one that is
        nowhere takes a face, with those that it meets, and another one leaves it; and those in which one leaves a face
        whose components are not connected.
        """
        kept = self.must_keep & (face_of >= 0)
        many = np.bincount(face_of[kept], minlength=len(self.is_free)) > 1
        near_face: dict[int, list[int]] = {}
        for component, face in self.near[self.is_thin[self.near[:, 0]]].tolist():
            near_face.setdefault(face, []).append(component)
        for needy in np.flatnonzero(self._needy(face_of)).tolist():
            seen = {needy}
            queue: list[tuple[int, dict[int, int]]] = [(needy, {})]
            for face, path in queue:  # it grows
                for component in near_face.get(face, []):
                    source = int(face_of[component])
                    if source == face or component in path:
                        continue
                    moves = path | {component: face}
                    if source < 0 or many[source]:
                        trial = face_of.copy()
                        trial[list(moves)] = list(moves.values())
                        yield trial
                    if source >= 0 and source not in seen:
                        seen.add(source)
                        queue.append((source, moves))
        reach: dict[int, list[int]] = {}
        for face, components in near_face.items():
            for component in components:
                reach.setdefault(component, []).append(face)
        for component in np.flatnonzero(self.is_thin & (face_of < 0)).tolist():
            meets = {component, *self.links[(self.links == component).any(axis=1)].ravel().tolist()}
            for face in reach.get(component, []):
                moves = dict.fromkeys(meets.intersection(near_face[face]), face)
                for other in np.flatnonzero(self.is_thin & (face_of == face)).tolist():
                    for instead in reach.get(other, []) if other not in moves else []:
                        trial = face_of.copy()
                        trial[[*moves, other]] = [*moves.values(), instead]
                        yield trial
        torn = np.zeros(len(self.is_free), bool)
        torn[face_of[self._strays(face_of)]] = True
        for component, faces in reach.items():
            for face in faces if face_of[component] >= 0 and torn[face_of[component]] else []:
                trial = face_of.copy()
                trial[component] = face
                yield trial

    def defects_of(self, face_of: NDArray[np.int64]) -> Defects:
        """What is wrong if components that must be kept are in the faces ``face_of``, (labels,)."""
        nowhere = np.flatnonzero(self.is_thin & (face_of < 0)).tolist()
        detail = "a component of free cells has no free face near it"
        defects: Defects = [(detail, self._place_of(component)) for component in nowhere]
        detail = "a component of free cells shares a face with others that it is not connected to"
        defects += [(detail, self._place_of(component)) for component in self._strays(face_of).tolist()]
        detail = "a free face without free cells of its own"
        defects += [(detail, self.vertex_of[face]) for face in np.flatnonzero(self._needy(face_of))]
        return defects

    def _needy(self, face_of: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(faces.count,) free faces without a component or a free speck that they may have come from."""
        needy = self.is_free.copy()
        needy[face_of[self.must_keep & (face_of >= 0)]] = False
        told = self.deep_pairs[:, 1]
        needy[told[told >= 0]] = False  # they are told of where components are split
        served = match(self.near, needy, self.is_free_speck)
        needy[served[served >= 0]] = False
        return needy

    def _strays(self, face_of: NDArray[np.int64]) -> NDArray[np.int64]:
        """The components that are not connected, within their face, to the largest part of what is there."""
        kept = np.flatnonzero(self.must_keep & (face_of >= 0))
        if np.bincount(face_of[kept]).max(initial=0) < 2:
            return np.zeros(0, np.int64)
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
        from fleetmap.vectorize.verify_faces_kernels import join_all

        count = len(self.is_free)
        near = self.near[(self.is_free_speck | loose)[self.near[:, 0]]]
        keys = np.unique(np.concatenate([kept * count + face_of[kept], self.opened @ [count, 1], near @ [count, 1]]))
        nodes = np.column_stack([keys // count, keys % count])
        if len(nodes) == 0:
            return nodes, np.zeros(0, np.int64)
        first, last = (np.searchsorted(nodes[:, 0], self.links[:, 0], side) for side in ("left", "right"))
        tail = ranges(first, last)
        wanted = np.repeat(self.links[:, 1], last - first) * count + nodes[tail, 1]
        head = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        linked = keys[head] == wanted
        return nodes, join_all(np.column_stack([tail[linked], head[linked]]), len(nodes))

    def _links(self) -> NDArray[np.int64]:
        """(n, 2) components, specks among them, that meet: at a side, or at a corner without an occupied cell."""
        labels = np.where((self.must_keep | self.cells.is_speck)[self.cells.labels], self.cells.labels, 0)
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
            found.append(a[meet].astype(np.int64) * len(self.must_keep) + b[meet])
        keys = np.unique(np.concatenate(found))
        return np.column_stack([keys // len(self.must_keep), keys % len(self.must_keep)])

    def _pairs_in(self, where: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(n, 2) the different (component, face or -1) of some cells, and how many cells each has."""
        size = self.faces.count + 1
        keys = self.cells.labels[where].astype(np.int64) * size + self.face[where] + 1
        first = np.flatnonzero(np.diff(keys, prepend=-1))  # neighbours are mostly alike: sort runs, not cells
        pairs, run = np.unique(keys[first], return_inverse=True)
        counts = np.bincount(run, np.diff(first, append=len(keys)), minlength=len(pairs)).astype(np.int64)
        return np.column_stack([pairs // size, pairs % size - 1]), counts

    def _place_of(self, component: int) -> NDArray[np.float64]:
        return self._place(self.cells.labels == component)

    def _place(self, here: NDArray[np.bool_]) -> NDArray[np.float64]:
        """The centre of the first of these cells."""
        place: NDArray[np.float64] = (np.argwhere(here)[0] * UNIT + UNIT // 2 + self.cells.origin_yx) / UNIT
        return place
