"""Where a simulated fleet meets: one Zenoh session of the parent that every robot connects to."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator

from fleetmap.model.errors import LinkError
from fleetmap.peer.profiles import as_json5, zenoh_settings

PORT = 7447
"""Zenoh's own default: whoever wants to join the simulated fleet finds it there, if it was free."""


@contextlib.asynccontextmanager
async def rendezvous() -> AsyncIterator[str]:
    """Open the session; yields its endpoint.

    Raises
    ------
    LinkError : Zenoh could not listen
    """
    import zenoh

    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = zenoh.Config()
    for key, value in zenoh_settings("local", listen=[endpoint], connect=[], config=None).items():
        config.insert_json5(key, as_json5(value))
    try:
        session = await asyncio.to_thread(zenoh.open, config)
    except zenoh.ZError as error:
        raise LinkError(endpoint=endpoint, reason=str(error)) from None
    try:
        yield endpoint
    finally:
        await asyncio.to_thread(session.close)


def free_port() -> int:
    """``PORT``, or any other one where something listens there already."""
    for port in (PORT, 0):
        with socket.socket() as probe:
            # A port whose last connections are still in TIME_WAIT is free to listen on.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise LinkError(endpoint="tcp/127.0.0.1:0", reason="no free port")
