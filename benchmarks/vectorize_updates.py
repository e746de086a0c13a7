"""What does an update cost, and does that depend on the size of the map? A disc uncovers a lane, step by step.

A terrain of 80 m as a robot maps it (1600 x 1600 cells), and four of them side by side, are known but for a lane. A
disc of 10 m moves along it by steps of 1.5 m, and what it covers becomes known. Timed is what a robot and a mate do:
``Vectorizer.update``, ``diff``, ``encode``; ``decode``, ``apply``. Medians of CPU time (``time.process_time``) over the
steps, the two sizes taking turns, and the ratio between them: 1 if the cost is that of the change alone.

    python benchmarks/vectorize_updates.py [--json]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vectorize import terrain

from fleetmap.codecs.protocol import decode, encode
from fleetmap.model.delta import apply, diff
from fleetmap.model.grid import OccupancyGrid
from fleetmap.vectorize import Vectorizer, verify

DISC_M, STEP_M = 10.0, 1.5
PROFILES = ("share", "full", "exact")
PARTS = ("update", "diff", "encode", "decode", "apply")
Window = tuple[int, int, int, int]
"""Rows and columns (row0, column0, row1, column1), half open, that may have changed."""


class Run:
    """A map that becomes known, and the vectorizer that follows it."""

    def __init__(self, truth: NDArray[np.int8], profile: str, steps: int) -> None:
        self.truth = truth
        self.cells = truth.copy()
        self.reach = round(DISC_M / 0.05)
        self.row = truth.shape[0] // 2
        self.cells[self.row - self.reach : self.row + self.reach] = -1
        self.vectorizer = Vectorizer(profile=profile)
        self.map = self.vectorizer.update(OccupancyGrid(self.cells, 0.05))
        self.received = self.map
        """What the teammate has."""
        self.times: dict[str, list[float]] = {part: [] for part in (*PARTS, "all")}
        self.sizes: list[int] = []
        self.places = self._places(steps)

    def _places(self, steps: int) -> Iterator[int]:
        first = self.truth.shape[1] // 2 - int(steps * STEP_M / 0.05) // 2
        return iter([first + round(k * STEP_M / 0.05) for k in range(steps)])

    def uncover(self, column: int) -> Window:
        """Make known what the disc covers; the window that it lies in."""
        reach = self.reach
        y0, y1 = max(self.row - reach, 0), min(self.row + reach, self.cells.shape[0])
        x0, x1 = max(column - reach, 0), min(column + reach, self.cells.shape[1])
        y, x = np.ogrid[y0:y1, x0:x1]
        disc = (y - self.row) ** 2 + (x - column) ** 2 < reach**2
        self.cells[y0:y1, x0:x1][disc] = self.truth[y0:y1, x0:x1][disc]
        return y0, x0, y1, x1

    def step(self, *, timed: bool) -> None:
        """One update, and its way to the teammate."""
        window = self.uncover(next(self.places))
        grid = OccupancyGrid(self.cells, 0.05)
        old = self.map
        clock = [time.process_time()]
        new = self.vectorizer.update(grid, window)
        clock.append(time.process_time())
        delta = diff(old, new)
        clock.append(time.process_time())
        payload = encode(delta, old)
        clock.append(time.process_time())
        received = decode(payload, self.received, robot="r0")
        clock.append(time.process_time())
        self.received = apply(self.received, received)
        clock.append(time.process_time())
        self.map = new
        assert self.received.digest == new.digest
        if timed:
            for part, before, after in zip(PARTS, clock[:-1], clock[1:], strict=True):
                self.times[part].append((after - before) * 1e3)
            self.times["all"].append((clock[-1] - clock[0]) * 1e3)
            self.sizes.append(len(payload))

    def violations(self) -> int:
        """How many the last map has."""
        return len(verify(OccupancyGrid(self.cells, 0.05), self.map).violations)


def measure(profile: str, truths: list[NDArray[np.int8]], steps: int, warm: int) -> dict[str, Any]:
    """Medians of one profile for each size, and the ratio of the last size to the first."""
    runs = [Run(truth, profile, steps) for truth in truths]
    for k in range(steps):
        for run in runs:
            run.step(timed=k >= warm)
    by_size = [
        {"cells": list(run.truth.shape), "edges": len(run.map), "violations": run.violations()}
        | {"bytes": float(np.median(run.sizes)), "ms": {p: float(np.median(t)) for p, t in run.times.items()}}
        for run in runs
    ]
    ratio = {part: by_size[-1]["ms"][part] / max(by_size[0]["ms"][part], 1e-9) for part in (*PARTS, "all")}
    return {"profile": profile, "sizes": by_size, "ratio": ratio}


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="one document instead of a table")
    parser.add_argument("--tiny", action="store_true", help="a terrain of 10 m, two steps: for the tests")
    options = parser.parse_args()
    size_m, steps, warm = (10, 2, 0) if options.tiny else (80, 40, 5)
    cells = terrain("office", size_m).cells_yx
    truths = [cells, np.tile(cells, (2, 2))]
    measured = [measure(profile, truths, steps, warm) for profile in PROFILES]
    if options.json:
        conditions = {"clock": "process_time", "disc_m": DISC_M, "step_m": STEP_M, "steps": steps - warm}
        json.dump({"conditions": conditions, "profiles": measured}, sys.stdout)
        return
    header = "".join(f"{part:>9s}" for part in (*PARTS, "all"))
    print(f"{'':8s}{'cells':>12s}{'edges':>8s}{'bytes':>8s}{header}{'bad':>6s}   (medians of {steps - warm} steps, ms)")
    for result in measured:
        for size in result["sizes"]:
            height, width = size["cells"]
            cells = "".join(f"{size['ms'][part]:9.3f}" for part in (*PARTS, "all"))
            print(
                f"{result['profile']:8s}{f'{height}x{width}':>12s}{size['edges']:8d}{size['bytes']:8.0f}"
                f"{cells}{size['violations']:6d}"
            )
        print(f"{'':8s}{'ratio':>12s}{'':16s}" + "".join(f"{result['ratio'][part]:9.2f}" for part in (*PARTS, "all")))


if __name__ == "__main__":
    main()
