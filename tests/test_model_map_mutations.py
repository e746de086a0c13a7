"""Spoilt map files: whatever stands in them, a map comes out or a refusal that names the file and the field."""

import io
import resource
import struct
import warnings
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fleetmap.model.errors import MapFormatError, MapWarning
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.map_server import load_map

CASES = 2000
"""Files a run; benchmarks and hunts may set more."""

MOST_MB = 600
"""A PNG of some hundred bytes may claim 8000 pixels a byte and keep its word; nothing here may claim much more."""

HEADER = b"""image: map.img
resolution: 0.05
origin: [-1.5, 010, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
GREYS = np.random.default_rng(8).choice(np.array([0, 205, 254, 100], np.uint8), (9, 13))

VALUES = [
    b"", b"~", b"0", b"-1", b"1e308", b"1e-320", b"1e999", b".nan", b".inf", b"1:30", b"010", b"1_0", b"true", b"yes",
    b"[", b"]", b"{", b"}", b"[0, 0, 0]", b"[[0], 0, 0]", b"{a: 1}", b"&a x", b"*a", b"!!python/object:os.system x",
    b"!!binary x", b"!!timestamp 2001-99-99", b"2001-99-99", b'"\\ud800"', b'"\\UFFFFFFFF"', b'"\\x00"', b"'", b'"',
    b"|", b">", b"#", b"\t", b"\t- 1", b"<<: {a: 1}", b"? a", b": b", b"- c", b"---", b"...", b"%YAML 1.1",
    b"%TAG ! !", b"@x", b"`x", b"\xff\xfe", b"\xef\xbb\xbf", b"\xc2\x85", b"\xe2\x80\xa8", b"\x00", b"\x1b[2J",
    b"a" * 300, b"1" * 5000, b"map.img", b"/dev/null", b"..", b".", b"map.yaml", b"absent", b"trinary", b"scale",
    b"raw", b"0x1p3", b"\xf0\x9f\x97\xba", b"0.1", b"0.5 # c", b"1", b"[1, 2, 3.]", b"0.9", b"Raw",
]  # fmt: skip
"""What stands in the place of values, and elsewhere."""


def save(image: Image.Image, kind: str, **options: object) -> bytes:
    file = io.BytesIO()
    image.save(file, format=kind, **options)
    return file.getvalue()


def plain(header: bytes, levels: np.ndarray) -> bytes:
    return header + b"\n" + b"\n".join(b" ".join(b"%d" % level for level in row) for row in levels) + b"\n"


def make_images() -> dict[str, bytes]:
    grey = Image.fromarray(GREYS)
    palette = grey.convert("P")
    deep = GREYS.astype(np.uint16) * 257
    return {
        "P5": b"P5\n13 9\n255\n" + GREYS.tobytes(),
        "P5 16 bit": b"P5\n13 9\n65535\n" + deep.astype(">u2").tobytes(),
        "P5 odd": b"P5\n# by hand\n13 9\n254\n" + GREYS.tobytes(),
        "P2": plain(b"P2\n# by hand\n13 9\n255", GREYS),
        "P2 16 bit": plain(b"P2 13 9 60000", GREYS.astype(int) * 230),
        "P3": plain(b"P3 13 9 255", GREYS.repeat(3, axis=1)),
        "P6": b"P6 13 9 255\n" + GREYS.repeat(3, axis=1).tobytes(),
        "P1": plain(b"P1 13 9", GREYS // 128),
        "P4": save(grey.convert("1"), "PPM"),
        "png": save(grey, "PNG"),
        "png 16 bit": save(Image.fromarray(deep), "PNG"),
        "png palette": save(palette, "PNG", bits=4),
        "png palette, alpha": save(palette, "PNG", transparency=bytes(range(200))),
        "png grey, alpha": save(grey.convert("LA"), "PNG"),
        "png rgba": save(grey.convert("RGBA"), "PNG", pnginfo=None),
        "png transparent grey": save(grey, "PNG", transparency=205),
        "bmp": save(grey, "BMP"),
        "bmp rgb": save(grey.convert("RGB"), "BMP"),
        "bmp rgba": save(grey.convert("RGBA"), "BMP"),
        "bmp run lengths": run_lengths(),
    }


def run_lengths() -> bytes:
    """An RLE8 BMP: runs, literals, jumps, and both ends."""
    row, literals, jump = b"\x0d\xcd\x00\x00", b"\x00\x05\x01\x02\x03\x04\x05\x00", b"\x00\x02\x03\x00"
    data = row * 5 + literals + jump + b"\x05\xfe\x00\x00" + row * 3 + b"\x00\x01"
    colours = b"".join(bytes([level] * 3 + [0]) for level in range(256))
    head = struct.pack("<IiiHHIIiiII", 40, 13, 9, 1, 8, 1, len(data), 2835, 2835, 256, 0)
    return b"BM" + struct.pack("<IHHI", 54 + 1024 + len(data), 0, 0, 54 + 1024) + head + colours + data


def spoil_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Flip, cut, double, drop, insert; most often one of them, near the front as often as anywhere."""
    out = bytearray(data)
    for _ in range(1 + rng.poisson(0.5)):
        at = int(rng.integers(0, max(1, len(out) if rng.random() < 0.5 else min(len(out), 60))))
        size = int(rng.integers(1, 9))
        match int(rng.integers(7)):
            case 0:
                out[at : at + 1] = bytes([int(rng.integers(256))])
            case 1 if len(out) > at:
                out[at] ^= 1 << int(rng.integers(8))
            case 2:
                del out[at:]
            case 3:
                del out[at : at + size]
            case 4:
                out[at:at] = out[at : at + 8 * size]
            case 5:
                out[at:at] = rng.bytes(size)
            case _:
                out[at : at + size] = b"\xff" * size if rng.random() < 0.5 else bytes(size)
    return bytes(out)


