"""The estimator's framing, beside what two real sessions say to each other through a proxy that looks on."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator

import pytest

from fleetmap.accounting import Count, wire_bytes
from fleetmap.accounting.wire import BATCH_BYTES, KEEP_ALIVE_BYTES
from fleetmap.engine import Alive, Input, Message, Query
from fleetmap.peer.zenoh_link import ZenohLink

LIFE = 2**63 + 1
PAYLOAD = b"a payload that nothing else looks like."
SHORTER = 3
"""A frame's number starts at random and takes 3 bytes once in 128 times; a session's id is as seldom a byte shorter."""


class Ears:
    """Takes all, and answers each question with ``PAYLOAD``."""

    def __init__(self) -> None:
        self.heard: asyncio.Queue[str] = asyncio.Queue()
        self._loop = asyncio.get_running_loop()

    def deliver(self, item: Input) -> None:
        """Take a sample or a token, or answer."""
        match item:
            case Message():
                self._loop.call_soon_threadsafe(self.heard.put_nowait, item.kind)
            case Alive():
                self._loop.call_soon_threadsafe(self.heard.put_nowait, "alive")
            case Query():
                item.reply([PAYLOAD])


class Proxy:
    """Hands on what two sessions say, batch by batch."""

    def __init__(self) -> None:
        self.batches: list[tuple[str, bytes]] = []
        self.more = asyncio.Event()

    @contextlib.asynccontextmanager
    async def between(self, here: int, there: int) -> AsyncIterator[None]:
        """Listen on one port and hand on to the other."""
        tasks = []

        async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            on_reader, on_writer = await asyncio.open_connection("127.0.0.1", there)
            for way in (("to first", reader, on_writer), ("from first", on_reader, writer)):
                tasks.append(asyncio.ensure_future(self.hand_on(*way)))

        server = await asyncio.start_server(take, "127.0.0.1", here)
        try:
            yield
        finally:
            server.close()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def hand_on(self, way: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One direction, until it ends."""
        try:
            while True:
                length = await reader.readexactly(2)
                batch = length + await reader.readexactly(int.from_bytes(length, "little"))
                self.batches.append((way, batch))
                self.more.set()
                writer.write(batch)
        except (asyncio.IncompleteReadError, ConnectionError):
            writer.close()

    def with_payload(self) -> bytes:
        """The one batch that carries ``PAYLOAD``."""
        (batch,) = (batch for _, batch in self.batches if PAYLOAD in batch)
        return batch


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def estimate(kind: str) -> int:
    count = Count()
    count.add(len(PAYLOAD))
    found = wire_bytes({kind: count}, 0.0)
    return found.payload + found.zenoh


async def test_each_kind_is_framed_as_zenoh_frames_it(timeout_factor):
    there, here, proxy = free_port(), free_port(), Proxy()
    first = ZenohLink("r0", fleet="sim", profile="local", listen=[f"tcp/127.0.0.1:{there}"])
    config = {"scouting/gossip/enabled": False}  # else the second would find the first without the proxy
    second = ZenohLink("r1", fleet="sim", profile="local", connect=[f"tcp/127.0.0.1:{here}"], config=config)
    ears, others = Ears(), Ears()
    async with asyncio.timeout(30 * timeout_factor), proxy.between(here, there):
        try:
            await first.open(others)
            await second.open(ears)
            await first.show(LIFE)
            while await ears.heard.get() != "alive":
                pass
            for kind in ("digest", "delta"):
                proxy.batches.clear()
                first.put(LIFE, kind, PAYLOAD)
                assert await ears.heard.get() == kind
                expected = estimate(kind)
                assert expected - SHORTER <= len(proxy.with_payload()) <= expected, kind
            proxy.batches.clear()
            asked = asyncio.get_running_loop().create_future()
            loop = asyncio.get_running_loop()
            second.ask(
                ("r0", LIFE),
                "revisions",
                b"",
                on_reply=lambda payload: None,
                on_end=lambda: loop.call_soon_threadsafe(asked.set_result, None),
            )
            await asked
            said = [(way, len(batch)) for way, batch in proxy.batches if len(batch) > KEEP_ALIVE_BYTES]
            question, answer = (sum(n for way, n in said if way == which) for which in ("to first", "from first"))
            assert question == pytest.approx(wire_bytes({"want": Count(1, 0, 1)}, 0.0).zenoh, abs=SHORTER)
            # The end of the answers goes in the same batch, or in one of its own.
            assert answer == pytest.approx(estimate("list"), abs=SHORTER + BATCH_BYTES)
        finally:
            await second.close()
            await first.close()
