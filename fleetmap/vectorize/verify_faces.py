"""The faces into which a vector map's edges divide the plane, and whether the edges meet only at vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.lattice import OCCUPIED, UNKNOWN

STATE_NAMES = ("free", "occupied", "unknown")


def find_crossings(edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Find the pairs of edges that share more than a common endpoint.

    Parameters
    ----------
    edges : (n, 4) rows (y0, x0, y1, x1), lower endpoint first, |coordinate| <= 2^20

    Returns
    -------
    (m, 2) int64 : indices of the two edges, the lesser first; exact
    """
    from fleetmap.vectorize.verify_faces_kernels import find_bad_meetings

    return find_bad_meetings(np.ascontiguousarray(edges))


@dataclass(frozen=True, eq=False)
class Faces:
    """The faces of n edges that meet only at vertices.

    Parameters
    ----------
    left, right : (n,) face to the left and right of each edge, seen from its first endpoint
    count : number of faces, with the unbounded one
    outside : the unbounded face
    """

    left: NDArray[np.int64]
    right: NDArray[np.int64]
    count: int
    outside: int


def find_faces(edges: NDArray[np.int64]) -> Faces:
    """Find the faces of edges, (n, 4) rows (y0, x0, y1, x1), lower endpoint first, that meet only at vertices.

    Half-edge 2 e runs along edge e, 2 e + 1 back; each has one face to its left. Half-edges that follow each
    other around a face, and those that see each other across it, belong to one face.
    """
    from fleetmap.vectorize.verify_faces_kernels import join_faces

    if len(edges) == 0:
        return Faces(np.zeros(0, np.int64), np.zeros(0, np.int64), 1, 0)
    edges = np.ascontiguousarray(edges)
    tails_yx = edges.reshape(-1, 2)  # of half-edge 0, 1, 2...: since 2 e starts where 2 e + 1 ends
    towards = edges[:, 2:] - edges[:, :2]
    towards = np.stack([towards, -towards], axis=1).reshape(-1, 2)
    # Directions of lattice edges differ by over 2^-42, which arctan2 resolves.
    order = np.lexsort((np.arctan2(towards[:, 0], towards[:, 1]), tails_yx[:, 1], tails_yx[:, 0]))
    roots, face = np.unique(join_faces(edges, order), return_inverse=True)
    face = face.astype(np.int64)
    return Faces(face[:-1:2], face[1:-1:2], len(roots), int(face[-1]))


def find_states(
    faces: Faces, left: NDArray[np.int64], right: NDArray[np.int64]
) -> tuple[NDArray[np.int64], list[tuple[int, str]]]:
    """Ask the edges which state each face has; the unbounded one is unknown.

    Parameters
    ----------
    left, right : (n,) states to the left and right of each edge

    Returns
    -------
    states : (faces.count,)
    odd : for each face about which they disagree an edge that is in the minority, and what they say
    """
    beside, said = np.concatenate([faces.left, faces.right]), np.concatenate([left, right])
    votes = np.bincount(3 * beside + said, minlength=3 * faces.count).reshape(-1, 3)
    outside = votes[faces.outside].copy()
    votes[faces.outside, UNKNOWN] = len(beside) + 1  # nothing outvotes it
    odd = []
    for face in np.flatnonzero((votes > 0).sum(axis=1) > 1).tolist():
        few = int(np.argmin(np.where(votes[face] > 0, votes[face], 2 * len(beside))))
        edge = int(np.flatnonzero((beside == face) & (said == few))[0]) % len(left)
        counts = outside if face == faces.outside else votes[face]
        parts = [f"{count} {name}" for count, name in zip(counts.tolist(), STATE_NAMES, strict=True) if count]
        where = "the unbounded face, which is unknown" if face == faces.outside else "one face"
        odd.append((edge, f"edges disagree about {where}: {', '.join(parts)}"))
    return votes.argmax(axis=1), odd


def find_odd_outlines(
    edges: NDArray[np.int64], left: NDArray[np.int64], right: NDArray[np.int64]
) -> list[tuple[int, str]]:
    """Find outlines of obstacles, edges that hang together, that enclose nothing or are turned inside out.

    Obstacles may lie in the holes of others, and these holes may have no outline: then what is unknown around the
    inner one lies where the outer one is occupied. What is occupied outside must be a hole in another obstacle.

    Returns
    -------
    An edge of each such outline, and what is wrong with it
    """
    from fleetmap.vectorize.verify_faces_kernels import join_all

    if len(edges) == 0:
        return []
    _, vertex = np.unique(edges.reshape(-1, 2) @ np.array([1 << 24, 1]), return_inverse=True)
    ends = vertex.reshape(-1, 2).astype(np.int64)
    _, part = np.unique(join_all(ends, int(ends.max()) + 1)[ends[:, 0]], return_inverse=True)
    # Side by side, none lies around another.
    pitch = int(np.ptp(edges[:, 1::2])) + 1
    alone, together = find_faces(edges + np.outer(part * pitch, np.array([0, 1, 0, 1]))), find_faces(edges)
    said, beside = np.concatenate([left, right]), np.concatenate([together.left, together.right])
    own = np.concatenate([alone.left, alone.right])
    outer = own == alone.outside
    own = np.where(outer, alone.count + np.tile(part, 2), own)
    votes = np.bincount(3 * own + said, minlength=3 * (own.max() + 1)).reshape(-1, 3)
    torn = (votes > 0).sum(axis=1) > 1
    inside = np.zeros(together.count, bool)
    inside[beside[~outer & (said == OCCUPIED)]] = True
    turned = outer & (said == OCCUPIED) & ~inside[beside] & ~torn[own]
    odd = []
    for wrong, detail in (
        (torn[own], "hidden edges disagree about what they enclose"),
        (turned, "hidden edges are occupied outside, and lie in no obstacle"),
    ):
        _, first = np.unique(own[wrong], return_index=True)
        odd += [(int(edge) % len(edges), detail) for edge in np.flatnonzero(wrong)[first]]
    return odd