def spoil_yaml(data: bytes, rng: np.random.Generator) -> bytes:
    """Another value, a line twice, gone or elsewhere, a key with capitals, or single bytes."""
    lines = data.splitlines(keepends=True)
    at = int(rng.integers(len(lines)))
    value = VALUES[int(rng.integers(len(VALUES)))]
    match int(rng.integers(8)):
        case 0 | 1:
            lines[at] = lines[at].split(b":")[0] + [b": ", b":\t", b":", b" : "][int(rng.integers(4))] + value + b"\n"
        case 2:
            lines.insert(int(rng.integers(len(lines) + 1)), lines[at])
        case 3:
            lines.insert(at, value + b"\n")
        case 4:
            del lines[at]
        case 7:
            lines.append(lines.pop(at).replace(b" ", b"\t"))
        case 5:
            spot = int(rng.integers(len(data) + 1))
            return data[:spot] + value + data[spot:]
        case _:
            return spoil_bytes(data, rng)
    return b"".join(lines)


def spoil_image(data: bytes, rng: np.random.Generator) -> bytes:
    if data.startswith(b"\x89PNG") and rng.random() < 0.7:
        return spoil_png(data, rng)
    if data[:1] == b"P" and rng.random() < 0.5:  # a number of the header
        number = str(rng.choice([0, 1, -1, 12, 14, 99_999, 2**31, 65_535, 65_536, 10**10])).encode()
        words = data.split(maxsplit=4)
        words[int(rng.integers(len(words)))] = number
        return b" ".join(words)
    return spoil_bytes(data, rng)


def spoil_png(data: bytes, rng: np.random.Generator) -> bytes:
    """Behind the checksums: what a chunk holds, packed and summed again, so that the parsers see it."""
    chunks, at = [], 8
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    which = int(rng.integers(len(chunks)))
    kind, body = chunks[which]
    if kind == b"IDAT":
        chunks[which] = kind, zlib.compress(spoil_bytes(zlib.decompress(body), rng))
    else:
        chunks[which] = kind, spoil_bytes(body, rng)
    if rng.random() < 0.2:
        kinds = [b"tRNS", b"PLTE", b"IEND", b"IDAT", b"IHDR", b"acTL", b"fcTL", b"zTXt", b"iCCP", b"gAMA", b"eXIf"]
        chunks.insert(int(rng.integers(len(chunks) + 1)), (kinds[int(rng.integers(len(kinds)))], rng.bytes(6)))
    if rng.random() < 0.2:
        chunks.append(chunks.pop(int(rng.integers(len(chunks)))))
    packed = (
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )
    return data[:8] + b"".join(packed)


def judge(path: Path) -> OccupancyGrid | MapFormatError:
    """What comes of a file; any other exception is what the tests look for."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a library's warnings must not leak, either
            warnings.simplefilter("ignore", MapWarning)
            return load_map(path)
    except MapFormatError as error:
        return error


def run(
    folder: Path, cases: int, seed: int, spoilt: Callable[[np.random.Generator], tuple[bytes, bytes]]
) -> Counter[str]:
    rng = np.random.default_rng(seed)
    path, outcomes = folder / "map.yaml", Counter[str]()
    for case in range(cases):
        header, image = spoilt(rng)
        path.write_bytes(header)
        (folder / "map.img").write_bytes(image)
        try:
            found = judge(path)
        except Exception as error:
            error.add_note(f"case {case} of seed {seed}: {header!r} {image[:200]!r}")
            raise
        if isinstance(found, MapFormatError):
            assert found.path.startswith((str(folder), "/dev/null")), (case, found)
            assert found.field, (case, found)
            assert found.reason, (case, found)
            str(found).encode()  # can be printed
            outcomes["refused"] += 1
        else:
            outcomes["read"] += 1
    return outcomes


@pytest.fixture
def memory():
    """The process takes no more than so much beyond what it had."""

    def most_mb() -> float:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

    before = most_mb()
    yield
    assert most_mb() - before < MOST_MB


@pytest.mark.usefixtures("memory")
def test_a_spoilt_yaml_is_a_map_or_is_refused(tmp_path: Path) -> None:
    image = make_images()["P5"]
    outcomes = run(tmp_path, CASES // 2, 1, lambda rng: (spoil_yaml(HEADER, rng), image))
    assert min(outcomes["read"], outcomes["refused"]) > CASES // 50, outcomes


@pytest.mark.usefixtures("memory")
def test_a_spoilt_image_is_a_map_or_is_refused(tmp_path: Path) -> None:
    images = list(make_images().values())

    def spoilt(rng: np.random.Generator) -> tuple[bytes, bytes]:
        mode = [b"", b"mode: scale\n", b"mode: raw\n"][int(rng.integers(3))]
        return HEADER + mode, spoil_image(images[int(rng.integers(len(images)))], rng)

    outcomes = run(tmp_path, CASES // 2, 2, spoilt)
    assert min(outcomes["read"], outcomes["refused"]) > CASES // 50, outcomes


@pytest.mark.parametrize("kind", make_images())
def test_the_images_that_are_spoilt_are_sound(tmp_path: Path, kind: str) -> None:
    (tmp_path / "map.yaml").write_bytes(HEADER)
    (tmp_path / "map.img").write_bytes(make_images()[kind])
    found = judge(tmp_path / "map.yaml")
    assert isinstance(found, OccupancyGrid), found
    assert found.cells_yx.shape == GREYS.shape
