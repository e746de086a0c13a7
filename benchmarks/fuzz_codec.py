"""Do any bytes hurt a receiver? Random, mutated, cut and spliced payloads of all modes and of the exact layer.

First each bit of the golden files is flipped. Then payloads of generated maps (snapshots, deltas and grids) and the
golden ones are spoilt in other ways. Whatever comes of them must be refused with a ``WireError``, or be a delta that
applies (or is told not to fit), or states, within half a second. The most memory that the process took is printed. With
--atheris, if it is installed, coverage leads the way; that sees into kernels only while they aren't compiled.

    python benchmarks/fuzz_codec.py --cases 200000 [--seed 1]
    NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=/tmp/checked python benchmarks/fuzz_codec.py --cases 50000
    NUMBA_DISABLE_JIT=1 python benchmarks/fuzz_codec.py --atheris 600
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from fleetmap.codecs import protocol
from fleetmap.codecs.context_grid import decode_states, encode_states
from fleetmap.model.delta import apply, diff
from fleetmap.model.errors import WireError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import Lattice
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize import Vectorizer

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from golden import read_golden

MOST_S = 0.5
"""No payload here has more than 4 kB; on a slow and busy machine that takes far less than this."""

Seed = tuple[str, bytes, VectorMap]


def make_seeds(rng: np.random.Generator, maps: int) -> list[Seed]:
    """Payloads with their kind and base."""
    seeds: list[Seed] = []
    for _ in range(maps):
        height, width = rng.integers(20, 90, 2)
        states = np.full((height, width), 2, np.uint8)
        states[3:-3, 3:-3] = 1
        states[5:-5, 5:-5] = 0
        vectorizer = Vectorizer(profile=str(rng.choice(["share", "full"])))
        base = None
        for _ in range(3):
            noise = rng.random(states.shape) < 0.02
            states[noise] = rng.integers(0, 3, int(noise.sum()))
            vector_map = vectorizer.update(OccupancyGrid.from_states(states.copy(), 0.05))
            base = base or VectorMap.empty(vector_map.lattice, profile=vector_map.profile)
            delta = diff(base, vector_map)
            for mode in protocol.CODECS:
                try:
                    seeds.append((f"mode {mode}", protocol.encode(delta, base, mode=mode), base))
                except ValueError:
                    continue  # not for this mode
            seeds.append(("exact", encode_states(states), base))
            base = vector_map
    return seeds


def golden_seeds() -> list[Seed]:
    """The payloads in tests/data/v1, with their bases."""
    seeds: list[Seed] = []
    for mode in protocol.CODECS:
        for run in read_golden(f"mode{mode}"):
            base = VectorMap.empty(Lattice(50_000))
            for payload, _ in run:
                seeds.append((f"mode {mode}", payload, base))
                base = apply(base, protocol.decode(payload, base, robot="golden"))
    return [*seeds, ("exact", read_golden("exact")[0][0][0], base)]


def mutate(rng: np.random.Generator, seed: bytes, other: bytes) -> bytes:
    """One of many ways to go wrong."""
    data = bytearray(seed)
    for _ in range(rng.integers(1, 4)):
        kind = rng.integers(7)
        at = int(rng.integers(len(data))) if data else 0
        if kind == 0 and data:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1 and data:
            data[at] = int(rng.choice([0, 1, 127, 128, 255, rng.integers(256)]))
        elif kind == 2:
            del data[at : at + int(rng.integers(1, 9))]
        elif kind == 3:
            data[at:at] = rng.bytes(int(rng.integers(1, 9)))
        elif kind == 4:
            data = data[:at] + other[int(rng.integers(len(other) + 1)) :]
        elif kind == 5:
            data = data[:at]
        else:
            data = data[:1] + bytearray(rng.bytes(int(rng.integers(0, 200))))
    return bytes(data)


def try_one(kind: str, data: bytes, base: VectorMap) -> str:
    """``refused``, ``applied`` or ``misfit``; anything else is raised."""
    try:
        if kind == "exact":
            states = decode_states(data, robot="fuzz")
            assert states.max(initial=0) <= 2
            return "applied"
        delta = protocol.decode(data, base, robot="fuzz")
    except WireError:
        return "refused"
    try:
        made = apply(base, delta)
    except ValueError:
        return "misfit"
    assert len(made) == len(base) - len(delta.removed) + len(delta.added)
    return "applied"


def main() -> int:
    """Run the cases; 1 if any was slow or raised something else."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--atheris", type=int, metavar="SECONDS", help="led by coverage; needs the package atheris")
    parser.add_argument("--tiny", action="store_true", help="a thousand cases: for the tests")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    golden = golden_seeds()
    seeds = make_seeds(rng, 2 if options.tiny else 12) + golden
    for kind, data, base in seeds:  # loads the kernels, too
        assert try_one(kind, data, base) == "applied"
    if options.atheris:
        return lead_by_coverage(seeds, options.atheris)
    outcomes: dict[str, Counter[str]] = {}
    slowest = (0.0, "", b"")
    failures = 0

    def take(way: str, kind: str, data: bytes, base: VectorMap) -> None:
        nonlocal slowest, failures
        started = time.process_time()
        try:
            outcome = try_one(kind, data, base)
        except Exception as error:
            failures += 1
            outcome = type(error).__name__
            print(f"{way} {kind}: {error!r}: {data.hex()}", flush=True)
        slowest = max(slowest, (time.process_time() - started, kind, data))
        outcomes.setdefault(f"{way}, {kind}", Counter())[outcome] += 1

    for kind, data, base in golden:
        for bit in range(0, 8 * len(data), 97 if options.tiny else 1):
            flipped = bytearray(data)
            flipped[bit // 8] ^= 1 << bit % 8
            take("a bit flipped", kind, bytes(flipped), base)
    cases = 1000 if options.tiny else options.cases
    for case in range(cases):
        kind, seed, base = seeds[int(rng.integers(len(seeds)))]
        take("mutated", kind, mutate(rng, seed, seeds[int(rng.integers(len(seeds)))][1]), base)
        if case % 5000 == 0 and sys.stderr.isatty():
            print(f"\r{case} of {cases}, {failures} failures", end="", file=sys.stderr)
    for kind, counts in sorted(outcomes.items()):
        total = sum(counts.values())
        shares = ", ".join(f"{name} {100 * count / total:.1f} %" for name, count in sorted(counts.items()))
        print(f"{kind:22s}{total:8d} payloads: {shares}")
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{failures} failures; the slowest took {slowest[0] * 1e3:.0f} ms ({slowest[1]}); at most {megabytes:.0f} MB")
    return int(failures > 0 or slowest[0] > MOST_S)


def lead_by_coverage(seeds: list[Seed], seconds: int) -> int:
    """Hand the seeds to atheris, which ends the process with what it found."""
    import atheris

    cases = seeds[:: max(1, len(seeds) // 200)]  # one byte says which base

    def one_input(data: bytes) -> None:
        if len(data) > 1:
            kind, _, base = cases[data[0] % len(cases)]
            try_one(kind, data[1:], base)

    with tempfile.TemporaryDirectory() as folder:
        for i, (_, payload, _) in enumerate(cases):
            (Path(folder) / f"{i}").write_bytes(bytes([i]) + payload)
        atheris.instrument_all()
        limits = [f"-max_total_time={seconds}", "-rss_limit_mb=4096", f"-artifact_prefix={tempfile.gettempdir()}/"]
        atheris.Setup([sys.argv[0], folder, *limits], one_input)
        atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main())
