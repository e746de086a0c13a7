"""The image of a map_server map: how bright each pixel is, read within bounds."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import MapFormatError
from fleetmap.model.grid import MAX_CELLS

if TYPE_CHECKING:
    from PIL.Image import Image

FORMATS = ("PPM", "PNG", "BMP")
"""What map_server itself writes (PGM is Pillow's PPM); each further parser would only be one more to attack."""

BYTES_AT_LEAST = {"PPM": 1 / 8, "PNG": 1 / 8300, "BMP": 1 / 8300}
"""Fewest bytes of file a pixel: 1 bit in a PBM; deflate packs at most 1032 : 1, and BMP has run lengths."""


@dataclass(frozen=True, eq=False)
class Brightness:
    """Pixels as integers, image row 0 (the top) first.

    Parameters
    ----------
    levels_yx : (height, width) integers 0 to ``full``; 0 is black
    full : the level of white, a multiple of 255
    opaque_yx : (height, width) bool, which pixels are fully opaque; None if the image has no transparency
    """

    levels_yx: NDArray[np.integer]
    full: int
    opaque_yx: NDArray[np.bool_] | None

    def has_grey(self, level: int) -> bool:
        """Whether any pixel is exactly this grey, of 255."""
        return bool((self.levels_yx == level * (self.full // 255)).any())


def read_brightness(path: Path, *, average_alpha: bool) -> Brightness:
    """Read a PGM (binary, ASCII, up to 16 bits), PNG (grey, palette, RGB, with or without alpha) or BMP.

    Parameters
    ----------
    path : the image
    average_alpha : count alpha as one more colour channel, as map_server does in its trinary mode

    Raises
    ------
    MapFormatError : missing, no such format, truncated, or larger than ``MAX_CELLS`` (or than Pillow's own
        limit, 179 M pixels); nothing is allocated before the size in the header has been found possible
    """
    from PIL import Image

    if not path.is_file():
        reason = "is a directory" if path.is_dir() else "no such file"
        raise MapFormatError(path=path, field="image", reason=f"{reason}; expected a PGM, PNG or BMP file")
    try:
        with warnings.catch_warnings():
            # Pillow warns from 89 M pixels on; our own bound is in `_check_size`.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path, formats=FORMATS) as image:
                _check_size(image, path)
                return _brightness(image, average_alpha)
    except MapFormatError:
        raise
    except Exception as error:  # Pillow lets through whatever its parsers meet in a broken file
        raise MapFormatError(path=path, field="image", reason=f"not readable as an image: {error}") from error


def _check_size(image: Image, path: Path) -> None:
    pixels, size_bytes = image.width * image.height, path.stat().st_size
    if pixels > MAX_CELLS:
        reason = f"the header claims {image.width} x {image.height} pixels; at most {MAX_CELLS} are read"
        raise MapFormatError(path=path, field="image size", reason=reason)
    # A grey map has a byte a pixel at least, binary or ASCII; only bitmaps pack eight into one.
    least = 1.0 if image.format == "PPM" and image.mode != "1" else BYTES_AT_LEAST[str(image.format)]
    if pixels * least > size_bytes:
        reason = f"the header claims {image.width} x {image.height} pixels, but the file has {size_bytes} bytes"
        raise MapFormatError(path=path, field="image size", reason=reason)


def _brightness(image: Image, average_alpha: bool) -> Brightness:
    if image.mode.startswith("I"):  # 16 bits: PGM comes scaled to 65535, whatever its maxval
        return Brightness(np.asarray(image).astype(np.int64), 65535, None)
    if image.mode in ("1", "L") and not image.has_transparency_data:
        return Brightness(np.asarray(image.convert("L")), 255, None)
    if not image.has_transparency_data:
        return Brightness(np.asarray(image.convert("RGB")).sum(axis=2, dtype=np.uint16), 3 * 255, None)
    rgba = np.asarray(image.convert("RGBA"))
    channels = 4 if average_alpha else 3
    return Brightness(rgba[..., :channels].sum(axis=2, dtype=np.uint16), channels * 255, rgba[..., 3] == 255)
