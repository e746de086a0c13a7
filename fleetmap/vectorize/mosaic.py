"""Grid to vector map, tile by tile: a tile's edges follow from its cells and from the edges that it had."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import UNKNOWN
from fleetmap.model.vectormap import VectorMap, make_label

TILE_CELLS = 256
APART_CELLS = 6
REACH_CELLS = 50
"""So far from a tile a change of cells may have to do with it: that is how deep walls are measured, and a bit."""

Place = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of an epoch's lattice: states of cells by tiles, as read and without specks, and the edges.

    ``slots`` says which images are those of a tile. Images are never changed while a tile has them.
    """

    slots: dict[Place, int]
    edges: dict[Place, NDArray[np.int64]]
    """(n, 6) tail, head (y, x), label with the lesser state on the left, thickness; of tiles that have any."""


@dataclass(slots=True)
class Images:
    """Room for the states of tiles; grows, and is used again."""

    size: int
    raw: NDArray[np.uint8] = field(init=False)
    states: NDArray[np.uint8] = field(init=False)

    def __post_init__(self) -> None:
        self.raw = np.empty((4, self.size, self.size), np.uint8)
        self.states = np.empty((4, self.size, self.size), np.uint8)

    def free(self, used: set[int], count: int) -> list[int]:
        """Numbers of ``count`` images that nobody uses."""
        room = len(self.raw)
        found = [slot for slot in range(room) if slot not in used][:count]
        if len(found) < count:
            more = max(count - len(found), room)
            self.raw = np.concatenate([self.raw, np.empty((more, self.size, self.size), np.uint8)])
            self.states = np.concatenate([self.states, np.empty((more, self.size, self.size), np.uint8)])
            found += range(room, room + count - len(found))
        return found


def directed(edges: NDArray[np.int32], thickness: NDArray[np.uint8]) -> NDArray[np.int64]:
    """(n, 6) rows of a map, each walked with the lesser state on its left."""
    rows = np.column_stack([edges, thickness]).astype(np.int64)
    left, right = np.divmod(rows[:, 4], 3)
    turned = left > right
    rows[turned, :4] = rows[turned][:, [2, 3, 0, 1]]
    rows[turned, 4] = 3 * right[turned] + left[turned]
    return rows


def by_tile(rows: NDArray[np.int64], size: int) -> dict[Place, NDArray[np.int64]]:
    """Edges by the tile that they lie in: that of their middle, since none lies on a border of another tile."""
    tiles = (rows[:, 0:2] + rows[:, 2:4]) // (2 * size)
    order = np.lexsort((tiles[:, 1], tiles[:, 0]))
    rows, tiles = rows[order], tiles[order]
    cuts = np.flatnonzero((tiles[1:] != tiles[:-1]).any(axis=1)) + 1
    starts = [0, *cuts.tolist()] if len(rows) else []
    return {tuple(tiles[a].tolist()): part for a, part in zip(starts, np.split(rows, cuts), strict=True)} if starts else {}


def nodes_around(edges: dict[Place, NDArray[np.int64]], tile: Place, size: int) -> NDArray[np.int64]:
    """(k, 2) where nodes are on the borders of a tile: where edges of the tile below or to the left of a border end."""
    found = [np.zeros((0, 2), np.int64)]
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            rows = edges.get((tile[0] + dy, tile[1] + dx))
            if rows is None:
                continue
            ends = rows[:, :4].reshape(-1, 2)
            # On the upper or right border of their own tile.
            high = [size * (tile[0] + dy + 1), size * (tile[1] + dx + 1)]
            found.append(ends[(ends == high).any(axis=1)])
    return np.unique(np.concatenate(found), axis=0)


