import os
import struct
import subprocess
import sys
import warnings
import zlib
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from fleetmap.model.errors import ConfigError, MapFormatError, MapWarning
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.map_server import load_map, save_map
from fleetmap.model.pose import Pose2

HEADER = {
    "image": "map.pgm",
    "resolution": "0.05",
    "origin": "[0.0, 0.0, 0.0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}
GREYS = np.array([[0, 254, 205, 255, 100]], np.uint8)
TRINARY = [[100, 0, -1, 0, -1]]


def write_yaml(folder: Path, **changes: str | None) -> Path:
    fields = {key: value for key, value in (HEADER | changes).items() if value is not None}
    path = folder / "map.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in fields.items()))
    return path


def write_map(folder: Path, image: Image.Image, *, name: str = "map.png", **changes: str | None) -> Path:
    image.save(folder / name)
    return write_yaml(folder, image=name, **changes)


def refusal(path: Path) -> MapFormatError:
    with pytest.raises(MapFormatError) as caught:
        load_map(path)
    return caught.value


def test_image_row_0_is_the_top_and_grid_row_0_the_lowest_y(tmp_path: Path) -> None:
    (tmp_path / "map.pgm").write_bytes(b"P5\n2 2\n255\n" + bytes([0, 254, 205, 205]))
    grid = load_map(write_yaml(tmp_path, origin="[-1.5, 2, 0.5]"))
    assert grid.cells_yx.tolist() == [[-1, -1], [100, 0]]
    assert grid.origin == Pose2(-1.5, 2.0, 0.5)
    assert grid.resolution_m == 0.05


@pytest.mark.parametrize("mode", ["L", "P", "RGB"])
def test_png_grey_palette_and_rgb_give_the_same_cells(tmp_path: Path, mode: str) -> None:
    assert load_map(write_map(tmp_path, Image.fromarray(GREYS).convert(mode))).cells_yx.tolist() == TRINARY


def test_bmp_is_read(tmp_path: Path) -> None:
    path = write_map(tmp_path, Image.fromarray(GREYS), name="map.bmp")
    assert load_map(path).cells_yx.tolist() == TRINARY


def test_ascii_pgm_with_comments_is_read(tmp_path: Path) -> None:
    (tmp_path / "map.pgm").write_text("P2\n# by hand\n5 1\n255\n0 254 205\n255 100\n")
    assert load_map(write_yaml(tmp_path)).cells_yx.tolist() == TRINARY


@pytest.mark.parametrize("maxval", [65535, 1020, 100])
def test_pgm_levels_are_relative_to_its_maxval(tmp_path: Path, maxval: int) -> None:
    levels = np.rint(GREYS / 255 * maxval).astype(">u2" if maxval > 255 else "u1")
    (tmp_path / "map.pgm").write_bytes(f"P5\n5 1\n{maxval}\n".encode() + levels.tobytes())
    # 205/255 lies right on the threshold, so that rounding to a coarser scale may move it
    assert load_map(write_yaml(tmp_path, free_thresh="0.19")).cells_yx.tolist() == TRINARY


def test_sixteen_bit_png_is_read(tmp_path: Path) -> None:
    image = Image.fromarray(GREYS.astype(np.uint16) * 257)
    assert load_map(write_map(tmp_path, image)).cells_yx.tolist() == TRINARY


@pytest.mark.parametrize("negate", ["1", "true"])
def test_negate_makes_white_occupied(tmp_path: Path, negate: str) -> None:
    path = write_map(tmp_path, Image.fromarray(255 - GREYS), negate=negate)
    assert load_map(path).cells_yx.tolist() == TRINARY


def test_mode_scale_spreads_the_middle_over_0_to_100(tmp_path: Path) -> None:
    image = Image.fromarray(np.array([[0, 255, 153, 102]], np.uint8))
    path = write_map(tmp_path, image, mode="scale", occupied_thresh="0.8", free_thresh="0.2")
    # p = 0.4 and 0.6: a third and two thirds of the way from 0.2 to 0.8
    assert load_map(path).cells_yx.tolist() == [[100, 0, 33, 67]]


def test_mode_scale_makes_transparent_pixels_unknown(tmp_path: Path) -> None:
    pixels = np.array([[[0, 0, 0, 255], [0, 0, 0, 254], [255, 255, 255, 255]]], np.uint8)
    assert load_map(write_map(tmp_path, Image.fromarray(pixels), mode="scale")).cells_yx.tolist() == [[100, -1, 0]]


def test_mode_trinary_averages_alpha_with_the_colours(tmp_path: Path) -> None:
    pixels = np.array([[[0, 0, 0, 255], [255, 255, 255, 255], [255, 255, 255, 0]]], np.uint8)
    # brightness 1/4, 1 and 3/4, as in map_server
    with pytest.warns(MapWarning, match="1 of 3 cells"):
        assert load_map(write_map(tmp_path, Image.fromarray(pixels))).cells_yx.tolist() == [[100, 0, -1]]


def with_alpha(kind: str) -> Image.Image:
    """``GREYS`` with an opaque alpha channel of some kind."""
    image = Image.fromarray(GREYS)
    if kind == "tRNS":
        image.info["transparency"] = 7  # a grey that no pixel has
        return image
    return image.convert("RGBA").convert(kind)


@pytest.mark.parametrize("kind", ["LA", "RGBA", "P", "tRNS"])
def test_an_opaque_alpha_channel_is_followed_by_the_letter_and_warned_of(tmp_path: Path, kind: str) -> None:
    # Grey 205 is (3 * 205 + 255) / 1020 = 0.853 bright to map_server (measured with GraphicsMagick): free.
    path = write_map(tmp_path, with_alpha(kind))
    with pytest.warns(MapWarning, match=r"alpha of map\.png .* 1 of 5 cells are not what their colours say"):
        assert load_map(path).cells_yx.tolist() == [[100, 0, 0, 0, -1]]


@pytest.mark.parametrize("kind", ["LA", "RGBA", "P", "tRNS"])
@pytest.mark.parametrize(("occupied", "free"), [("0.65", "0.1"), ("0.7", "0.05")])
def test_alpha_that_changes_no_cell_is_not_warned_of(tmp_path: Path, kind: str, occupied: str, free: str) -> None:
    path = write_map(tmp_path, with_alpha(kind), occupied_thresh=occupied, free_thresh=free)
    assert load_map(path).cells_yx.tolist() == TRINARY


@given(
    grey=st.integers(0, 255), alpha=st.integers(0, 255), free=st.integers(0, 99), occupied=st.integers(1, 100),
    negate=st.booleans(),
)  # fmt: skip
def test_alpha_is_warned_of_if_and_only_if_it_changes_a_cell(
    grey: int, alpha: int, free: int, occupied: int, negate: bool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    free, occupied = min(free, occupied - 1), max(free + 1, occupied)
    folder = tmp_path_factory.mktemp("map")
    changes = {"free_thresh": str(free / 100), "occupied_thresh": str(occupied / 100), "negate": str(int(negate))}
    found = []
    for name, pixel in (("alpha.png", [[[grey, grey, grey, alpha]]]), ("plain.png", [[grey]])):
        path = write_map(folder, Image.fromarray(np.array(pixel, np.uint8)), name=name, **changes)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            cell = int(load_map(path).cells_yx[0, 0])
        found.append((cell, any("alpha of" in str(warning.message) for warning in caught)))
    assert found[0][1] == (found[0][0] != found[1][0])
    assert not found[1][1]
    shade = (3 * grey + alpha) / 1020
    occupancy = shade if negate else 1 - shade
    assert found[0][0] == (100 if occupancy > occupied / 100 else 0 if occupancy < free / 100 else -1)


def test_grey_205_that_free_thresh_frees_is_warned_of_with_alpha_too(tmp_path: Path) -> None:
    path = write_map(tmp_path, with_alpha("LA"), free_thresh="0.25")
    with pytest.warns(MapWarning, match=r"free_thresh 0\.25 makes grey 205"):
        assert load_map(path).cells_yx.tolist() == [[100, 0, 0, 0, -1]]


def bmp_of_32_bits(greys: list[int], fourth: list[int]) -> bytes:
    data = b"".join(bytes([grey, grey, grey, byte]) for grey, byte in zip(greys, fourth, strict=True))
    head = struct.pack("<IiiHHIIiiII", 40, len(greys), 1, 1, 32, 0, len(data), 2835, 2835, 0, 0)
    return b"BM" + struct.pack("<IHHI", 54 + len(data), 0, 0, 54) + head + data


def test_the_fourth_byte_of_a_bmp_is_alpha_as_in_map_server(tmp_path: Path) -> None:
    (tmp_path / "map.bmp").write_bytes(bmp_of_32_bits([0, 254, 205, 255, 100], [255, 0, 255, 0, 100]))
    # 0.25, 0.747, 0.853, 0.75, 0.392 bright
    with pytest.warns(MapWarning, match="3 of 5 cells"):
        assert load_map(write_yaml(tmp_path, image="map.bmp")).cells_yx.tolist() == [[100, -1, 0, -1, -1]]


def test_a_sixteen_bit_png_with_a_transparent_grey_has_alpha(tmp_path: Path) -> None:
    chunks = png(2, 1, zlib.compress(struct.pack(">BHH", 0, 205 * 257, 254 * 257)), depth=16, transparent=b"\0\7")
    (tmp_path / "map.png").write_bytes(chunks)
    with pytest.warns(MapWarning, match="1 of 2 cells"):
        assert load_map(write_yaml(tmp_path, image="map.png")).cells_yx.tolist() == [[0, 0]]


def test_mode_raw_takes_the_levels_themselves(tmp_path: Path) -> None:
    image = Image.fromarray(np.array([[0, 37, 100, 101, 255]], np.uint8))
    assert load_map(write_map(tmp_path, image, mode="raw")).cells_yx.tolist() == [[0, 37, 100, -1, -1]]


def test_grey_205_with_free_thresh_0_25_is_free_and_warned_of(tmp_path: Path) -> None:
    path = write_map(tmp_path, Image.fromarray(GREYS), free_thresh="0.25")
    with pytest.warns(MapWarning, match=r"free_thresh 0\.25 makes grey 205"):
        assert load_map(path).cells_yx.tolist() == [[100, 0, 0, 0, -1]]


def test_free_thresh_0_25_without_grey_205_is_not_warned_of(tmp_path: Path) -> None:
    image = Image.fromarray(np.array([[0, 254]], np.uint8))
    assert load_map(write_map(tmp_path, image, free_thresh="0.25")).cells_yx.tolist() == [[100, 0]]


def test_exponents_without_a_dot_are_numbers(tmp_path: Path) -> None:
    path = write_map(tmp_path, Image.fromarray(GREYS), resolution="5e-2")
    assert load_map(path).resolution_m == 0.05


NUMBERS = {
    "010": 10, "010.5": 10.5, "+1": 1, "1.": 1, ".5": 0.5, "+.5": 0.5, "5e-2": 0.05, "5.e-2": 0.05, "1E-2": 0.01,
    "'0.05'": 0.05, '"0.05"': 0.05, "!!str 0.05": 0.05, "&a 0.05": 0.05, "0.05 # m": 0.05, "'0.05 '": 0.05,
    "|\n  0.05": 0.05, "12345678901234567890123": 12345678901234567890123.0,
}  # fmt: skip
"""What yaml-cpp 0.7 reads as a double."""

NO_NUMBERS = [
    "1:30", "1_000", "0b1", "0x10", "0o10", "0x1p-2", "nan", "inf", "infinity", ".inf", ".nan", "1e400", "1.0f", "1,5",
    "0.05 m", "1e", "1e+", "--1", "+-1", "1d2", "' 0.05'", "0.05#m", "٣", ".", "e5", "5e 2", "1.5.2", "true", "~", "''",
]  # fmt: skip
"""What yaml-cpp 0.7 refuses as a double, or reads as one that is not finite."""


@pytest.mark.parametrize("text", NUMBERS)
def test_numbers_are_read_as_yaml_cpp_reads_them(tmp_path: Path, text: str) -> None:
    path = write_map(tmp_path, Image.fromarray(GREYS), resolution=text)
    assert load_map(path).resolution_m == NUMBERS[text]


@pytest.mark.parametrize("text", NO_NUMBERS)
def test_what_yaml_cpp_does_not_read_as_a_number_is_refused(tmp_path: Path, text: str) -> None:
    Image.fromarray(GREYS).save(tmp_path / "map.pgm")
    assert refusal(write_yaml(tmp_path, resolution=text)).field == "resolution"
    if "," not in text:
        assert refusal(write_yaml(tmp_path, origin=f"[{text}, 0, 0]")).field == "origin"


def test_an_origin_with_leading_zeros_is_decimal(tmp_path: Path) -> None:
    path = write_map(tmp_path, Image.fromarray(GREYS), origin="[010, -007.50, 0]")
    assert load_map(path).origin == Pose2(10.0, -7.5, 0.0)


TRUTHS = {
    **dict.fromkeys(["1", "01", "+1", "0x1", "y", "Y", "yes", "Yes", "YES", "true", "on", "'1'", "'true'"], True),
    **dict.fromkeys(["0", "+0", "0x0", "n", "no", "false", "False", "off", "OFF", "'0'"], False),
}  # fmt: skip
NO_TRUTHS = ["0.0", "1.0", "1e0", "yEs", "10000000000", "0b1", "1:0", "~", "", "null", "[0]", "' 1'"]


@pytest.mark.parametrize("text", TRUTHS)
def test_negate_is_read_as_yaml_cpp_reads_it(tmp_path: Path, text: str) -> None:
    pixels = 255 - GREYS if TRUTHS[text] else GREYS
    assert load_map(write_map(tmp_path, Image.fromarray(pixels), negate=text)).cells_yx.tolist() == TRINARY


@pytest.mark.parametrize("text", NO_TRUTHS)
def test_a_negate_that_yaml_cpp_refuses_is_refused(tmp_path: Path, text: str) -> None:
    Image.fromarray(GREYS).save(tmp_path / "map.pgm")
    assert refusal(write_yaml(tmp_path, negate=text)).field == "negate"


def test_a_name_that_looks_like_a_number_or_a_date_is_a_name(tmp_path: Path) -> None:
    for name in ("010", "true", "2001-99-99", "1_0"):
        Image.fromarray(GREYS).save(tmp_path / name, format="PNG")
        assert load_map(write_yaml(tmp_path, image=name)).cells_yx.tolist() == TRINARY


def test_the_mode_may_have_capitals_as_in_map_server(tmp_path: Path) -> None:
    assert load_map(write_map(tmp_path, Image.fromarray(GREYS), mode="Trinary")).cells_yx.tolist() == TRINARY


@pytest.mark.parametrize(
    "text",
    [
        "image:\tmap.pgm\nresolution:\t0.05\norigin:\t[1, 2, 0]\nnegate:\t0\n",
        "image: map.pgm\t\nresolution: \t 0.05\t \norigin: [1,\t2,\t0]\t\nnegate: 0\t# no\n",
        "image\t: map.pgm\nresolution : 0.05\norigin: [\t1, 2, 0\t]\nnegate: 0\n",
        "image: 'map.pgm'\t#\nresolution:\t'0.05'\norigin:\n-\t1\n-\t2\n- 0\nnegate: 0\n",
        "image: map.pgm\nresolution:\n\t0.05\norigin: [1,\n\t2,\n\t0]\nnegate: 0\n",
    ],
)
def test_a_tab_between_tokens_is_a_blank(tmp_path: Path, text: str) -> None:
    (tmp_path / "map.pgm").write_bytes(b"P5\n5 1\n255\n" + GREYS.tobytes())
    (tmp_path / "map.yaml").write_text(text + "occupied_thresh:\t0.65\nfree_thresh:\t0.196")
    grid = load_map(tmp_path / "map.yaml")
    assert (grid.cells_yx.tolist(), grid.resolution_m, grid.origin) == (TRINARY, 0.05, Pose2(1.0, 2.0, 0.0))


@pytest.mark.parametrize("image", ["'a\tb.png'", "a\tb.png", "a\tb.png\t# c"])
def test_a_tab_within_a_name_stays(tmp_path: Path, image: str) -> None:
    Image.fromarray(GREYS).save(tmp_path / "a\tb.png")
    assert load_map(write_yaml(tmp_path, image=image)).cells_yx.tolist() == TRINARY


@pytest.mark.parametrize("key", HEADER)
def test_a_doubled_key_is_refused(tmp_path: Path, key: str) -> None:
    Image.fromarray(GREYS).save(tmp_path / "map.pgm")
    path = write_yaml(tmp_path)
    for again in (key, f"'{key}'"):
        path.write_text("".join(f"{k}: {v}\n" for k, v in HEADER.items()) + f"{again}: {HEADER[key]}\n")
        error = refusal(path)
        assert error.field == key
        assert "twice, the second time in line 7" in error.reason


BAD_FIELDS = [
    ("image", None),
    ("image", "[1]"),
    ("image", "absent.pgm"),
    ("image", "."),
    ("image", '"nul\\0.pgm"'),
    ("image", '"half a pair \\ud800.pgm"'),
    ("image", "~"),
    ("image", "a" * 5_000),
    ("resolution", None),
    ("resolution", "0"),
    ("resolution", "-0.05"),
    ("resolution", ".nan"),
    ("resolution", ".inf"),
    ("resolution", "fine"),
    ("resolution", "true"),
    ("resolution", "1" + "0" * 400),
    ("origin", None),
    ("origin", "[0, 0]"),
    ("origin", "[0, 0, 0, 0]"),
    ("origin", "[0, .nan, 0]"),
    ("origin", "[0, [], 0]"),
    ("origin", "12"),
    ("occupied_thresh", None),
    ("occupied_thresh", "high"),
    ("free_thresh", "0.65"),
    ("free_thresh", "0.7"),
    ("free_thresh", "-0.1"),
    ("mode", "quaternary"),
    ("mode", "[]"),
    ("negate", None),
    ("negate", "maybe"),
]


@pytest.mark.parametrize(("field", "value"), BAD_FIELDS)
def test_a_bad_field_is_named(tmp_path: Path, field: str, value: str | None) -> None:
    Image.fromarray(GREYS).save(tmp_path / "map.pgm")
    error = refusal(write_yaml(tmp_path, **{field: value}))
    assert error.field == field
    assert str(tmp_path) in str(error)


BAD_YAML = {
    "no mapping": b"- image\n- resolution\n",
    "empty": b"",
    "broken": b"image: [map.pgm\n",
    "not utf-8": b"image: \xff\xfe\n",
    "too large": b"# filler\n" * 10_000,
    "aliases": b"a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n",
    "deep": b"[" * 60_000,
    "two documents": b"image: map.pgm\n---\nimage: map.pgm\n",
    "a list for a key": b"[image, map.pgm]: 1\n",
    "no such character": b'image: "\\UFFFFFFFF"\n',
    "tab for indentation": b"\timage: map.pgm\nresolution: 0.05\n",
}


@pytest.mark.parametrize("kind", BAD_YAML)
def test_bad_yaml_is_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "map.yaml"
    path.write_bytes(BAD_YAML[kind])
    assert refusal(path).field == "yaml"


def test_a_missing_yaml_file_or_a_folder_is_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path / "absent.yaml").field == "yaml"
    assert refusal(tmp_path).field == "yaml"


BAD_PGM = {
    "truncated": b"P5\n4 4\n255\n" + bytes(15),
    "truncated, 16 bit": b"P5\n4 4\n65535\n" + bytes(31),
    "truncated, odd maxval": b"P5\n4 4\n100\n" + bytes(15),
    "truncated, ascii": b"P2\n4 4\n255\n" + b"205 " * 15,
    "ascii above maxval": b"P2\n2 1\n255\n0 256\n",
    "no header": b"P5\n",
    "empty": b"",
    "text": b"this is no image",
    "20 GB": b"P5\n141421 141421\n255\n" + bytes(100),
    "200 MB in 100 bytes": b"P5\n10000 10000\n255\n" + bytes(100),
    "ascii 200 MB": b"P2\n10000 10000\n255\n0 0 0\n",
    "negative": b"P5\n-4 -4\n255\n" + bytes(16),
    "zero": b"P5\n0 0\n255\n",
    "maxval 0": b"P5\n2 2\n0\n" + bytes(4),
    "maxval 70000": b"P5\n2 2\n70000\n" + bytes(8),
}


@pytest.mark.parametrize("kind", BAD_PGM)
def test_a_bad_pgm_is_refused(tmp_path: Path, kind: str) -> None:
    (tmp_path / "map.pgm").write_bytes(BAD_PGM[kind])
    assert refusal(write_yaml(tmp_path)).field in ("image", "image size")


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"P5\n5 1\n255\n" + GREYS.tobytes() + b"\n", "1 bytes"),
        (b"P5\n5 1\n255\n" + GREYS.tobytes() * 3, "10 bytes"),
        (b"P5 5 1 65535\n" + GREYS.astype(">u2").tobytes() * 2, "10 bytes"),
        (b"P5 5 1 100\n" + bytes(5 + 7), "7 bytes"),
        (b"P6 5 1 255\n" + GREYS.tobytes() * 4, "5 bytes"),
        (b"P4 9 2\n" + bytes(4 + 2), "2 bytes"),
        (b"P2\n5 1\n255\n0 254 # 7 7\n205\n255 100 3 # 1\n 4", "2 numbers"),
    ],
)
def test_a_pgm_longer_than_its_header_says_is_warned_of(tmp_path: Path, data: bytes, says: str) -> None:
    (tmp_path / "map.pgm").write_bytes(data)
    with pytest.warns(MapWarning, match=rf"map\.pgm goes on behind its last pixel, by {says}:"):
        assert load_map(write_yaml(tmp_path)).cells_yx.size in (5, 18)


