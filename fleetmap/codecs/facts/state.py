"""(seq, link), one state of a stream, as the value of a fact: 4 and 8 bytes, the highest first.

The link (``engine.chain``) and not the digest: nobody can name a state that the author hasn't come to.
"""

from __future__ import annotations

State = tuple[int, int]
"""(seq, link)."""


def pack_state(state: State) -> bytes:
    """12 bytes."""
    return state[0].to_bytes(4, "big") + state[1].to_bytes(8, "big")


def unpack_state(value: bytes) -> State:
    """The state in a value; ``ValueError`` if it is none."""
    if len(value) != 12:
        raise ValueError("expected a seq and a link in 12 bytes")
    return int.from_bytes(value[:4], "big"), int.from_bytes(value[4:], "big")
