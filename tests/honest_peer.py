"""One honest robot as a process of its own: ``attacks.Fleet`` starts it, and talks to it by lines of JSON.

Each line in is ``{"id": ..., "do": NAME, ...}``, each line out ``{"id": ..., ...}``. Its map is a row of square rooms,
and one more that stands elsewhere after each change: whoever holds its map sees by that which change it is.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import time

import numpy as np

import fleetmap
from fleetmap.align.align import align_walls
from fleetmap.align.walls import walls_of
from fleetmap.engine.view import View, view
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import Pose2
from fleetmap.model.vectormap import VectorMap
from fleetmap.peer import Peer

PITCH, SIDE = 40, 20
"""Cells from room to room, and along a wall."""
LOOK_AGAIN_S = 0.1


def rooms(count: int, change: int, row: int) -> VectorMap:
    """``count`` rooms in a row of the fleet's, and one left of them whose place says which change it is."""
    places = [*range(0, PITCH * count, PITCH), -PITCH * (1 + change)]
    rows = []
    for x in places:
        y = PITCH * row
        corners = [(y, x), (y, x + SIDE), (y + SIDE, x + SIDE), (y + SIDE, x)]
        rows += [(*a, *b, 1) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    return VectorMap(Lattice(50_000), np.array(rows, np.int32), np.full(len(rows), 4, np.uint8))


def change_of(held: VectorMap) -> int:
    """Which change of its author a map is; -1 if it is none."""
    x = held.edges[:, [1, 3]]
    return -int(x.min()) // PITCH - 1 if len(x) else -1


class HonestPeer:
    """Does what the lines say; notes at which instant each change of each other robot was held first.

    Robots are told apart by life: who borrows a name is somebody else.
    """

    def __init__(self, peer: Peer, *, count: int, row: int) -> None:
        self.peer, self.count, self.row = peer, count, row
        self.held_s: dict[tuple[str, int], dict[int, float]] = {}

    async def publish(self, change: int) -> dict[str, object]:
        vector_map = rooms(self.count, change, self.row)
        began_s = time.monotonic()
        await self.peer.publish(vector_map)
        return {"began_s": began_s, "took_s": time.monotonic() - began_s, "map": f"{vector_map.digest:016x}"}

    async def digest(self) -> dict[str, object]:
        return {"digest": f"{(await self.peer.refresh()).digest}"}

    async def synced(self, timeout_s: float, at_least: int) -> dict[str, object]:
        try:
            digest = str((await self.peer.synced(timeout_s, at_least=at_least)).digest)
        except TimeoutError as error:
            return {"missing": str(error)}
        return {"digest": digest, **await self.maps()}

    async def maps(self) -> dict[str, object]:
        """What would be merged now, by robot and life; the own map, too."""
        found: View = await self.peer._read(lambda: view(self.peer._engine))
        return {"maps": {f"{s.frame[0]}/{s.frame[1]:016x}": f"{s.vector_map.digest:016x}" for s in found.sources}}

    async def kept(self) -> dict[str, object]:
        """By robot, the digests of the maps of all its lives that are merged here."""
        found: dict[str, list[str]] = {}
        for stream in self.peer._engine.merged_streams():
            found.setdefault(stream.robot, []).extend(f"{m.digest:016x}" for m in stream.submaps.values())
        return {"kept": found}

    async def alive(self) -> dict[str, object]:
        return {"alive": [known.robot for known in self.peer.peers if known.alive]}

    async def dropped(self) -> dict[str, object]:
        return {"dropped": {" ".join(what): count.messages for what, count in self.peer.stats().dropped.items()}}

    async def held(self, robot: str, life: str, change: int, timeout_s: float) -> dict[str, object]:
        """Wait until a change of a robot, or a later one, is held; since when each of them is."""
        key = (robot, int(life, 16))
        async with asyncio.timeout(timeout_s), self.peer.stepped:
            await self.peer.stepped.wait_for(lambda: self._held(key) >= change)
        return {"held_s": self.held_s[key]}

    async def step(self) -> dict[str, object]:
        """Wait until the engine does something; not for long, for what is waited for may be there already."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LOOK_AGAIN_S), self.peer.stepped:
                await self.peer.stepped.wait()
        return {}

    async def watch(self) -> None:
        while True:
            async with self.peer.stepped:
                await self.peer.stepped.wait()
            for key in list(self.held_s):
                self._held(key)

    def _held(self, key: tuple[str, int]) -> int:
        now_s, known = time.monotonic(), self.held_s.setdefault(key, {})
        held = self.peer._engine.holdings.held(key).submaps.get("0")
        change = -1 if held is None else change_of(held)
        known.setdefault(change, now_s)
        return change


def load_all() -> None:
    """What a robot loads once it has something to align: not to be counted as what an attack has made it grow by."""
    seen = walls_of(rooms(3, 1, 0))
    align_walls(seen, seen)


async def main(robot: str, options: dict[str, object]) -> None:
    loop = asyncio.get_running_loop()
    count, row = int(options.pop("count")), int(options.pop("row"))  # type: ignore[call-overload]
    load_all()
    async with fleetmap.join(robot, start=Pose2(), **options) as peer:  # type: ignore[arg-type]
        honest = HonestPeer(peer, count=count, row=row)
        watching = asyncio.create_task(honest.watch())
        print(json.dumps({"id": 0, "life": f"{peer.life:016x}"}), flush=True)  # noqa: T201 - this is how it talks
        while line := await loop.run_in_executor(None, sys.stdin.readline):
            asked = json.loads(line)
            number, what = asked.pop("id"), asked.pop("do")
            try:
                answer = await getattr(honest, what)(**asked)
            except (fleetmap.FleetmapError, TimeoutError) as error:
                answer = {"error": f"{type(error).__name__}: {error}"}
            print(json.dumps({"id": number, **answer}), flush=True)  # noqa: T201 - idem
        watching.cancel()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], json.loads(sys.argv[2])))
