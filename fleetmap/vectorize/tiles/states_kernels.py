"""Kernels that keep the states of cells tile by tile: what a grid changed, and what becomes of it without specks.

Tile (ty, tx) holds the cells from (size * ty, size * tx) on; one that isn't stored is unknown altogether. States:
FREE = 0, OCCUPIED = 1, UNKNOWN = 2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fleetmap.model.kernel import kernel
from fleetmap.model.kernel_types import Cells, Image, Images, Ints, Rows
from fleetmap.vectorize.cells_kernels import find_cracks
from fleetmap.vectorize.speck_kernels import fill_specks

FAR = 1 << 24
"""More than there are tiles in a row."""


class Mosaic(NamedTuple):
    """Tiles by their keys, ascending: ``FAR * ty + tx``, and which image is theirs."""

    keys: Ints
    slots: Ints
    images: Images


class Window(NamedTuple):
    """A grid: its cell (0, 0) is the lattice's cell (low_y, low_x); free up to, occupied from so many per cent."""

    cells: Cells
    low_y: int
    low_x: int
    free: int
    occupied: int


@kernel
def slot_of(mosaic: Mosaic, ty: int, tx: int) -> int:
    """Which image a tile has, or -1."""
    key = FAR * ty + tx
    low, high = 0, len(mosaic.keys)
    while low < high:
        middle = (low + high) // 2
        if mosaic.keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return mosaic.slots[low] if low < len(mosaic.keys) and mosaic.keys[low] == key else np.int64(-1)