class Tiles:
    """Vectorizes the grids of one epoch, one after the other; see ``Vectorizer``."""

    def __init__(self, *, epsilon2: int, specks: int, share: bool, size: int = TILE_CELLS) -> None:
        self.epsilon2, self.specks, self.share, self.size = epsilon2, specks, share, size
        self.known = Known({}, {})
        self._images = Images(size)
        self.phase_yx = (0, 0)

    def update(self, grid: OccupancyGrid, shift_yx: Place, phase_yx: Place) -> Known:
        """What is known with the next grid, whose cell (0, 0) lies at a lattice point, off by a phase in sixteenths."""
        from fleetmap.vectorize.nodes_kernels import Rules
        from fleetmap.vectorize.states_kernels import Window

        old = self.known
        slots, boxes = self._read(Window(grid.cells_yx, *shift_yx, *grid.limits), old)
        moved = phase_yx != self.phase_yx
        if not moved and not boxes:
            return old
        choose2 = min(self.epsilon2, max(self.epsilon2 // 2, 256)) if moved else self.epsilon2
        tiles = sorted(set(slots) | set(old.edges)) if moved else self._around(boxes, REACH_CELLS)
        edges = self._renew(tiles, slots, old, Rules(*phase_yx, self.epsilon2, choose2, self.share))
        self.known, self.phase_yx = Known(slots, edges), phase_yx
        return self.known

    def _around(self, boxes: list[tuple[int, int, int, int]], reach: int) -> list[Place]:
        """Tiles that have a cell within ``reach`` of one of the boxes."""
        size = self.size
        return sorted(
            {
                (ty, tx)
                for y0, x0, y1, x1 in boxes
                for ty in range((y0 - reach) // size, (y1 - 1 + reach) // size + 1)
                for tx in range((x0 - reach) // size, (x1 - 1 + reach) // size + 1)
            }
        )

    def _mosaic(self, slots: dict[Place, int], images: NDArray[np.uint8]) -> object:
        from fleetmap.vectorize.states_kernels import FAR, Mosaic

        places = np.array(sorted(slots), np.int64).reshape(-1, 2)
        keys = FAR * places[:, 0] + places[:, 1]
        return Mosaic(keys, np.array([slots[place] for place in sorted(slots)], np.int64), images)

    def _read(self, window: object, old: Known) -> tuple[dict[Place, int], list[tuple[int, int, int, int]]]:
        """The new slots, and boxes of cells whose state, without specks, has changed."""
        from fleetmap.vectorize.states_kernels import fill_tiles, find_changes, read_tiles

        size = self.size
        height, width = window.cells.shape
        within = {
            (ty, tx)
            for ty in range(window.low_y // size, (window.low_y + height - 1) // size + 1)
            for tx in range(window.low_x // size, (window.low_x + width - 1) // size + 1)
        }
        tiles = sorted(within | set(old.slots))
        boxes = np.empty((len(tiles), 4), np.int64)
        find_changes(window, np.array(tiles, np.int64), self._mosaic(old.slots, self._images.raw), boxes)
        changed = [(tile, tuple(box)) for tile, box in zip(tiles, boxes.tolist(), strict=True) if box[0] < box[2]]
        if not changed:
            return old.slots, []
        margin = 4 * self.specks + 2 * APART_CELLS + 1 if self.specks else 0
        raw_boxes = [box for _, box in changed]
        touched = self._around(raw_boxes, margin)
        fresh = dict(zip(touched, self._images.free(set(old.slots.values()), len(touched)), strict=True))
        images = self._images
        reread = [tile for tile, _ in changed]
        read_tiles(window, np.array(reread, np.int64), np.array([fresh[t] for t in reread], np.int64), images.raw)
        for tile in set(touched) - set(reread):
            images.raw[fresh[tile]] = images.raw[old.slots[tile]] if tile in old.slots else UNKNOWN
        slots = {**old.slots, **fresh}
        jobs = []
        for tile in touched:
            low, high = np.array(tile) * size, np.array(tile) * size + size
            near = [b for b in raw_boxes if b[0] - margin < high[0] and b[2] + margin > low[0] and b[1] - margin < high[1] and b[3] + margin > low[1]]
            y0, x0 = max(min(b[0] for b in near) - margin, low[0]), max(min(b[1] for b in near) - margin, low[1])
            y1, x1 = min(max(b[2] for b in near) + margin, high[0]), min(max(b[3] for b in near) + margin, high[1])
            jobs.append((y0, x0, y1, x1, old.slots.get(tile, -1), fresh[tile]))
        found = np.empty((len(jobs), 4), np.int64)
        fill_tiles(
            self._mosaic(slots, images.raw), np.array(jobs, np.int64), self.specks, APART_CELLS, images.states, found
        )
        # Tiles that are unknown altogether need no image.
        for tile in touched:
            if (images.raw[slots[tile]] == UNKNOWN).all() and (images.states[slots[tile]] == UNKNOWN).all():
                del slots[tile]
        return slots, [tuple(box) for box in found.tolist() if box[0] < box[2]]

    def _renew(
        self, tiles: list[Place], slots: dict[Place, int], old: Known, rules: object
    ) -> dict[Place, NDArray[np.int64]]:
        """The edges of all tiles, some of which are renewed."""
        from fleetmap.vectorize.tile_kernels import renew_tiles

        none = np.zeros((0, 6), np.int64)
        olds = [old.edges.get(tile, none) for tile in tiles]
        nodes = [nodes_around(old.edges, tile, self.size) for tile in tiles]
        rows, ends = renew_tiles(
            self._mosaic(slots, self._images.states), np.array(tiles, np.int64).reshape(-1, 2),
            np.concatenate([none, *olds]), np.cumsum([len(o) for o in olds]),
            np.concatenate([np.zeros((0, 2), np.int64), *nodes]), np.cumsum([len(n) for n in nodes]), rules,
        )  # fmt: skip
        edges = dict(old.edges)
        for tile, part in zip(tiles, np.split(rows, ends[:-1]), strict=True):
            if len(part):
                edges[tile] = part
            else:
                edges.pop(tile, None)
        return edges
