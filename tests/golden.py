"""Write what every later reader must read: tests/data/v1, payloads of the format, and v2, messages of the protocol.

    python tests/golden.py

Once robots are under way, files are only added here, and none is written anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fleetmap.codecs import messages as msg
from fleetmap.codecs import protocol
from fleetmap.codecs.context_grid import encode_states
from fleetmap.codecs.envelope import encode
from fleetmap.codecs.facts import FactsStep, forget, set_anchor, set_level, set_start, supersede
from fleetmap.engine import Chain, Stream
from fleetmap.engine.author import Author
from fleetmap.engine.log import snapshot_messages
from fleetmap.model.delta import diff
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap
from fleetmap.vectorize import Vectorizer, vectorize

FOLDER = Path(__file__).parent / "data"
EMPTY = VectorMap.empty(Lattice(50_000))
LINE = 118


def read_golden(name: str, version: str = "v1") -> list[list[tuple[bytes, str]]]:
    """The runs of a file: payloads, each with what comes out, mostly its digest."""
    _, *blocks = (FOLDER / version / f"{name}.hex").read_text().split("\n\n")
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


ROBOT, SEED = "r7", bytes(range(16))
OTHERS: list[tuple[msg.Message, object]] = [
    (msg.Heartbeat(7, 2**63 + 1), [7, 2**63 + 1, 0]),
    (msg.Want("r8", msg.Revision(2**64 - 1, 0, 0)), ["r8", 2**64 - 1, 0, 0]),
    (msg.Want("r8", msg.Revision(255, 3, 2**63), (9, 2**62, 4)), ["r8", 255, 3, 2**63, 9, 2**62, 4]),
    (
        msg.RevisionList((("r7", msg.Revision(255, 3, 2**63)), ("r8", msg.Revision(1, 1, 0)))),
        [[["r7", 255, 3, 2**63], ["r8", 1, 1, 0]]],
    ),
    (
        msg.Heartbeat(7, 9, 2**32 - 1, (-1500, 10**9, -3142), (-1, 70_000)),
        [7, 9, 2**32 - 1, [-1500, 10**9, -3142], [-1, 70_000]],
    ),
    (msg.Heartbeat(7, 9, 1, None, (0, 0)), [7, 9, 1, None, [0, 0]]),
    (msg.Ranges((msg.Range(3, 3, 5), msg.Range(5, 9, rows=()))), [[[5, 3, 3], [[], 5, 9]]]),
    (
        msg.Ranges((msg.Range(0, 2**63, 5), msg.Range(2**63 + 1, 2**64 - 1, rows=(("r7", msg.Revision(255, 3, 4)),)))),
        [[[5, 2**63], [[["r7", 255, 3, 4]], 2**64 - 1]]],
    ),
    (msg.Living((("r7", 255), ("r8", 1))), [[["r7", 255], ["r8", 1]]]),
    (msg.Relay("r8", 2**64 - 1), ["r8", 2**64 - 1]),
    (
        msg.StatsMessage(12_000, 2, 68, 5592, (4, 600, 4), {"delta": (10, 655, 10)}, {"grid_gzip_full": (1, 900, 1)}),
        [12_000, 2, 68, 5592, [4, 600, 4], {"delta": [10, 655, 10]}, {"grid_gzip_full": [1, 900, 1]}, []],
    ),
]
"""The messages that carry no change, each with its fields."""


def revisions() -> Iterator[tuple[bytes, Stream]]:
    """All that an author says: records, each with the stream after it."""
    author = Author(ROBOT, Chain(SEED, revisions=300))
    first, second, _ = by_hand()
    start, anchor = FixedPose.from_pose(Pose2(3.0, -2.5, 0.75)), FixedPose.from_pose(Pose2(0.25, 0.0, -1.0))
    lattice = Lattice(20_000, FixedPose.from_pose(Pose2(-1.0, 0.5, 0.1)))
    other = VectorMap(lattice, first.edges, first.thickness, 1.0, "full")
    steps: list[tuple[FactsStep, dict[str, VectorMap]]] = [
        ({**set_level("upper.2"), **set_start(start)}, {}),
        ({}, {"0": first}),
        ({}, {"0": second}),
        (set_anchor("s", anchor), {"s": other}),
        ({bytes([200]) + b"new": b"of a later version"}, {"0": first, "s": VectorMap.empty(lattice)}),
        ({**supersede({255: (3, 2**63)}), **forget({("r8", 1): (1, 2**64 - 1)}), bytes([4]) + bytes(8): b""}, {}),
        ({**set_start(None), **set_level("0")}, {}),
        ({}, {}),
    ]
    submaps: dict[str, VectorMap] = {}
    for facts, changed in steps:
        submaps |= changed
        said = author.commit(facts=facts, submaps=dict(submaps), even_if_nothing=True)
        assert said is not None
        yield said[0], author.stream


def messages() -> Iterator[str]:
    """The lines of v2/messages.hex."""
    yield "# Messages. First the records of robot r7 in one life, each with seq, link and the digest of the stream;"
    yield "# then a snapshot of the last of these, with the same; then those of each other kind, with their fields."
    yield ""
    for record, stream in revisions():
        yield folded(record)
        yield f"= {stream.seq} {stream.link:016x} {stream.digest:016x}"
    yield ""
    for chunk in snapshot_messages(stream):
        yield folded(chunk)
        yield f"= {stream.seq} {stream.link:016x} {stream.digest:016x}"
    yield ""
    for message, fields in OTHERS:
        yield folded(encode(message))
        yield f"= {json.dumps(fields)}"


def folded(payload: bytes) -> str:
    """Hexadecimal, in lines."""
    text = payload.hex()
    return "\n".join(text[i : i + LINE] for i in range(0, len(text), LINE))


def main() -> None:
    """Write the files."""
    for version in ("v1", "v2"):
        (FOLDER / version).mkdir(parents=True, exist_ok=True)
    (FOLDER / "v2" / "messages.hex").write_text("\n".join(messages()) + "\n")
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
        (FOLDER / "v1" / f"mode{mode}.hex").write_text("\n".join(lines) + "\n")
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
    (FOLDER / "v1" / "exact.hex").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
