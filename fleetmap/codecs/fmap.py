"""``.fmap`` files: a vector map or a merged map, in the bytes that travel between robots.

``FMAP``, then one msgpack array: version, kind, what the map is besides its edges, its edges, its digest; and, if there
are any, a map of facts, as streams have them (``codecs.facts``). This version writes none, and reads over those that it
finds.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import msgpack
import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs import protocol
from fleetmap.codecs.deflate import deflate, inflate
from fleetmap.codecs.envelope import map_header_fields, read_map_header
from fleetmap.codecs.facts.facts import MAX_FACTS, check_bounds
from fleetmap.codecs.files import read_behind, write_whole
from fleetmap.codecs.leb128 import decode_leb128, encode_leb128, unzigzag, zigzag
from fleetmap.codecs.messages import MapHeader
from fleetmap.model.delta import apply, diff
from fleetmap.model.errors import FleetmapError, MapFormatError, WireError
from fleetmap.model.mergedmap import MAX_FLEET_COORDINATE, ORIGIN_UM, MergedMap
from fleetmap.model.vectormap import VectorMap

MAGIC = b"FMAP"
VERSION, FIRST_VERSION = 2, 1
"""The first one is as the second without facts."""
KIND_VECTOR, KIND_MERGED = 1, 2
MAX_INFLATED_BYTES = 16 << 20

T = TypeVar("T")


def save_fmap(fleet_map: VectorMap | MergedMap, path: str | Path) -> None:
    """Write a map; the file appears whole or not at all.

    Raises
    ------
    OSError : the folder can't be written
    """
    if isinstance(fleet_map, VectorMap):
        header = MapHeader(fleet_map.lattice, fleet_map.epsilon_cells, fleet_map.profile)
        empty = _empty(header)
        payload = protocol.encode(diff(empty, fleet_map), empty)
        fields = [VERSION, KIND_VECTOR, map_header_fields(header), payload, fleet_map.digest]
    else:
        about = [fleet_map.resolution_um, fleet_map.tolerance, len(fleet_map)]
        if any(fleet_map.origin_um):
            about += [v // ORIGIN_UM for v in fleet_map.origin_um]
        fields = [VERSION, KIND_MERGED, about, _pack_merged(fleet_map.edges), int(fleet_map.digest, 16)]
    write_whole(Path(path), MAGIC + msgpack.packb(fields))


def load_fmap(path: str | Path) -> VectorMap | MergedMap:
    """Read a map.

    Raises
    ------
    MapFormatError : the file is missing or is no .fmap file, a field is out of bounds, or the digest doesn't fit
    """
    path = Path(path)

    def check(field: str, read: Callable[[], T]) -> T:
        try:
            return read()
        except WireError as error:
            raise MapFormatError(path=path, field=field, reason=error.reason) from None
        except (ValueError, TypeError, OverflowError, FleetmapError, msgpack.exceptions.UnpackException) as error:
            raise MapFormatError(path=path, field=field, reason=str(error) or type(error).__name__) from None

    data = read_behind(path, MAGIC)
    kind, about, payload, digest = check("envelope", lambda: _unpack(data))
    if kind == KIND_VECTOR:
        base = check("header", lambda: _empty(read_map_header(about)))
        vector_map = check("edges", lambda: apply(base, protocol.decode(payload, base, robot="file")))
        found: VectorMap | MergedMap = vector_map
        matches = vector_map.digest == digest
    else:
        merged = check("edges", lambda: _read_merged(about, payload))
        found, matches = merged, int(merged.digest, 16) == digest
    if not matches:
        raise MapFormatError(path=path, field="digest", reason="the file is damaged: its map has another digest")
    return found


def _empty(header: MapHeader) -> VectorMap:
    return VectorMap.empty(header.lattice, epsilon_cells=header.epsilon_cells, profile=header.profile)


def _unpack(data: bytes) -> tuple[int, tuple[object, ...], bytes, int]:
    fields = msgpack.unpackb(
        data,
        use_list=False,
        max_array_len=16,
        max_str_len=0,
        max_map_len=MAX_FACTS,
        max_ext_len=0,
        max_bin_len=len(data),
    )
    if not isinstance(fields, tuple) or len(fields) not in (5, 6):
        raise ValueError("expected an array of 5, or of 6 with facts")
    version, kind, about, payload, digest, *facts = fields
    known = type(version) is int and FIRST_VERSION <= version <= VERSION
    if not known or kind not in (KIND_VECTOR, KIND_MERGED):
        raise ValueError(
            f"version {version!r}, kind {kind!r}; this one reads versions {FIRST_VERSION} and {VERSION}, kinds 1 and 2"
        )
    if not isinstance(about, tuple) or not isinstance(payload, bytes) or type(digest) is not int:
        raise ValueError("expected an array, bytes and a number")
    if facts:
        _check_facts(version, facts[0])
    return kind, about, payload, digest


def _check_facts(version: int, facts: object) -> None:
    """Whatever they say: what they may take is known."""
    if version == FIRST_VERSION or not isinstance(facts, dict):
        raise ValueError(f"expected a map of facts, in version {VERSION}")
    if not all(isinstance(part, bytes) for item in facts.items() for part in item):
        raise ValueError("expected facts of bytes")
    check_bounds(facts)


def _pack_merged(edges: NDArray[np.int32]) -> bytes:
    """Column after column: y0 as steps up, x0 as steps, the other end from the first, sides, thickness."""
    y0, x0, y1, x1, left, right, obstacle, thickness = edges.astype(np.int64).T
    columns = [
        zigzag(np.diff(y0, prepend=0)),
        zigzag(np.diff(x0, prepend=0)),
        y1 - y0,
        zigzag(x1 - x0),
        left + 3 * right + 9 * obstacle,
        thickness,
    ]
    return deflate(encode_leb128(np.concatenate(columns)))


def _read_merged(about: tuple[object, ...], payload: bytes) -> MergedMap:
    numbers = [value for value in about if type(value) is int]
    if len(numbers) != len(about) or len(numbers) not in (3, 5) or numbers[3:] == [0, 0]:
        raise ValueError("expected three whole numbers, or five if the origin is not 0, 0")
    resolution_um, tolerance, count, x, y = (*numbers, 0, 0)[:5]
    if not (0 < resolution_um <= 10**7 and 0 <= tolerance <= MAX_FLEET_COORDINATE and count >= 0):
        raise ValueError("expected a resolution in um, a tolerance in lattice steps, and a number of edges")
    columns = decode_leb128(inflate(payload, max_bytes=MAX_INFLATED_BYTES))
    if len(columns) != 6 * count:
        raise ValueError(f"expected {6 * count} numbers; found {len(columns)}")
    up, along, dy, dx, sides, thickness = columns.reshape(6, count)
    if count and max(int(dy.max()), int(thickness.max())) > 2 * MAX_FLEET_COORDINATE:
        raise ValueError("an edge or a thickness is too long")
    y0, x0 = np.cumsum(unzigzag(up)), np.cumsum(unzigzag(along))
    rows = np.column_stack([y0, x0, y0 + dy, x0 + unzigzag(dx), sides % 3, sides // 3 % 3, sides // 9, thickness])
    if count and (np.abs(rows[:, :4]).max() > MAX_FLEET_COORDINATE or sides.max() > 17):
        raise ValueError("a coordinate or a side is out of bounds")
    return MergedMap(rows.astype(np.int32), resolution_um, tolerance, (x * ORIGIN_UM, y * ORIGIN_UM))
