"""A sparse matrix of the cells that are not free, as scipy saves it."""

from __future__ import annotations

import io

import numpy as np

from fleetmap.codecs.baselines.protocol import Cells


def pack(states_yx: Cells) -> bytes:
    """(height, width) states -> compressed sparse rows in a deflated .npz; FREE is 0 and takes nothing."""
    from scipy.sparse import csr_array, save_npz

    file = io.BytesIO()
    save_npz(file, csr_array(states_yx), compressed=True)
    return file.getvalue()


def unpack(data: bytes, shape: tuple[int, int]) -> Cells:
    """(height, width) uint8 states."""
    from scipy.sparse import load_npz

    return np.asarray(load_npz(io.BytesIO(data)).toarray(), np.uint8).reshape(shape)
