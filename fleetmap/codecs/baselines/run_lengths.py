"""Run lengths along the rows as variable-length numbers, then deflate."""

from __future__ import annotations

import numpy as np

from fleetmap.codecs.baselines.protocol import Cells
from fleetmap.codecs.deflate import deflate, inflate
from fleetmap.codecs.leb128 import MAX_BYTES, decode_leb128, encode_leb128

STATES = 3


def pack(states_yx: Cells) -> bytes:
    """(height, width) states -> 3 * length + state of each run, seven bits a byte; a run may go over a row's end."""
    states = states_yx.ravel()
    starts = np.flatnonzero(np.diff(states, prepend=STATES))
    lengths = np.diff(starts, append=states.size)
    return deflate(encode_leb128(STATES * lengths + states[starts]))


def unpack(data: bytes, shape: tuple[int, int]) -> Cells:
    """(height, width) uint8 states."""
    height, width = shape
    lengths, states = np.divmod(decode_leb128(inflate(data, max_bytes=MAX_BYTES * height * width)), STATES)
    return np.repeat(states.astype(np.uint8), lengths).reshape(shape)
