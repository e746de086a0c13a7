"""Make fleetmap/codecs/mode2_start.py: the start probabilities of payload mode 2, from maps of generated worlds.

A robot maps terrains like those of the paper, of other seeds, as in ``fleetmap.paper``. About a minute:

    python benchmarks/train_mode2.py > fleetmap/codecs/mode2_start.py

The table is part of the format: another table is another mode. ``--tiny`` is for the tests: one small terrain.
"""

from __future__ import annotations

import argparse
import base64

import numpy as np

from fleetmap.codecs.fields import to_fields
from fleetmap.codecs.mode2 import count_decisions, fits
from fleetmap.codecs.mode2_layout import CONTEXTS
from fleetmap.model.delta import diff
from fleetmap.model.vectormap import VectorMap
from fleetmap.paper.survey import survey_terrain
from fleetmap.paper.terrains import Terrain
from fleetmap.vectorize import vectorize

SEEDS = (11, 12, 13, 14)
MOST_SEEN = 8
"""A start probability counts as seen so often at most: more would be slow to unlearn."""

LINE = 100


def main() -> None:
    """Print the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tiny", action="store_true", help="one terrain of 10 m: trains nothing useful")
    tiny = parser.parse_args().tiny
    counts = np.zeros((CONTEXTS, 2), np.int64)
    for seed in SEEDS[:1] if tiny else SEEDS:
        for kind in ("maze",) if tiny else ("maze", "office", "unstructured"):
            grid = survey_terrain(Terrain(kind, 10 if tiny else 40, seed)).grid
            for specks in (12, 0):
                vector_map = vectorize(grid, specks=specks)
                empty = VectorMap.empty(vector_map.lattice)
                fields = to_fields(diff(empty, vector_map), empty)
                if fits(fields, empty):
                    count_decisions(fields, counts)
    zeros, ones = counts.T
    share = (ones + 0.4) / (zeros + ones + 0.8)
    start = bytes(np.clip(np.rint(256 * share - 0.5), 0, 255).astype(np.uint8))
    seen = bytes(np.minimum(zeros + ones, MOST_SEEN).astype(np.uint8))
    print('"""Start probabilities of mode 2, and how sure they are: ``benchmarks/train_mode2.py`` makes them."""\n')
    print("import base64\nimport zlib")
    for name, table in (("START", start), ("SEEN", seen)):
        text = base64.b85encode(zlib_of(table)).decode()
        print(f"\n{name} = zlib.decompress(\n    base64.b85decode(")
        for i in range(0, len(text), LINE):
            print(f'        "{text[i : i + LINE]}"')
        print("    )\n)")


def zlib_of(table: bytes) -> bytes:
    """The table is mostly unused contexts."""
    import zlib

    return zlib.compress(table, 9)


if __name__ == "__main__":
    main()