@kernel
def cut_out(mosaic: Mosaic, low_y: int, low_x: int, height: int, width: int) -> Image:
    """The states of a part of the lattice."""
    size = mosaic.images.shape[1]
    found = np.full((height, width), 2, np.uint8)
    for ty in range(low_y // size, (low_y + height - 1) // size + 1):
        for tx in range(low_x // size, (low_x + width - 1) // size + 1):
            slot = slot_of(mosaic, ty, tx)
            if slot < 0:
                continue
            y0, y1 = max(low_y, ty * size), min(low_y + height, ty * size + size)
            x0, x1 = max(low_x, tx * size), min(low_x + width, tx * size + size)
            for y in range(y0, y1):
                found[y - low_y, x0 - low_x : x1 - low_x] = mosaic.images[
                    slot, y - ty * size, x0 - tx * size : x1 - tx * size
                ]
    return found


@kernel
def find_changes(window: Window, tiles: Rows, mosaic: Mosaic, boxes: Rows) -> None:
    """Where the grid differs from what is stored; outside of the grid all is unknown.

    Parameters
    ----------
    tiles : (n, 2) tiles (ty, tx) to look at
    boxes : (n, 4) out: cells (y0, x0, y1, x1) of the lattice, half open, that hold all changes of a tile; y1 = y0 if
        there are none
    """
    size = mosaic.images.shape[1]
    height, width = window.cells.shape
    free, occupied = np.int8(window.free), np.int8(window.occupied)
    new, none = np.empty(size, np.uint8), np.full(size, 2, np.uint8)
    for k in range(len(tiles)):
        low_y, low_x = size * tiles[k, 0], size * tiles[k, 1]
        slot = slot_of(mosaic, tiles[k, 0], tiles[k, 1])
        a = min(max(window.low_x - low_x, 0), size)
        b = min(max(window.low_x + width - low_x, 0), size)
        y0, x0, y1, x1 = np.int64(size), np.int64(size), np.int64(0), np.int64(0)
        new[:] = 2
        for y in range(size):
            row = low_y + y - window.low_y
            if 0 <= row < height and a < b:
                source = window.cells[row, low_x + a - window.low_x : low_x + b - window.low_x]
                target = new[a:b]
                for j in range(len(source)):
                    cell = source[j]
                    state = np.uint8(0) if cell <= free else np.uint8(2)
                    state = np.uint8(1) if cell >= occupied else state
                    target[j] = state if cell >= 0 else np.uint8(2)
            else:
                new[:] = 2
            old = mosaic.images[slot, y] if slot >= 0 else none
            differ = np.uint8(0)
            for j in range(size):
                differ |= new[j] ^ old[j]
            if differ == 0:
                continue
            first, last = 0, size
            while new[first] == old[first]:
                first += 1
            while new[last - 1] == old[last - 1]:
                last -= 1
            y0, y1 = min(y0, y), y + 1
            x0, x1 = min(x0, first), max(x1, last)
        boxes[k, 0], boxes[k, 1] = low_y + y0, low_x + x0
        boxes[k, 2], boxes[k, 3] = low_y + max(y0, y1), low_x + max(x0, x1)


@kernel
def read_tiles(window: Window, tiles: Rows, slots: Ints, images: Images) -> None:
    """Write the states of tiles, as the grid has them, into their images."""
    size = images.shape[1]
    height, width = window.cells.shape
    for k in range(len(tiles)):
        low_y, low_x = size * tiles[k, 0] - window.low_y, size * tiles[k, 1] - window.low_x
        image = images[slots[k]]
        image[:] = 2
        for y in range(max(-low_y, 0), min(height - low_y, size)):
            for x in range(max(-low_x, 0), min(width - low_x, size)):
                cell = window.cells[low_y + y, low_x + x]
                if cell >= window.occupied:
                    image[y, x] = 1
                elif 0 <= cell <= window.free:
                    image[y, x] = 0


@kernel
def fill_tile(raw: Mosaic, box: Ints, most: int, apart: int, filled: Image) -> tuple[int, int]:
    """Write the states of a box of cells (y0, x0, y1, x1), without specks, into ``filled``; how many there were.

    The rule is one for the whole lattice (``speck_kernels``): what a tile makes of a speck on its border, the next
    one makes of it, too.
    """
    margin = 4 * most + 2 * apart + 1
    low_y, low_x = box[0] - margin - most, box[1] - margin - most
    height = box[2] - low_y + margin + most
    width = (box[3] - low_x + margin + most + 7) // 8 * 8
    states = cut_out(raw, low_y, low_x, height, width)
    cracks = np.zeros((height, width), np.uint8)
    find_cracks(states, cracks, 1, 1, height, width)
    corners = np.empty((2048, 2), np.int32)
    words = cracks.view(np.uint64)
    count = 0
    first, last = margin, width - margin
    for y in range(margin, height - margin):
        for w in range(first >> 3, (last + 7) >> 3):
            # The first cells of components have cracks below and to the left. Eight at a time.
            if words[y, w] & (words[y, w] >> np.uint64(1)) & np.uint64(0x0101010101010101) == 0:
                continue
            for x in range(max(8 * w, first), min(8 * w + 8, last)):
                if cracks[y, x] & 3 != 3 or states[y, x] == 1:
                    continue
                if count == len(corners):
                    corners = np.concatenate((corners, corners))
                corners[count, 0], corners[count, 1] = y, x
                count += 1
    seen = np.zeros((height, width), np.uint8)
    specks = fill_specks(states, cracks, seen, corners, count, most, apart, low_y, low_x)
    y0, x0 = box[0] - low_y, box[1] - low_x
    filled[:] = states[y0 : y0 + filled.shape[0], x0 : x0 + filled.shape[1]]
    return specks


@kernel
def fill_tiles(raw: Mosaic, jobs: Rows, most: int, apart: int, states: Images, boxes: Rows) -> tuple[int, int]:
    """Bring the states without specks up to date.

    Parameters
    ----------
    jobs : (n, 6) what to fill, cells (y0, x0, y1, x1) of one tile; the image of ``states`` that it had, or -1, and the
        one that it gets
    boxes : (n, 4) out: the cells that changed, as in ``find_changes``

    Returns
    -------
    How many specks were filled where it was looked, and their cells
    """
    size = states.shape[1]
    specks, cells = 0, 0
    for k in range(len(jobs)):
        low_y, low_x = jobs[k, 0] // size * size, jobs[k, 1] // size * size
        y0, x0, y1, x1 = jobs[k, 0] - low_y, jobs[k, 1] - low_x, jobs[k, 2] - low_y, jobs[k, 3] - low_x
        old, image = jobs[k, 4], states[jobs[k, 5]]
        if old >= 0:
            image[:] = states[old]
        else:
            image[:] = 2
        filled = np.empty((y1 - y0, x1 - x0), np.uint8)
        if most > 0:
            found = fill_tile(raw, jobs[k], most, apart, filled)
            specks, cells = specks + found[0], cells + found[1]
        else:
            filled[:] = cut_out(raw, jobs[k, 0], jobs[k, 1], y1 - y0, x1 - x0)
        boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3] = low_y + size, low_x + size, low_y, low_x
        for y in range(y0, y1):
            new, last = filled[y - y0], image[y, x0:x1]
            differ = np.uint8(0)
            for j in range(len(new)):
                differ |= new[j] ^ last[j]
            if differ == 0:
                continue
            a, b = 0, len(new)
            while new[a] == last[a]:
                a += 1
            while new[b - 1] == last[b - 1]:
                b -= 1
            boxes[k, 0], boxes[k, 2] = min(boxes[k, 0], low_y + y), low_y + y + 1
            boxes[k, 1], boxes[k, 3] = min(boxes[k, 1], low_x + x0 + a), max(boxes[k, 3], low_x + x0 + b)
            last[:] = new
    return specks, cells
