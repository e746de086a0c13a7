"""The image of a map_server map: how bright each pixel is, read within bounds."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.errors import MapFormatError
from fleetmap.model.grid import MAX_CELLS

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageFile import ImageFile

DEFLATE_MOST = 1032
"""Deflate packs at most so many bytes into one."""

PIXEL_BITS = {"1": 1, "L": 1, "P": 1, "LA": 16, "I;16": 16, "RGB": 24, "RGBA": 32}
"""Fewest bits a pixel of a PNG takes before deflate, by Pillow's mode; L and P hold 1, 2, 4 and 8 bits alike."""

BMP_BYTES = 1 / 8300
"""Fewest bytes a pixel in a BMP, which may have run lengths."""


@dataclass(frozen=True, eq=False)
class Brightness:
    """Pixels as integers, image row 0 (the top) first.

    Parameters
    ----------
    levels_yx : (height, width) integers 0 to ``full``, the sum of the colours; 0 is black
    full : the level of white, a multiple of 255
    alpha_yx : (height, width) uint8, 255 is opaque; None if the image has no alpha channel
    surplus : what stands in the file behind the last pixel, as ``7 bytes``; empty if nothing does, or may do
    """

    levels_yx: NDArray[np.integer]
    full: int
    alpha_yx: NDArray[np.uint8] | None = None
    surplus: str = ""

    def is_grey(self, level: int) -> NDArray[np.bool_]:
        """(height, width) bool, which pixels are exactly this grey, of 255."""
        grey: NDArray[np.bool_] = self.levels_yx == level * (self.full // 255)
        return grey

    def with_alpha(self) -> Brightness:
        """Alpha counted as one more of three colours, opaque as white: map_server's rule in its trinary mode."""
        if self.alpha_yx is None:
            return self
        unit = self.full // (3 * 255)
        alpha = self.alpha_yx.astype(self.levels_yx.dtype) * unit
        return Brightness(self.levels_yx + alpha, self.full + 255 * unit, self.alpha_yx)


def read_brightness(path: Path) -> Brightness:
    """Read a PGM (binary, ASCII, up to 16 bits), PNG (grey, palette, RGB, with or without alpha) or BMP.

    Raises
    ------
    MapFormatError : missing, no such format, truncated, or larger than ``MAX_CELLS``; nothing is allocated before
        the size in the header has been found possible
    """
    try:
        if not path.is_file():
            found = "is a directory" if path.is_dir() else "is no file" if path.exists() else "no such file"
            raise MapFormatError(path=path, field="image", reason=f"{found}; expected a PGM, PNG or BMP file")
        with path.open("rb") as file:
            image = _open(file)
            _check_size(image, path)
            surplus = _find_surplus(image, file, path)
            return _brightness(image, file, surplus)
    except MapFormatError:
        raise
    except Exception as error:  # Pillow lets through whatever its parsers meet in a broken file
        raise MapFormatError(path=path, field="image", reason=f"not readable as an image: {error}") from error


def _open(file: IO[bytes]) -> ImageFile:
    """The header of an image in one of the formats that map_server itself writes.

    By their classes, and not by ``Image.open``: each further parser would only be one more to attack, and
    ``Image.open`` refuses more than 179 M pixels, unless told otherwise for the whole process.
    """
    from PIL.BmpImagePlugin import BmpImageFile
    from PIL.PngImagePlugin import PngImageFile
    from PIL.PpmImagePlugin import PpmImageFile

    head = file.read(8)
    file.seek(0)
    if head == b"\x89PNG\r\n\x1a\n":
        return PngImageFile(file)
    if head.startswith(b"BM"):
        return BmpImageFile(file)
    if head[:2] not in (b"P1", b"P2", b"P3", b"P4", b"P5", b"P6"):
        raise ValueError(f"expected a PGM, PNG or BMP file; it begins with {head!r}")
    return PpmImageFile(file)


def _check_size(image: ImageFile, path: Path) -> None:
    pixels, size_bytes = image.width * image.height, path.stat().st_size
    if pixels > MAX_CELLS:
        reason = f"the header claims {image.width} x {image.height} pixels; at most {MAX_CELLS} are read"
        raise MapFormatError(path=path, field="image size", reason=reason)
    # A grey map has a byte a pixel at least, binary or ASCII; only bitmaps pack eight into one.
    if image.format == "PPM":
        least = 1 / 8 if image.mode == "1" else 1.0
    else:
        least = PIXEL_BITS.get(image.mode, 1) / 8 / DEFLATE_MOST if image.format == "PNG" else BMP_BYTES
    if pixels * least > size_bytes:
        reason = f"the header claims {image.width} x {image.height} pixels, but the file has {size_bytes} bytes"
        raise MapFormatError(path=path, field="image size", reason=reason)


def _find_surplus(image: ImageFile, file: IO[bytes], path: Path) -> str:
    """What stands behind the last pixel of a PGM; other formats say where they end, and may go on."""
    if image.format != "PPM" or not image.tile:
        return ""
    decoder, _, offset, args = image.tile[0]
    values = image.width * image.height * len(image.getbands())
    if decoder == "ppm_plain":
        if image.mode == "1":  # its digits need no blanks between them
            return ""
        file.seek(offset)
        found = len(re.findall(rb"(?:^|\s)(?=\S)", re.sub(rb"#[^\r\n]*", b"", file.read())))
        return f"{found - values} numbers" if found > values else ""
    if image.mode == "1":
        size_bytes = (image.width + 7) // 8 * image.height
    else:
        two = args == "I;16B" or (isinstance(args, tuple) and isinstance(args[1], int) and args[1] > 255)
        size_bytes = 2 * values if two else values
    rest = path.stat().st_size - offset - size_bytes
    return f"{rest} bytes" if rest > 0 else ""


def _brightness(image: ImageFile, file: IO[bytes], surplus: str) -> Brightness:
    transparent = image.info.get("transparency")
    if image.mode.startswith("I"):  # 16 bits: PGM comes scaled to 65535, whatever its maxval
        levels = np.asarray(image)
        if transparent is None:
            return Brightness(levels, 65535, surplus=surplus)
        alpha = np.where(levels == transparent, 0, 255).astype(np.uint8)
        return Brightness(levels.astype(np.int32) * 3, 3 * 65535, alpha)
    if image.mode in ("1", "L") and transparent is None:
        return Brightness(np.asarray(image.convert("L")), 255, surplus=surplus)
    if image.format == "BMP" and image.tile and "BGRX" in str(image.tile[0].args):
        return _with_alpha_channel(_with_fourth_byte(image, file))
    if image.has_transparency_data:
        return _with_alpha_channel(image.convert("RGBA"))
    return Brightness(np.asarray(image.convert("RGB")).sum(axis=2, dtype=np.uint16), 3 * 255, surplus=surplus)


def _with_alpha_channel(image: Image) -> Brightness:
    rgba = np.asarray(image)
    return Brightness(rgba[..., :3].sum(axis=2, dtype=np.uint16), 3 * 255, rgba[..., 3].copy())


def _with_fourth_byte(image: ImageFile, file: IO[bytes]) -> Image:
    """A BMP of 32 bits a pixel: map_server takes the fourth byte for alpha in any case, Pillow skips it."""
    from PIL import Image

    _, _, offset, args = image.tile[0]
    assert isinstance(args, tuple)
    stride, direction = args[-2:]
    file.seek(offset)
    return Image.frombytes("RGBA", image.size, file.read(stride * image.height), "raw", "BGRA", stride, direction)
