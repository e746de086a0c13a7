"""What a payload codec is: a delta against a base map, to bytes and back. The first byte says which codec."""

from __future__ import annotations

from typing import Protocol

from fleetmap.codecs import mode0, mode1
from fleetmap.codecs.fields import DeltaFields, to_delta, to_fields
from fleetmap.model.delta import MapDelta, diff
from fleetmap.model.errors import ConfigError, WireError
from fleetmap.model.vectormap import VectorMap

MAX_PAYLOAD_BYTES = (4 << 20) + 1
"""Longest payload that is read: 4 MB and the byte that says what they are."""


class PayloadCodec(Protocol):
    """A codec: one module with these three names. A new one is a new file and a line in ``CODECS``."""

    MODE: int

    def encode(self, fields: DeltaFields, base: VectorMap) -> bytes:
        """Bytes of a delta; the low four bits of the first one are ``MODE``, the others its own flags."""
        ...

    def decode(self, payload: bytes, base: VectorMap) -> DeltaFields:
        """The fields in ``payload``; ``ValueError`` if anything about the bytes is wrong."""
        ...


CODECS: dict[int, PayloadCodec] = {mode0.MODE: mode0, mode1.MODE: mode1}


def encode(delta: MapDelta, base: VectorMap, *, mode: int | None = None) -> bytes:
    """A delta against ``base`` as a payload; a snapshot is a delta against the empty map.

    Unless a mode is named, that is mode 1, which takes fewer bytes, and mode 0 for what is too large for it.

    Raises
    ------
    ConfigError : the delta is larger than a payload of this mode may be
    """
    fields = to_fields(delta, base)
    if mode is not None:
        return CODECS[mode].encode(fields, base)
    try:
        return mode1.encode(fields, base)
    except ConfigError:
        return mode0.encode(fields, base)


def encode_snapshot(vector_map: VectorMap, *, mode: int | None = None) -> bytes:
    """A whole map as a payload: a delta against the empty map on the same lattice."""
    empty = VectorMap.empty(vector_map.lattice, epsilon_cells=vector_map.epsilon_cells, profile=vector_map.profile)
    return encode(diff(empty, vector_map), empty, mode=mode)


def decode(payload: bytes, base: VectorMap, *, robot: str) -> MapDelta:
    """The delta in a payload, checked before anything large is allocated.

    Raises
    ------
    WireError : the bytes are not a payload against this base; nothing else leaves
    """

    def refuse(reason: str) -> WireError:
        return WireError(robot=robot, size_bytes=len(payload), reason=reason)

    if not 0 < len(payload) <= MAX_PAYLOAD_BYTES:
        raise refuse(f"expected a payload of 1 to {MAX_PAYLOAD_BYTES} B")
    codec = CODECS.get(payload[0] & 0x0F)
    if codec is None:
        raise refuse(f"unknown payload mode {payload[0] & 0x0F}; this version reads {sorted(CODECS)}")
    try:
        return to_delta(codec.decode(payload, base), base)
    except ValueError as error:
        raise refuse(str(error)) from None
