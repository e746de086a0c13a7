"""How many questions and bytes two peers need to find the few of many streams that they hold differently.

Engines alone: one asks the other, by ranges of places, until it knows all that the other holds otherwise. Beside it,
what a list of all would take.

    python benchmarks/differences.py [--json]
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np

from fleetmap.codecs import envelope
from fleetmap.codecs.messages import MAX_ROWS, Heartbeat, Ranges, Revision, RevisionList, Row
from fleetmap.engine.ranges import MOST_RANGES, Index

CASES = ((200, 1), (200, 100), (1000, 1), (10_000, 1), (10_000, 100), (1_000_000, 1))
TINY = ((200, 1),)


def streams(count: int, rng: np.random.Generator) -> list[Row]:
    """Random rows of a list."""
    lives, digests = rng.integers(1 << 63, size=(2, count))
    seqs = rng.integers(1, 60_000, count)
    names = [f"r{k % 1000}" for k in range(count)]
    rows = zip(names, lives.tolist(), seqs.tolist(), digests.tolist(), strict=True)
    return [(name, Revision(life, seq, digest)) for name, life, seq, digest in rows]


def measure(count: int, differing: int) -> dict[str, object]:
    """One peer asks another one, which is a revision ahead in some streams."""
    rng = np.random.default_rng(0)
    mine = streams(count, rng)
    theirs = mine.copy()
    for k in rng.choice(count, differing, replace=False).tolist():
        robot, was = mine[k]
        theirs[k] = (robot, Revision(was.life, was.seq + 1, int(rng.integers(1 << 63))))
    asker, asked = Index(mine), Index(theirs)
    began_s = time.process_time()
    found: set[tuple[str, int]] = set()
    # The first question and its answer, as peers put them: the hash over all, and what is held in ranges.
    answer = asked.describe()
    size_bytes = len(envelope.encode(Heartbeat(1, asker.held(), 1))) + len(envelope.encode(Ranges(tuple(answer))))
    rounds, further = 1, asker.ask_further(answer)
    while further:
        question, further = further[:MOST_RANGES], further[MOST_RANGES:]
        answer = asked.answer(question)
        size_bytes += sum(len(envelope.encode(Ranges(tuple(ranges)))) for ranges in (question, answer))
        found |= {key for of in answer if of.rows is not None for key in asker.differences(of)}
        rounds, further = rounds + 1, further + asker.ask_further(answer)
    assert len(found) == differing
    part = mine[:MAX_ROWS]
    listed = len(envelope.encode(RevisionList(tuple(part)))) * count // len(part)
    cpu_ms = 1000 * (time.process_time() - began_s)
    return {
        "streams": count,
        "differing": differing,
        "rounds": rounds,
        "bytes": size_bytes,
        "list_bytes": listed,
        "cpu_ms": round(cpu_ms, 1),
    }


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tiny", action="store_true", help="one case")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = [measure(*case) for case in (TINY if options.tiny else CASES)]
    if options.json:
        print(json.dumps(rows))
        return
    print("| streams | differing | rounds | bytes | a list of all, bytes | CPU, ms |\n|---|---|---|---|---|---|")
    for row in rows:
        print("| " + " | ".join(str(value) for value in row.values()) + " |")


if __name__ == "__main__":
    main()
