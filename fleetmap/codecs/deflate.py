"""Raw deflate, bounded: a few bytes never become more memory than the caller allows."""

from __future__ import annotations

import zlib


def deflate(data: bytes) -> bytes:
    """Compressed at the highest level, without header or checksum: the digest stands for both."""
    squeeze = zlib.compressobj(9, zlib.DEFLATED, -15)
    return squeeze.compress(data) + squeeze.flush()


def inflate(data: bytes, *, max_bytes: int) -> bytes:
    """What ``deflate`` was given.

    Raises
    ------
    ValueError : the stream is damaged, is cut off, goes on behind its end, or is longer than ``max_bytes``
    """
    expand = zlib.decompressobj(-15)
    try:
        out = expand.decompress(data, max_bytes)
    except zlib.error as error:
        raise ValueError(f"deflate: {error}") from None
    if not expand.eof or expand.unused_data:
        raise ValueError(f"deflate: cut off, longer than {max_bytes} B, or followed by other bytes")
    return out
