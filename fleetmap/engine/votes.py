"""What mirrors say of an absent author: which revision to believe, and where they contradict each other."""

from __future__ import annotations

from collections.abc import Mapping

from fleetmap.codecs.messages import Revision
from fleetmap.engine.stream import Key


def most_held(claims: Mapping[Key, Revision], seq: int) -> Revision | None:
    """Of the revisions that are claimed under a seq the one that most names hold; ties go to the larger digest.

    Parameters
    ----------
    claims : by whom
    seq : the latest that was shown. Later ones are only claimed as long as nobody shows them, and need no votes then:
        nobody can show a later one than the author has said (``engine.chain``)
    """
    names: dict[Revision, set[str]] = {}
    for (name, _), revision in claims.items():
        if revision.seq == seq and revision.digest:  # 0 where a digest wasn't said
            names.setdefault(revision, set()).add(name)
    return max(names, key=lambda revision: (len(names[revision]), revision.digest), default=None)


def contradictions(claims: Mapping[Key, Revision], held: Revision, me: str) -> dict[int, list[str]]:
    """Who holds what of the revision that is held here, if not all hold the same: digest -> names, ascending."""
    names: dict[int, set[str]] = {held.digest: {me}}
    for (name, _), revision in claims.items():
        if revision.seq == held.seq and revision.digest:
            names.setdefault(revision.digest, set()).add(name)
    return {digest: sorted(those) for digest, those in sorted(names.items())} if len(names) > 1 else {}
