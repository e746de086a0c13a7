"""Grid to vector map, tile by tile: a tile's edges follow from its cells and from the edges that it had."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import UNKNOWN

if TYPE_CHECKING:
    from fleetmap.vectorize.tiles.nodes_kernels import Rules
    from fleetmap.vectorize.tiles.states_kernels import Mosaic, Window

TILE_CELLS = 256
APART_CELLS = 6
REACH_CELLS = 50
"""So far from a tile a change of cells may have to do with it: that is how deep walls are measured, and a bit."""

Place = tuple[int, int]
Box = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of an epoch's lattice: states of cells by tiles, as read and without specks, and the edges.

    ``slots`` says which images are those of a tile. Images are never changed while a tile has them.
    """

    slots: dict[Place, int]
    edges: dict[Place, NDArray[np.int64]]
    """(n, 6) tail, head (y, x), label with the lesser state on the left, thickness; of tiles that have any."""
    phase_yx: Place = (0, 0)
    """By how much the grid was off the lattice, in sixteenths of a cell."""


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
    parts = np.split(rows, cuts) if len(rows) else []
    return {(int(ty), int(tx)): part for (ty, tx), part in zip(tiles[[0, *cuts]] if parts else [], parts, strict=True)}


def nodes_of(rows: NDArray[np.int64], tile: Place, size: int) -> NDArray[np.int64]:
    """(k, 2) where edges of a tile end on its upper or right border, which others own: those are nodes."""
    ends = rows[:, :4].reshape(-1, 2)
    found: NDArray[np.int64] = ends[(ends[:, 0] == size * (tile[0] + 1)) | (ends[:, 1] == size * (tile[1] + 1))]
    return found


def nodes_around(edges: dict[Place, NDArray[np.int64]], tile: Place, size: int) -> NDArray[np.int64]:
    """(k, 2) where nodes are on the borders of a tile."""
    found = [np.zeros((0, 2), np.int64)]
    for ty in (tile[0] - 1, tile[0], tile[0] + 1):
        for tx in (tile[1] - 1, tile[1], tile[1] + 1):
            if (ty, tx) in edges:
                found.append(nodes_of(edges[ty, tx], (ty, tx), size))
    return np.concatenate(found)


def as_boxes(rows: NDArray[np.int64]) -> list[Box]:
    """Those that hold any cell."""
    return [(y0, x0, y1, x1) for y0, x0, y1, x1 in rows.tolist() if y0 < y1]


class Tiles:
    """Vectorizes the grids of one epoch, one after the other; see ``Vectorizer``."""

    def __init__(self, *, epsilon2: int, specks: int, share: bool, size: int = TILE_CELLS) -> None:
        self.epsilon2, self.specks, self.share, self.size = epsilon2, specks, share, size
        self.known = Known({}, {})
        self._images = Images(size)

    def update(self, grid: OccupancyGrid, shift_yx: Place, phase_yx: Place) -> Known:
        """What is known with the next grid, whose cell (0, 0) lies at a lattice point, off by a phase in sixteenths."""
        from fleetmap.vectorize.tiles.nodes_kernels import Rules
        from fleetmap.vectorize.tiles.states_kernels import Window

        old = self.known
        slots, boxes = self._read(Window(grid.cells_yx, *shift_yx, *grid.limits), old)
        moved = phase_yx != old.phase_yx
        if not moved and not boxes:
            if slots is not old.slots:
                self.known = Known(slots, old.edges, phase_yx)
            return self.known
        choose2 = min(self.epsilon2, max(self.epsilon2 // 2, 256)) if moved else self.epsilon2
        tiles = sorted(set(slots) | set(old.edges)) if moved else self._around(boxes, REACH_CELLS)
        edges = self._renew(tiles, slots, old, Rules(*phase_yx, self.epsilon2, choose2, self.share))
        self.known = Known(slots, edges, phase_yx)
        return self.known

    def _around(self, boxes: list[Box], reach: int) -> list[Place]:
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

    def _mosaic(self, slots: dict[Place, int], images: NDArray[np.uint8]) -> Mosaic:
        from fleetmap.vectorize.tiles.states_kernels import FAR, Mosaic

        places = np.array(sorted(slots), np.int64).reshape(-1, 2)
        keys = FAR * places[:, 0] + places[:, 1]
        return Mosaic(keys, np.array([slots[place] for place in sorted(slots)], np.int64), images)

    def _read(self, window: Window, old: Known) -> tuple[dict[Place, int], list[Box]]:
        """The new slots, and boxes of cells whose state, without specks, has changed."""
        from fleetmap.vectorize.tiles.states_kernels import fill_tiles, find_changes, read_tiles

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
        reread = [tile for tile, box in zip(tiles, boxes, strict=True) if box[0] < box[2]]
        raw_boxes = as_boxes(boxes)
        if not reread:
            return old.slots, []
        margin = 4 * self.specks + 2 * APART_CELLS + 1 if self.specks else 0
        touched = self._around(raw_boxes, margin)
        fresh = dict(zip(touched, self._images.free(set(old.slots.values()), len(touched)), strict=True))
        images = self._images
        read_tiles(window, np.array(reread, np.int64), np.array([fresh[t] for t in reread], np.int64), images.raw)
        for tile in set(touched) - set(reread):
            images.raw[fresh[tile]] = images.raw[old.slots[tile]] if tile in old.slots else UNKNOWN
        slots = {**old.slots, **fresh}
        jobs = []
        for tile in touched:
            low, high = np.array(tile) * size, np.array(tile) * size + size
            near = [
                b
                for b in raw_boxes
                if b[0] - margin < high[0]
                and b[2] + margin > low[0]
                and b[1] - margin < high[1]
                and b[3] + margin > low[1]
            ]
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
        return slots, as_boxes(found)

    def _renew(
        self, tiles: list[Place], slots: dict[Place, int], old: Known, rules: Rules
    ) -> dict[Place, NDArray[np.int64]]:
        """The edges of all tiles, some of which are renewed."""
        from fleetmap.vectorize.tiles.tile_kernels import renew_tiles

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
