"""Whether a robot's name is taken: not by a token, which anybody can show, but by somebody who answers."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterable

from fleetmap.codecs.envelope import decode
from fleetmap.codecs.messages import StatsMessage
from fleetmap.model.errors import WireError
from fleetmap.peer.link import Link, Token

ANSWER_S = 1.5
"""A living peer answers this question from its link's thread, however busy it is."""


async def answers(link: Link, tokens: Iterable[Token]) -> bool:
    """Whether any of these peers answers within ``ANSWER_S``."""
    loop = asyncio.get_running_loop()
    found, waiting = asyncio.Event(), 0
    ended = asyncio.Event()

    def later(call: object) -> None:
        # The answer may come after the timeout, and after the loop.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(call)  # type: ignore[arg-type]

    def reply(payload: bytes) -> None:
        with contextlib.suppress(WireError):
            if isinstance(decode(payload, robot="?"), StatsMessage):
                later(found.set)

    def end() -> None:
        nonlocal waiting
        waiting -= 1
        if waiting == 0:
            ended.set()

    for token in tokens:
        waiting += 1
        link.ask(token, "stats", b"", on_reply=reply, on_end=lambda: later(end))
    if waiting == 0:
        return False
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(ANSWER_S):
            tasks = {asyncio.ensure_future(event.wait()) for event in (found, ended)}
            try:
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in tasks:
                    task.cancel()
    return found.is_set()
