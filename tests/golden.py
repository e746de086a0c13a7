"""Write tests/data/v1: payloads of the format's version 1, which every later reader must read.

    python tests/golden.py

Once robots are under way, files are only added here, and none is written anew.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs import protocol
from fleetmap.codecs.context_grid import encode_states
from fleetmap.model.delta import diff
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import Lattice
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize import Vectorizer, vectorize

FOLDER = Path(__file__).parent / "data" / "v1"
EMPTY = VectorMap.empty(Lattice(50_000))
LINE = 118


def read_golden(name: str) -> list[list[tuple[bytes, str]]]:
    """The runs of a file: payloads with the digest of what comes out."""
    _, *blocks = (FOLDER / f"{name}.hex").read_text().split("\n\n")
    pairs = [[part.split("=") for part in block.replace("\n= ", "=").strip().splitlines()] for block in blocks]
    result: list[list[tuple[bytes, str]]] = []
    for block in pairs:
        run, text = [], ""
        for line in block:
            text += line[0]
            if len(line) == 2:
                run.append((bytes.fromhex(text), line[1]))
                text = ""
        result.append(run)
    return result


def rooms(seed: int, *, height: int = 90, width: int = 110, share: float = 1.0) -> NDArray[np.uint8]:
    """Rooms with ragged walls and crumbs; beyond a share of the width all is unknown."""
    rng = np.random.default_rng(seed)
    states = np.full((height, width), 2, np.uint8)
    for _ in range(3):
        y, x = rng.integers(3, height - 30), rng.integers(3, width - 40)
        states[y : y + 26, x : x + 36] = 1
        states[y + 2 : y + 24, x + 2 : x + 34] = 0
    noise = rng.random(states.shape) < 0.03
    states[noise] = rng.integers(0, 3, int(noise.sum()))
    states[:, round(share * width) :] = 2
    return states


def grid(states: NDArray[np.uint8]) -> OccupancyGrid:
    return OccupancyGrid.from_states(states, 0.05)


def with_thickness(vector_map: VectorMap, seed: int) -> VectorMap:
    """The same edges, each as thick as can be read, frontiers as well."""
    thickness = np.random.default_rng(seed).choice([0, 3, 4, 30, 31, 32, 255], len(vector_map)).astype(np.uint8)
    return VectorMap(vector_map.lattice, vector_map.edges, thickness)


def by_hand() -> Iterator[VectorMap]:
    """A room; with a door and the back of a wall; thicker, with one edge gone."""
    corners = [(0, 0), (0, 100), (80, 100), (80, 0)]
    walls = [(*a, *b, 1) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    room = np.array(walls, np.int32)
    yield VectorMap(EMPTY.lattice, room, np.full(4, 4, np.uint8))
    door = np.array([(0, 0, 0, 40, 1), (0, 40, 0, 59, 2), (0, 59, 0, 100, 1), (-2, 0, -2, 40, 5)], np.int32)
    changed = np.concatenate([room[1:], door])
    yield VectorMap(EMPTY.lattice, changed, np.array([4, 4, 4, 4, 0, 7, 0], np.uint8))
    yield VectorMap(EMPTY.lattice, changed[1:], np.array([9, 9, 9, 0, 9, 0], np.uint8))


def scattered() -> Iterator[VectorMap]:
    """Lines in nine places far from each other, all of them moved a little, two gone."""
    for shift in (0, 3):
        places = [(y, x) for y in (-9000, 0, 9000) for x in (-9000, 0, 9000)][2 * (shift > 0) :]
        rows = np.array([(y + shift, x, y + shift, x + 9, 1) for y, x in places], np.int32)
        yield VectorMap(EMPTY.lattice, rows, np.full(len(rows), 4, np.uint8))


def tangled() -> Iterator[VectorMap]:
    """No maps of anything: many edges at each vertex, walks that cross, and vertices where several end."""
    rng = np.random.default_rng(9)
    for count in (12, 40, 60, 25, 90):
        ends = rng.integers(-4, 5, (count, 4))
        ends = ends[(ends[:, :2] != ends[:, 2:]).any(axis=1)]
        rows = np.column_stack([ends, rng.choice([1, 2, 3, 5, 6, 7], len(ends))]).astype(np.int32)
        yield VectorMap(EMPTY.lattice, rows, rng.choice([0, 0, 4, 200], len(rows)).astype(np.uint8))


def explored(profile: str) -> Iterator[VectorMap]:
    """A map that grows, is corrected, and of which a part is seen no more."""
    vectorizer = Vectorizer(profile=profile)
    for share in (0.3, 0.5, 0.8, 1.0):
        yield vectorizer.update(grid(rooms(5, share=share)))
    for seed in (6, 7):
        states = rooms(5)
        flips = np.random.default_rng(seed).random(states.shape) < 0.01
        states[flips] = np.random.default_rng(seed).integers(0, 3, int(flips.sum()))
        yield vectorizer.update(grid(states))
    yield vectorizer.update(grid(rooms(5, share=0.6)))


def runs() -> Iterator[Iterator[VectorMap]]:
    """Maps, each a delta from the one before."""
    yield by_hand()
    yield scattered()
    yield tangled()
    yield explored("share")
    yield explored("full")
    yield iter([with_thickness(vectorize(grid(rooms(1))), seed) for seed in (1, 2)])
    yield iter([vectorize(grid(rooms(2, height=200, width=300)), specks=0)])


def folded(payload: bytes) -> str:
    """Hexadecimal, in lines."""
    text = payload.hex()
    return "\n".join(text[i : i + LINE] for i in range(0, len(text), LINE))


def main() -> None:
    """Write the files."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for mode in (0, 1):
        lines = [
            f"# Mode {mode}: payloads, each with the digest of the map after it. Each is a delta from the map before,",
            "# the first one behind a blank line from the empty map. The lattice is 50 mm, at the origin.",
        ]
        for run in runs():
            base = EMPTY
            lines.append("")
            for vector_map in run:
                payload = protocol.encode(diff(base, vector_map), base, mode=mode)
                lines += [folded(payload), f"= {vector_map.digest:016x}"]
                base = vector_map
        (FOLDER / f"mode{mode}.hex").write_text("\n".join(lines) + "\n")
    first, second = rooms(3, height=40, width=53), rooms(4, height=40, width=53)
    lines = [
        "# The exact layer: payloads, each with the SHA-256 of the states, row by row, one byte each.",
        "# The second one has the states of the first one as its base.",
        "",
        folded(encode_states(first)),
        f"= {hashlib.sha256(first.tobytes()).hexdigest()}",
        "",
        folded(encode_states(second, first)),
        f"= {hashlib.sha256(second.tobytes()).hexdigest()}",
    ]
    (FOLDER / "exact.hex").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
