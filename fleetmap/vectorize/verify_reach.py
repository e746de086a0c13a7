"""Which faces a component of free cells could belong to, where its own cells don't tell, and who gets which."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import FREE
from fleetmap.vectorize.verify_cells import GridCells
from fleetmap.vectorize.verify_cover import UNIT, Segments, to_radius2
from fleetmap.vectorize.verify_faces import Faces


def pairs_within_reach(
    cells: GridCells,
    edges: Segments,
    faces: Faces,
    is_free: NDArray[np.bool_],
    face: NDArray[np.int32],
    is_thin: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """(n, 2) ascending (component, free face) at most epsilon and a cell apart, for thin components and specks.

    ``face`` (height + 2, width + 2) is the free face that each cell's centre lies in, or -1.
    """
    reach = math.ceil(cells.epsilon_cells) + 1
    labels = np.pad(np.where((cells.is_speck | is_thin)[cells.labels], cells.labels, 0), reach)
    face = np.pad(face, reach, constant_values=-1)
    # A face may be too thin for the centre of any cell, so the cells along its edges count as well.
    beside, both = _free_sides(edges, faces, is_free)
    steps = np.abs(both[:, 2:] - both[:, :2]).max(axis=1) // UNIT
    which = np.repeat(np.arange(len(both)), steps + 1)
    along = (ranges(np.zeros_like(steps), steps + 1) / steps[which])[:, None]
    points = both[which, :2] + along * (both[which, 2:] - both[which, :2])
    place = np.floor((points - cells.origin_yx) / UNIT).astype(np.int64)
    py, px = np.clip(place, 0, np.array(cells.labels.shape) - 1).T + reach
    py, px, at_edge = np.unique(np.stack([py, px, beside[which]]), axis=1)

    def keys(components: NDArray[np.int32], faces_there: NDArray[np.integer]) -> NDArray[np.int64]:
        return (components.astype(np.int64) * faces.count + faces_there)[faces_there >= 0]

    y, x = np.nonzero(labels)
    found = []
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            found.append(keys(labels[y, x], face[y + dy, x + dx]))
            found.append(keys(labels[py + dy, px + dx], at_edge))
    unique = np.unique(np.concatenate(found))
    pairs = np.column_stack([unique // faces.count, unique % faces.count])
    return pairs[pairs[:, 0] > 0]


def pairs_that_fit(
    cells: GridCells,
    edges: Segments,
    faces: Faces,
    is_free: NDArray[np.bool_],
    is_thin: NDArray[np.bool_],
    within: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Of those ``within`` reach the pairs where the face's own edges are within epsilon of all of the boundary.

    Asked of the middle of each unit of a thin component's boundary. Components that fit nowhere keep all their pairs.
    """
    from fleetmap.vectorize.verify_near_kernels import find_near_numbers

    thin = is_thin[cells.labels]
    cracks, owners = cells.cracks_between((cells.states == FREE).view(np.uint8), (0, 1), cells.labels, thin)
    beside, both = _free_sides(edges, faces, is_free)
    epsilon2 = Fraction(cells.epsilon_cells) ** 2
    near = find_near_numbers((cracks[:, :2] + cracks[:, 2:]) // 2, both, beside, to_radius2(epsilon2) + 1)
    keys, counts = np.unique(owners[near[:, 0]] * faces.count + near[:, 1], return_counts=True)
    fits = counts == np.bincount(owners, minlength=len(is_thin))[keys // faces.count]
    keys = keys[fits]
    fit_somewhere = np.zeros(len(is_thin), bool)
    fit_somewhere[keys // faces.count] = True
    mine = within[:, 0] * faces.count + within[:, 1]
    return within[~fit_somewhere[within[:, 0]] | np.isin(mine, keys)]


def pairs_cut(cells: GridCells, edges: Segments, faces: Faces, is_free: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n, 2) (speck, free face) where an edge of the face cuts through a cell of the speck: a part of it is free."""
    from fleetmap.vectorize.verify_near_kernels import find_near_numbers

    half = UNIT // 2
    y, x = np.nonzero(cells.in_speck)
    centres = np.column_stack([y, x]) * UNIT + half + cells.origin_yx
    beside, both = _free_sides(edges, faces, is_free)
    place, edge = find_near_numbers(centres, both, np.arange(len(both)), to_radius2(Fraction(1, 2))).T
    # A segment and a square are apart if they are along y, along x, or across the segment.
    a, b = both[edge, :2] - centres[place], both[edge, 2:] - centres[place]
    cuts = ((np.minimum(a, b) < half) & (np.maximum(a, b) > -half)).all(axis=1)
    along = b - a
    cuts &= np.abs(along[:, 1] * a[:, 0] - along[:, 0] * a[:, 1]) < half * np.abs(along).sum(axis=1)
    return np.column_stack([cells.labels[y, x][place[cuts]], beside[edge[cuts]]]).astype(np.int64)


def _free_sides(edges: Segments, faces: Faces, is_free: NDArray[np.bool_]) -> tuple[NDArray[np.int64], Segments]:
    """The free faces beside edges, (n,), and those edges, (n, 4)."""
    beside, both = np.concatenate([faces.left, faces.right]), np.tile(edges, (2, 1))
    return beside[is_free[beside]], both[is_free[beside]]


def ranges(first: NDArray[np.int64], last: NDArray[np.int64]) -> NDArray[np.int64]:
    """All whole numbers of each range, one range after the other."""
    length = last - first
    step: NDArray[np.int64] = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
    return step + np.repeat(first, length)


def most(pairs: NDArray[np.int64], counts: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """(size,) for each component in (component, face) the face >= 0 that counts most, -1 for others."""
    face_of = np.full(size, -1, np.int64)
    order = np.argsort(counts, kind="stable")
    order = order[pairs[order, 1] >= 0]
    face_of[pairs[order, 0]] = pairs[order, 1]  # the last one stays
    return face_of


def match(pairs: NDArray[np.int64], faces: NDArray[np.bool_], components: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(labels,) the face, or -1, of each component in a largest matching by the (component, face) allowed.

    Pairs come by component.
    """
    from fleetmap.vectorize.verify_faces_kernels import match_faces

    allowed = pairs[components[pairs[:, 0]] & faces[pairs[:, 1]]]
    if len(allowed) == 0:
        return np.full(len(components), -1, np.int64)
    return match_faces(allowed, np.flatnonzero(components), len(components), len(faces))
