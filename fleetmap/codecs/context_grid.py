"""The exact layer: a grid of three states through the range coder, each cell guessed from those around it.

JBIG's idea (a binary arithmetic coder with the neighbourhood as its context) for three states, and with the guesses of
several neighbourhoods mixed by their odds as in Mahoney's PAQ (logistic mixing, 2005). Where the grid was drawn from a
vector map that the receiver has, that drawing is one of the neighbourhoods: vectors first, and later the rest.
``docs/format.md`` has it all on a page. Whole numbers only: the same bytes on every machine.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs.leb128 import MAX_BYTES, decode_leb128, encode_leb128
from fleetmap.codecs.range_coder import check
from fleetmap.model.errors import WireError
from fleetmap.model.lattice import UNKNOWN

MAX_CELLS, CELLS_PER_BYTE = 1 << 25, 1 << 18
"""A payload of B bytes holds at most min(2^25, 2^18 B) cells: 33 MB, and some 25 ns a cell of a map."""

CHANCES = (
    0, 1, 1, 2, 3, 5, 8, 13, 22, 36, 60, 98, 162, 267, 439, 720, 1179, 1921, 3108, 4971, 7812, 11955, 17625, 24743,
    32768, 40793, 47911, 53581, 57724, 60565, 62428, 63615, 64357, 64816, 65097, 65269, 65374, 65438, 65476, 65500,
    65514, 65523, 65528, 65531, 65533, 65534, 65535, 65535, 65536,
)  # fmt: skip
"""65536 / (1 + exp(-x)), rounded, for the log odds x = -12, -11.5, ... 12."""

ODDS = 12 * 256 - 1
"""Largest log odds, in 256ths."""


def encode_states(states_yx: NDArray[np.uint8], base_yx: NDArray[np.uint8] | None = None) -> bytes:
    """Bytes of a grid of states, lossless.

    Parameters
    ----------
    states_yx : (height, width) uint8 states (FREE, OCCUPIED, UNKNOWN)
    base_yx : of the same shape, what the receiver has already, such as its vector map as it is drawn

    Raises
    ------
    ValueError : another shape, type or state, or more than 2^25 cells
    """
    from fleetmap.codecs.range_kernels import AT, WRITE, begin, finish_writing

    if any(array is not None and array.dtype != np.uint8 for array in (states_yx, base_yx)):
        raise ValueError("expected states as uint8")
    height, width = states_yx.shape
    if states_yx.size > MAX_CELLS:
        raise ValueError(f"expected at most {MAX_CELLS} cells")
    if states_yx.size and states_yx.max() > UNKNOWN:
        raise ValueError(f"expected states up to {UNKNOWN}")
    states = np.ascontiguousarray(states_yx, np.uint8).copy()
    data = np.empty(states.size + 64, np.uint8)
    coder = np.array([WRITE, 0, 0, 0, 0, 0, 0, 0])
    begin(coder, data)
    _code(coder, data, states, base_yx)
    finish_writing(coder, data)
    check(coder)
    return encode_leb128(np.array([height, width])) + data[: int(coder[AT])].tobytes()


def decode_states(data: bytes, base_yx: NDArray[np.uint8] | None = None, *, robot: str = "") -> NDArray[np.uint8]:
    """(height, width) states of ``encode_states``, against the same base.

    Raises
    ------
    WireError : the bytes are damaged, or are not these against this base; nothing else leaves
    """
    from fleetmap.codecs.range_kernels import READ, begin, finish_reading

    try:
        size, start = read_size(data), _start(data)
        if base_yx is not None and base_yx.shape != size:
            raise ValueError(f"the base has {base_yx.shape[0]} x {base_yx.shape[1]} cells, not {size[0]} x {size[1]}")
        states = np.zeros(size, np.uint8)
        rest = np.frombuffer(bytearray(data), np.uint8)[start:]
        coder = np.array([READ, 0, 0, 0, 0, 0, 0, 0])
        begin(coder, rest)
        check(coder)
        _code(coder, rest, states, base_yx)
        finish_reading(coder, rest)
        check(coder)
    except ValueError as error:
        raise WireError(robot=robot, size_bytes=len(data), reason=str(error)) from None
    return states


def split(shape: tuple[int, int]) -> list[tuple[slice, slice]]:
    """Windows (rows, columns) of a grid of any size, each of which ``encode_states`` takes: bands of whole rows."""
    height, width = shape
    columns = min(width, MAX_CELLS)
    rows = max(1, MAX_CELLS // max(1, columns))
    return [
        (slice(y, min(y + rows, height)), slice(x, min(x + columns, width)))
        for y in range(0, height, rows)
        for x in range(0, width, max(1, columns))
    ]


def read_size(data: bytes) -> tuple[int, int]:
    """Height and width in cells, which stand in front.

    Raises
    ------
    ValueError : they are cut off, or more than so many bytes may hold
    """
    height, width = decode_leb128(data[: _start(data)]).tolist()
    if height * width > min(MAX_CELLS, CELLS_PER_BYTE * len(data)):
        raise ValueError(f"{height} x {width} cells are more than {len(data)} B may hold")
    return height, width


def _start(data: bytes) -> int:
    """Where height and width end."""
    ends = [k for k, byte in enumerate(data[: 2 * MAX_BYTES]) if byte < 128][:2]
    if len(ends) < 2:
        raise ValueError("height and width are cut off")
    return ends[1] + 1


def _code(
    coder: NDArray[np.int64], data: NDArray[np.uint8], states: NDArray[np.uint8], base_yx: NDArray[np.uint8] | None
) -> None:
    from fleetmap.codecs.context_grid_kernels import code_states

    chances, odds = _tables()
    base = np.empty((0, 0), np.uint8) if base_yx is None else np.ascontiguousarray(base_yx, np.uint8)
    if base_yx is not None and base.shape != states.shape:
        raise ValueError(f"expected a base of {states.shape[0]} x {states.shape[1]} cells")
    if states.size:
        code_states(coder, data, states, base, chances, odds)


@cache
def _tables() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(2 ODDS + 1,) the chance out of 2^16 of log odds from -ODDS on, and (4096,) the log odds of 16 chances each."""
    place, rest = np.divmod(np.arange(-ODDS, ODDS + 1) + 12 * 256, 128)
    points = np.array([*CHANCES, 65536])
    chances = np.clip((points[place] * (128 - rest) + points[place + 1] * rest) // 128, 1, 65535)
    odds = np.searchsorted(chances, 16 * np.arange(4096) + 8) - ODDS
    return chances, np.minimum(odds, ODDS)
