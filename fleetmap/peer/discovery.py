"""Which epoch a robot that joins goes on with: one more than the highest that any peer holds of its name."""

from __future__ import annotations

import asyncio
import contextlib

from fleetmap.codecs.envelope import decode
from fleetmap.codecs.messages import CLAIMED_EPOCHS, RevisionList
from fleetmap.model.errors import WireError
from fleetmap.peer.link import Link


async def find_epoch(link: Link, robot: str, *, timeout_s: float) -> int:
    """Ask all peers for their revisions; 1 if none of them knows the name.

    A peer that can't be reached now may know of an earlier life. The engine finds out later, and goes on under
    a higher epoch then.
    """
    loop = asyncio.get_running_loop()
    ended = asyncio.Event()
    replies: list[bytes] = []

    def end() -> None:
        # The answer may come after the timeout, and after the loop.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(ended.set)

    link.ask(
        "*",
        "revisions",
        b"",
        on_reply=replies.append,
        on_end=end,
    )
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(timeout_s):
            await ended.wait()
    epochs = [0]
    for payload in replies[:]:
        try:
            message = decode(payload, robot="?")
        except WireError:
            continue
        if isinstance(message, RevisionList):
            claimed = [revision.epoch for name, revision in message.revisions if name == robot]
            epochs += [epoch for epoch in claimed if epoch < CLAIMED_EPOCHS]
    return 1 + max(epochs)
