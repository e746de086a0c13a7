"""Types of the arrays that kernels take: for type checkers what numpy calls them, for numba how they lie in memory."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray

Bytes: TypeAlias = Annotated[NDArray[np.uint8], "u1[::1]"]
Image: TypeAlias = Annotated[NDArray[np.uint8], "u1[:,::1]"]
Images: TypeAlias = Annotated[NDArray[np.uint8], "u1[:,:,::1]"]
Cells: TypeAlias = Annotated[NDArray[np.int8], "Array(i1, 2, 'C', readonly=True)"]
"""Those of a grid can't be written."""
Ints: TypeAlias = Annotated[NDArray[np.int64], "i8[::1]"]
Rows: TypeAlias = Annotated[NDArray[np.int64], "i8[:,::1]"]
Floats: TypeAlias = Annotated[NDArray[np.float64], "f8[::1]"]
FloatRows: TypeAlias = Annotated[NDArray[np.float64], "f8[:,::1]"]
Points: TypeAlias = Annotated[NDArray[np.int32], "i4[:,::1]"]
Shorts: TypeAlias = Annotated[NDArray[np.int32], "i4[::1]"]
