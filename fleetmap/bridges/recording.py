"""``recording``: join a fleet, and write what it says into a file until the block ends."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from fleetmap.bridges.mcap_file import McapFile
from fleetmap.bridges.recorder import Recorder
from fleetmap.model.errors import FleetmapError
from fleetmap.model.pose import Pose2
from fleetmap.peer.join import make_peer
from fleetmap.peer.options import JoinOptions
from fleetmap.peer.watcher import Watcher

FOLD_S = 1.0
"""At most so often a merged map is written."""
SETTLE_S = 2.0
"""At the end, what robots have said already is waited for so long."""


@asynccontextmanager
async def recording(
    out: Path,
    *,
    robot: str = "",
    fleet: str,
    level: str = "0",
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    profile: str = "lan",
    config: Mapping[str, object] | None = None,
) -> AsyncIterator[Recorder]:
    """A recorder at work. At the end it waits for what was said already, writes that, and closes the file.

    A file into which no record came is removed.

    Parameters
    ----------
    out : the file
    robot : the recorder's name in the fleet; empty: one that nobody has
    others : as ``join``

    Raises
    ------
    ConfigError : an option has an impossible value, or ``fleetmap[ros]`` is not installed
    NameInUse, LinkError : on joining
    OSError : the file can't be written
    """
    options = JoinOptions(
        robot or f"recorder-{secrets.token_hex(3)}",
        fleet=fleet,
        level=level,
        # In the fleet's own frame, so that it is in one component with those whose starts are known.
        start=Pose2(),
        connect=connect,
        listen=listen,
        profile=profile,
        config=config,
        fold_interval_s=FOLD_S,
    )
    # The peer is there to connect to first: the watcher takes no port.
    watched = Watcher(fleet, profile=profile, connect=connect, config=config)
    recorder = None
    try:
        with McapFile(out) as file:
            async with make_peer(options) as peer, watched as watcher:
                recorder = Recorder(peer, watcher, file)
                running = asyncio.create_task(recorder.run())
                try:
                    yield recorder
                    with suppress(TimeoutError):
                        await peer.synced(SETTLE_S)
                finally:
                    running.cancel()
                    with suppress(asyncio.CancelledError):
                        await running
                    if recorder.failure is not None:
                        raise recorder.failure
                    with suppress(FleetmapError):
                        await recorder.finish()
    finally:
        if recorder is None or not recorder.records:
            await asyncio.to_thread(out.unlink, missing_ok=True)  # a file with nothing in it helps nobody