@pytest.mark.parametrize("image", ["pgm", "png"])
def test_a_map_beyond_179_million_pixels_is_saved_and_read(tmp_path: Path, image: Literal["pgm", "png"]) -> None:
    cells = np.full((13_500, 13_500), -1, np.int8)
    cells[7000:7002, 5:13_000] = [[0], [100]]
    save_map(OccupancyGrid(cells, 0.05), tmp_path / "map.yaml", image=image)
    assert np.array_equal(load_map(tmp_path / "map.yaml").cells_yx, cells)


def png(width: int, height: int, data: bytes, *, depth: int = 8, transparent: bytes = b"") -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0))
    if transparent:
        head += chunk(b"tRNS", transparent)
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", data) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("width", "height", "data"),
    [(1 << 30, 1 << 30, b""), (16_000, 16_000, b""), (9_500, 9_500, zlib.compress(bytes(100))), (4, 4, b"junk")],
)
def test_a_png_whose_header_lies_is_refused(tmp_path: Path, width: int, height: int, data: bytes) -> None:
    (tmp_path / "map.png").write_bytes(png(width, height, data))
    assert refusal(write_yaml(tmp_path, image="map.png")).field in ("image", "image size")


def test_other_image_formats_are_refused(tmp_path: Path) -> None:
    assert refusal(write_map(tmp_path, Image.fromarray(GREYS), name="map.gif")).field == "image"


