"""Where a simulated fleet meets: one Zenoh session of the parent that every robot connects to."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass

from fleetmap.model.errors import ConfigError, LinkError
from fleetmap.peer.endings import enter_zenoh
from fleetmap.peer.ports import free_port, is_free
from fleetmap.peer.profiles import zenoh_settings
from fleetmap.peer.settings import as_json5

PORT = 7447
"""Zenoh's own default: whoever wants to join the simulated fleet finds it there, if it was free."""

LOOPBACK = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]"}
"""What listens everywhere is reached from the same machine here."""


TAKEN = (
    "something listens there already, perhaps another simulated fleet; expected a free endpoint: "
    "--listen tcp/127.0.0.1:0 takes any free port"
)


@dataclass(frozen=True, slots=True)
class Meeting:
    """Where a fleet meets.

    Parameters
    ----------
    endpoint : where it listens, for others to connect to
    connect : the same, as the robots of this machine reach it
    robots_listen : where they listen themselves: peers don't relay, so that guests must reach each of them
    usual : whether it is the usual place, which one run at a time can have
    """

    endpoint: str
    connect: str
    robots_listen: str
    usual: bool


@contextlib.asynccontextmanager
async def rendezvous(listen: str | None = None) -> AsyncIterator[Meeting]:
    """Open the session where one is told to; port 0 is any free one. None: ``PORT`` on loopback, or a free one there.

    Raises
    ------
    ConfigError : ``listen`` is no endpoint of TCP
    LinkError : Zenoh could not listen, as something else does
    """
    import zenoh

    enter_zenoh(listen or "tcp/127.0.0.1")
    host, port = ("127.0.0.1", PORT) if listen is None else parse_endpoint(listen)
    session = None
    while session is None:
        port = port or free_port(host)
        endpoint = f"tcp/{host}:{port}"
        config = zenoh.Config()
        for key, value in zenoh_settings("local", listen=[endpoint], connect=[], config=None).items():
            config.insert_json5(key, as_json5(value))
        try:
            session = await asyncio.to_thread(zenoh.open, config)
        except zenoh.ZError as error:
            if listen is not None or port != PORT:
                reason = str(error) if is_free(host, port) else TAKEN
                raise LinkError(endpoint=endpoint, reason=reason) from None
            port = 0
    try:
        yield Meeting(endpoint, f"tcp/{LOOPBACK.get(host, host)}:{port}", f"tcp/{host}:0", port == PORT)
    finally:
        await asyncio.to_thread(session.close)


def parse_endpoint(endpoint: str) -> tuple[str, int]:
    """Host and port of ``tcp/HOST:PORT``.

    Raises
    ------
    ConfigError : it is none
    """
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol != "tcp" or not host or not (port.isascii() and port.isdigit()) or int(port) > 65535:
        raise ConfigError(option="listen", value=endpoint, reason="expected tcp/HOST:PORT, as tcp/127.0.0.1:7447")
    return host, int(port)
