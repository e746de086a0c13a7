"""What proves that an author has come to a seq: the next element of a hash chain whose end is the life.

From a secret, ``link(n)`` for the last seq n, every link is the hash of the one after it, and ``link(0)`` is the life:
64 bits that look random. Each record shows its link, and anybody can hash it back to one that is known. So nobody, a
stranger under the author's name or a lying mirror, can tell of a later revision than the author has said: for that he
would have to invert the hash. What a link doesn't prove is the content: who has seen it can put other content beside
it, in a race against the author, or when the author is gone. That needs signatures.

After L. Lamport, Password authentication with insecure communication, 1981.
"""

from __future__ import annotations

from hashlib import sha256

LINK_BYTES = 8
REVISIONS = 1 << 16
"""Revisions that an author says in one life: 18 hours of one a second. Drawing the chain takes 40 ms."""
STRIDE = 256
"""One link in so many is remembered; those between are hashed anew."""


def before(link: int, seq: int, steps: int) -> int:
    """The link that lies ``steps`` before that of ``seq``: the first 8 bytes of SHA-256 of (link, seq), so often."""
    raw = link.to_bytes(LINK_BYTES, "big")
    for at in range(seq, seq - steps, -1):
        raw = sha256(raw + at.to_bytes(4, "big")).digest()[:LINK_BYTES]
    return int.from_bytes(raw, "big")


class Chain:
    """The links of one life.

    Parameters
    ----------
    seed : 16 random bytes, never shown
    revisions : how many it has
    """

    def __init__(self, seed: bytes, *, revisions: int = REVISIONS) -> None:
        self.revisions = revisions
        self._seed = seed
        link = int.from_bytes(sha256(seed).digest()[:LINK_BYTES], "big")
        self._known = {revisions: link}
        for seq in range(revisions, 0, -STRIDE):
            steps = min(STRIDE, seq)
            link = before(link, seq, steps)
            self._known[seq - steps] = link

    @property
    def life(self) -> int:
        """The end that all know."""
        return self._known[0]

    def link(self, seq: int) -> int:
        """That of a revision; ``ValueError`` if there is none."""
        if not 0 <= seq <= self.revisions:
            raise ValueError(f"a life has {self.revisions} revisions")
        known = max(self.revisions - (self.revisions - seq) // STRIDE * STRIDE, seq)
        return before(self._known[known], known, known - seq)

    def next_seed(self) -> bytes:
        """The seed of the life after this one."""
        return sha256(self._seed + b"next").digest()[:16]