@pytest.mark.parametrize("image", ["pgm", "png"])
@given(
    rows=st.lists(st.lists(st.integers(-1, 100), min_size=3, max_size=3), min_size=1, max_size=4),
    resolution_m=st.floats(1e-6, 1e3),
    origin=st.tuples(*[st.floats(-1e6, 1e6)] * 2, st.floats(-3.1, 3.1)),
    trinary=st.booleans(),
)
def test_a_saved_map_reads_back_the_same(
    image: str, rows: list[list[int]], resolution_m: float, origin: tuple[float, float, float], trinary: bool,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:  # fmt: skip
    cells = np.array(rows, np.int8)
    if trinary:
        cells = np.array([-1, 0, 100], np.int8)[cells % 3]
    grid = OccupancyGrid(cells, resolution_m, Pose2(*origin))
    path = tmp_path_factory.mktemp("map") / "map.yaml"
    save_map(grid, path, image=image)  # type: ignore[arg-type]
    again = load_map(path)
    assert again.cells_yx.tolist() == cells.tolist()
    assert (again.resolution_m, again.origin) == (resolution_m, grid.origin)


def test_a_saved_trinary_map_has_the_greys_of_map_saver(tmp_path: Path) -> None:
    save_map(OccupancyGrid(np.array([[100, 0, -1]], np.int8), 0.05), tmp_path / "map.yaml")
    assert (tmp_path / "map.pgm").read_bytes() == b"P5\n3 1\n255\n" + bytes([0, 254, 205])
    assert "free_thresh: 0.196\n" in (tmp_path / "map.yaml").read_text()


def test_a_failed_save_leaves_the_old_map_and_no_other_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    grid = OccupancyGrid(np.array([[100, 0]], np.int8), 0.05)
    save_map(grid, tmp_path / "map.yaml")

    def fail(*args: object, **kwargs: object) -> None:
        raise OSError("disk full")

    for writer in ((Image.Image, "save"), (yaml, "safe_dump")):
        with monkeypatch.context() as patched:
            patched.setattr(*writer, fail)
            with pytest.raises(OSError, match="disk full"):
                save_map(OccupancyGrid(np.array([[-1, 37]], np.int8), 0.05), tmp_path / "map.yaml")
        assert sorted(os.listdir(tmp_path)) == ["map.pgm", "map.yaml"]
        assert load_map(tmp_path / "map.yaml").cells_yx.tolist() == [[100, 0]]


def test_a_disk_that_fills_up_behind_the_image_leaves_the_old_map(tmp_path: Path) -> None:
    """The new image beside the old YAML, of another mode, would be another map."""
    save_map(OccupancyGrid(np.array([[100, 0]], np.int8), 0.05), tmp_path / "map.yaml")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    code = """if True:
        import resource, numpy as np, PIL.PngImagePlugin, yaml
        from fleetmap.model.grid import OccupancyGrid
        from fleetmap.model.map_server import save_map
        grid = OccupancyGrid(np.array([[-1, 37]], np.int8), 0.05)
        save_map(grid, "warm.yaml")  # all is imported now
        # Room for the image, 13 bytes, and not for the YAML.
        resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))
        try:
            save_map(grid, "map.yaml")
        except OSError as error:
            print(type(error).__name__)
    """
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout) == (0, "OSError\n"), run.stderr
    assert {path.name: path.read_bytes() for path in tmp_path.glob("map.*")} == before
    assert not list(tmp_path.glob(".*"))


