"""Does any small grid make a vector map that breaks a promise? Many random ones, in all profiles, and verified.

Each seed is one grid of up to 40 x 40 cells, vectorized once in each profile; every fourth one goes on with updates:
changed windows, other sizes, other phases. A map must have no violation (``verify``), the exact one must give its grid
back, and the same grid once more the same map. A failure is printed with the command that repeats it, and prints a
program with the smallest grids that fail in this way:

    python benchmarks/fuzz_vectorize.py --grids 100000
    python benchmarks/fuzz_vectorize.py --seed 4711
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2
from fleetmap.vectorize import Vectorizer, rasterize, verify

PROFILES = ("share", "full", "exact")
EPSILONS = (2**0.5, 2**0.5, 1.0, 3.0, 0.5)
SPECKS = (0, 12)
RESOLUTION_M = 0.05
MOST_CELLS = 40
UPDATES = 4
CHUNK = 50
MOST_LINES = 100
"""So many failures are printed; all are counted."""


def random_states(rng: np.random.Generator) -> NDArray[np.uint8]:
    """Blobs, noise, thin walls or checkerboards, of any density and size."""
    height, width = rng.integers(1, rng.choice([6, 16, MOST_CELLS]) + 1, 2)
    shape = (height, width)
    density = rng.dirichlet(rng.choice([[1, 1, 1], [4, 2, 2], [9, 1, 1], [1, 1, 9]]))
    kind = rng.integers(5)
    if kind == 0:  # blobs of one size
        k = int(rng.integers(1, 8))
        states = np.kron(rng.choice(3, (height // k + 1, width // k + 1), p=density), np.ones((k, k), int))
        states = states[:height, :width]
    elif kind == 1:  # rooms: thin walls in free space, some of them with a gap
        states = np.full(shape, FREE)
        for _ in range(rng.integers(1, 7)):
            line = np.zeros(shape, bool)
            (y, x), thick = rng.integers(0, shape), rng.integers(1, 4)
            if rng.random() < 0.5:
                line[y : y + thick] = True
            else:
                line[:, x : x + thick] = True
            line &= rng.random(shape) < rng.choice([1, 0.9])
            states[line] = rng.choice([OCCUPIED, OCCUPIED, UNKNOWN])
    elif kind == 2:  # a checkerboard of two or three states
        y, x = np.indices(shape) // rng.integers(1, 4)
        states = rng.permutation(3)[(y + x * rng.integers(1, 3)) % rng.integers(2, 4)]
    elif kind == 3:  # slanted stripes
        y, x = np.indices(shape)
        states = rng.permutation(3)[((y * rng.normal() + x * rng.normal()) // rng.uniform(1, 6)).astype(int) % 3]
    else:  # a disc of free space with a skin, unknown behind
        y, x = np.indices(shape)
        off = np.hypot(y - rng.uniform(0, height), x - rng.uniform(0, width)) - rng.uniform(0, max(shape))
        off += rng.normal(size=shape) * rng.choice([0, 0.5, 1])
        states = np.where(off < 0, FREE, np.where(off < rng.uniform(0.5, 3), OCCUPIED, UNKNOWN))
    noise = rng.random(shape) < rng.choice([0, 0, 0.03, 0.1, 0.3])
    return np.where(noise, rng.choice(3, shape, p=density), states).astype(np.uint8)


@dataclass(frozen=True)
class Frame:
    """One grid that a vectorizer sees: states, where its corner is in cells, and where it may have changed, if told."""

    states: NDArray[np.uint8]
    place_yx: tuple[float, float] = (0.0, 0.0)
    window: tuple[int, int, int, int] | None = None

    def grid(self) -> OccupancyGrid:
        """As the vectorizer takes it."""
        y, x = self.place_yx
        return OccupancyGrid.from_states(self.states, RESOLUTION_M, Pose2(x * RESOLUTION_M, y * RESOLUTION_M))


@dataclass(frozen=True)
class Case:
    """What is asked: a profile, its options, and the grids, one after the other."""

    profile: str
    options: dict[str, float]
    frames: tuple[Frame, ...]

    def failures(self) -> list[str]:
        """What is wrong; the first frame that fails is the last one."""
        try:
            return self._failures()
        except Exception as error:
            at = traceback.extract_tb(error.__traceback__)[-1]
            return [f"{type(error).__name__} in {at.name}, line {at.lineno} of {Path(at.filename).name}: {error}"]

    def _failures(self) -> list[str]:
        vectorizer = Vectorizer(profile=self.profile, **self.options)
        for k, frame in enumerate(self.frames):
            grid = frame.grid()
            vector_map = vectorizer.update(grid, frame.window)
            violations = verify(grid, vector_map, specks=int(self.options.get("specks", 0))).violations
            found = [f"{v.kind} at {v.place_xy_m}: {v.detail}" for v in violations]
            if self.profile == "exact":
                wrong = rasterize(vector_map, like=grid).states_yx() != frame.states
                if wrong.any():
                    found.append(f"round trip: {wrong.sum()} cells differ, the first (y, x) = {np.argwhere(wrong)[0]}")
            if k == 0 and vectorizer.update(grid).digest != vector_map.digest:
                found.append("the same grid gave another map")
            if found:
                return [f"update {k}: {text}" if k else text for text in found]
        return []

    def program(self) -> str:
        """Python that shows the failure."""
        frames = [
            (["".join(".#?"[s] for s in row) for row in f.states[::-1].tolist()], f.place_yx, f.window)
            for f in self.frames
        ]
        lines = "\n".join(f"    ({rows}, {place}, {window})," for rows, place, window in frames)
        return PROGRAM.format(lines=lines, profile=self.profile, options=self.options, **self.options)


PROGRAM = """
import numpy as np
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.pose import Pose2
from fleetmap.vectorize import Vectorizer, verify

