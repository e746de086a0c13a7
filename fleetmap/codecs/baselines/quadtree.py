"""A quadtree at 2 bits a node, then deflate: the idea of OctoMap in the plane.

Each level halves the one below it, rounded up. A node is the state of all its cells, or MIXED; only the children of
mixed nodes are sent, level after level from the root, row after row.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.baselines.protocol import Cells
from fleetmap.codecs.deflate import deflate, inflate

MIXED = 3
SHIFTS = np.array([6, 4, 2, 0], np.uint8)
"""Of the four nodes in a byte."""


def pack(states_yx: Cells) -> bytes:
    """(height, width) states -> the nodes of all levels, four a byte."""
    levels = [states_yx.view(np.uint8)]
    while levels[-1].size > 1:
        levels.append(_parents(levels[-1]))
    nodes = [levels[-1].ravel()]
    for parents, children in zip(levels[:0:-1], levels[-2::-1], strict=True):
        nodes.append(children[_children(parents, children.shape) == MIXED])
    return deflate(_to_bytes(np.concatenate(nodes)))


def unpack(data: bytes, shape: tuple[int, int]) -> Cells:
    """(height, width) uint8 states."""
    shapes = [shape]
    while shapes[-1] != (1, 1):
        height, width = shapes[-1]
        shapes.append(((height + 1) // 2, (width + 1) // 2))
    packed = np.frombuffer(inflate(data, max_bytes=sum(height * width for height, width in shapes)), np.uint8)
    nodes = (packed[:, None] >> SHIFTS & np.uint8(MIXED)).ravel()
    level: NDArray[np.uint8] = nodes[:1].reshape(1, 1)
    read = 1
    for finer in shapes[-2::-1]:
        level = _children(level, finer)
        sent = level == MIXED
        count = int(np.count_nonzero(sent))
        level[sent] = nodes[read : read + count]
        read += count
    return level


def _parents(level: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The next coarser level; a row or column without a partner is its own."""
    height, width = level.shape
    level = np.pad(level, ((0, height % 2), (0, width % 2)), mode="edge")
    a, b, c, d = level[::2, ::2], level[::2, 1::2], level[1::2, ::2], level[1::2, 1::2]
    return np.where((a == b) & (b == c) & (c == d), a, np.uint8(MIXED))


def _children(level: NDArray[np.uint8], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Each node four times: the next finer level, but for what is in mixed nodes."""
    return np.ascontiguousarray(level.repeat(2, axis=0).repeat(2, axis=1)[: shape[0], : shape[1]])


def _to_bytes(nodes: NDArray[np.uint8]) -> bytes:
    fours = np.pad(nodes, (0, -len(nodes) % len(SHIFTS))).reshape(-1, len(SHIFTS))
    packed: NDArray[np.uint8] = np.bitwise_or.reduce(fours << SHIFTS, axis=1)
    return packed.tobytes()