def test_save_refuses_an_unknown_image_kind_and_the_image_as_yaml(tmp_path: Path) -> None:
    grid = OccupancyGrid(np.array([[0]], np.int8), 0.05)
    with pytest.raises(ConfigError, match="image="):
        save_map(grid, tmp_path / "map.yaml", image="gif")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="yaml_path="):
        save_map(grid, tmp_path / "map.pgm")


REAL = Path(os.environ["FLEETMAP_DATA"]) / "maps" if "FLEETMAP_DATA" in os.environ else None


@pytest.mark.data
@pytest.mark.skipif(REAL is None, reason="FLEETMAP_DATA is unset")
def test_every_real_map_loads_and_only_the_depot_is_warned_of() -> None:
    assert REAL is not None
    warned, without_unknown = [], []
    paths = sorted(REAL.glob("*/map.yaml"))
    assert len(paths) >= 21
    for path in paths:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            grid = load_map(path)
        warned += [path.parent.name for _ in caught]
        assert (grid.cells_yx == 0).any(), path
        assert (grid.cells_yx == 100).any(), path
        if not (grid.cells_yx == -1).any():
            without_unknown.append(path.parent.name)
    assert warned == ["nav2_depot"]
    assert without_unknown == ["nav2_depot"]


def test_thresholds_that_no_file_can_hold_are_told(tmp_path):
    cells = np.array([[-1, 0, 30, 50, 60, 100]], np.int8)
    grid = OccupancyGrid(cells, 0.05, free_below=40, occupied_above=55)
    with pytest.warns(MapWarning, match=r"free_below=40 and occupied_above=55: 2 cells"):
        save_map(grid, tmp_path / "map.yaml")
    assert np.array_equal(load_map(tmp_path / "map.yaml").cells_yx, cells)
    with pytest.raises(ConfigError, match="yaml_path"):
        load_map(None)