FRAMES = [  # rows from the top, the corner (y, x) in cells, the changed window
{lines}
]
vectorizer = Vectorizer(profile="{profile}", **{options})
for rows, (y, x), window in FRAMES:
    states = np.array([[".#?".index(c) for c in row] for row in reversed(rows)], np.uint8)
    grid = OccupancyGrid.from_states(states, 0.05, Pose2(x * 0.05, y * 0.05))
    vector_map = vectorizer.update(grid, window)
    print(vector_map.edges.tolist())
    print(verify(grid, vector_map, specks={options}.get("specks", 0)).violations)
"""


def change(rng: np.random.Generator, states: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], tuple[int, int, int, int]]:
    """Other states in a window (y0, x0, y1, x1): new ones, noise, or all of one."""
    (y0, x0), (h, w) = rng.integers(0, states.shape), rng.integers(1, 13, 2)
    y1, x1 = min(y0 + h, states.shape[0]), min(x0 + w, states.shape[1])
    states = states.copy()
    window = states[y0:y1, x0:x1]
    fresh = np.full(window.shape, rng.integers(3)) if rng.random() < 0.4 else rng.integers(0, 3, window.shape)
    window[:] = np.where(rng.random(window.shape) < rng.choice([0.2, 0.6, 1]), fresh, window)
    return states, (int(y0), int(x0), int(y1), int(x1))


def later_frames(rng: np.random.Generator, states: NDArray[np.uint8]) -> Iterator[Frame]:
    """What becomes of a grid: windows of it change, told or not, or it grows to the left and below, in any phase."""
    y, x = 0.0, 0.0
    for _ in range(UPDATES):
        window = None
        kind = rng.integers(4)
        if kind == 0:
            pad = rng.integers(0, 4, 2)
            states = np.pad(states, ((pad[0], 0), (pad[1], 0)), constant_values=UNKNOWN)
            phase = rng.integers(-5, 6, 2) / 16 * rng.integers(2)
            y, x = float(round(y) - pad[0] + phase[0]), float(round(x) - pad[1] + phase[1])
        else:
            states, window = change(rng, states)
        yield Frame(states, (y, x), window if kind > 1 else None)


def cases(seed: int) -> Iterator[Case]:
    """All that is asked about a seed."""
    rng = np.random.default_rng(seed)
    states = random_states(rng)
    for profile in PROFILES:
        options = {"epsilon_cells": float(rng.choice(EPSILONS)), "specks": int(rng.choice(SPECKS))}
        frames = tuple(later_frames(np.random.default_rng([seed, 1]), states)) if seed % 4 == 0 else ()
        yield Case(profile, {} if profile == "exact" else options, (Frame(states), *frames))


def shrink(case: Case) -> Case:
    """Take frames, rows, columns and cells away as long as it fails in the same way."""

    def kind_of(case: Case) -> str:
        failures = case.failures()
        return failures[-1].split(":")[-2 if failures[-1].startswith("update") else 0][:12] if failures else ""

    kind = kind_of(case)
    progress = True
    while progress:
        progress = False
        for smaller in _smaller(case):
            if kind_of(smaller) == kind:
                case, progress = smaller, True
                break
    return case


def _smaller(case: Case) -> Iterator[Case]:
    frames = case.frames
    for k in range(len(frames)):
        if len(frames) > 1:
            yield replace(case, frames=_with_windows([*frames[:k], *frames[k + 1 :]]))
    for axis in (0, 1):
        for k in range(1, min(f.states.shape[axis] for f in frames)):  # they grow at the other end
            cut = [replace(f, states=np.delete(f.states, f.states.shape[axis] - k, axis)) for f in frames]
            yield replace(case, frames=_with_windows(cut))
    for k, frame in enumerate(frames):
        for y, x in np.ndindex(*frame.states.shape):
            for plain in range(frame.states[y, x] if frame.states[y, x] != UNKNOWN else FREE):
                states = frame.states.copy()
                states[y, x] = plain
                yield replace(
                    case, frames=_with_windows([*frames[:k], replace(frame, states=states), *frames[k + 1 :]])
                )


def _with_windows(frames: list[Frame]) -> tuple[Frame, ...]:
    """The same, with windows around what does change where one was told."""
    result = [replace(frames[0], window=None)]
    for before, frame in zip(frames[:-1], frames[1:], strict=True):
        window = None
        if frame.window is not None and before.states.shape == frame.states.shape:
            y, x = np.nonzero(before.states != frame.states)
            window = (int(y.min()), int(x.min()), int(y.max()) + 1, int(x.max()) + 1) if len(y) else (0, 0, 0, 0)
        result.append(replace(frame, window=window))
    return tuple(result)


def examine_chunk(first: int) -> list[tuple[int, Case, list[str]]]:
    """What goes wrong with ``CHUNK`` seeds."""
    asked = ((seed, case) for seed in range(first, first + CHUNK) for case in cases(seed))
    return [(seed, case, failures) for seed, case in asked if (failures := case.failures())]


def repeat(seed: int) -> int:
    """Print all about one seed."""
    failed = [case for case in cases(seed) if case.failures()]
    for case in failed:
        smallest = shrink(case)
        print(f"# seed {seed}, {case.profile} {case.options}: {case.failures()[0]}")
        print(f"# smallest: {smallest.failures()[0]}{smallest.program()}")
    print(f"# seed {seed}: {len(failed)} failures")
    return int(bool(failed))


def main() -> int:
    """Run the seeds; 1 if any fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grids", type=int, default=100_000, help="how many seeds (default 100000)")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--seed", type=int, help="only this seed: repeat a failure")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--tiny", action="store_true", help="a hundred grids in this process: for the tests")
    options = parser.parse_args()
    if options.seed is not None:
        return repeat(options.seed)
    started, done, failures = time.monotonic(), 0, 0
    grids = 2 * CHUNK if options.tiny else options.grids
    chunks = range(options.first, options.first + grids, CHUNK)
    pool = None if options.tiny else multiprocessing.get_context("spawn").Pool(options.processes)
    for found in map(examine_chunk, chunks) if pool is None else pool.imap_unordered(examine_chunk, chunks):
        done += CHUNK
        for seed, case, texts in found[: max(0, MOST_LINES - failures)]:
            command = f"python {os.path.relpath(__file__)} --seed {seed}"
            print(f"{command}  # {case.profile} {case.options}, {len(texts)} in all: {texts[0]}", flush=True)
        failures += len(found)
        if sys.stderr.isatty() or done % (100 * CHUNK) == 0:
            rate = done / (time.monotonic() - started)
            print(f"\r{done} of {grids} grids, {failures} failures, {rate:.0f} a second", end="", file=sys.stderr)
    print(file=sys.stderr)
    if pool is not None:
        pool.close()
        pool.join()
    print(f"{done} grids, profiles {', '.join(PROFILES)}: {failures} failures in {time.monotonic() - started:.0f} s")
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
