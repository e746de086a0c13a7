"""``fleetmap stats --fleet``: join a fleet, and watch what each robot sends and what grids would have cost."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from dataclasses import dataclass, field
from typing import Any

from rich.live import Live
from rich.table import Table

from fleetmap.accounting import Stats
from fleetmap.accounting.wire import estimate_wire_bytes, required_bandwidth_kbps
from fleetmap.cli.output import stderr
from fleetmap.model.errors import MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.vectormap import VectorMap
from fleetmap.peer import Peer, join

SHOW_S = 0.5
"""How often the table is drawn anew."""


@dataclass(slots=True)
class Grids:
    """What one robot's maps would have cost as grids, each time they were seen to have changed."""

    seen: dict[str, int] = field(default_factory=dict)
    """Digest of each submap as it was looked at last."""
    last: dict[str, OccupancyGrid] = field(default_factory=dict)
    changes: int = 0
    gzip_full: int = 0
    gzip_updates: int = 0
    exact_updates: int = 0
    undrawn: int = 0
    """Maps that are too large for a grid."""

    def look(self, maps: dict[str, VectorMap]) -> None:
        """Draw what has changed, and count it."""
        from fleetmap.codecs.baselines import exact_changed_rectangle, gzip_changed_rectangle, gzip_grid
        from fleetmap.vectorize import rasterize

        for name, vector_map in maps.items():
            if self.seen.get(name) == vector_map.digest or len(vector_map) == 0:
                continue
            self.seen[name] = vector_map.digest
            try:
                grid, before = rasterize(vector_map), self.last.get(name)
            except MapFormatError:  # who sends a map that no grid can hold is not to end the watch
                self.undrawn += 1
                continue
            self.last[name] = grid
            self.changes += 1
            self.gzip_full += gzip_grid(grid)
            self.gzip_updates += gzip_changed_rectangle(before, grid)
            self.exact_updates += exact_changed_rectangle(before, grid)


async def watch_fleet(
    fleet: str,
    *,
    connect: list[str],
    listen: list[str],
    profile: str,
    for_s: float | None,
    live: bool,
) -> dict[str, Any]:
    """Watch until the time is up or Ctrl-C; returns what was seen. The first map of a robot counts as one update.

    Raises
    ------
    ConfigError, LinkError : see ``fleetmap.join``
    """
    name = f"stats-{secrets.token_hex(3)}"
    grids: dict[str, Grids] = {}
    started_s = time.monotonic()
    document: dict[str, Any] = {}
    async with join(name, fleet=fleet, connect=connect, listen=listen, profile=profile, baselines=False) as peer:
        with Live(console=stderr, auto_refresh=False) if live else stderr.status(f"watching {fleet}") as shown:
            try:
                while for_s is None or document.get("time_s", 0.0) < for_s:
                    for robot, maps in peer.maps.items():
                        await asyncio.to_thread(grids.setdefault(robot, Grids()).look, maps)
                    time_s = time.monotonic() - started_s
                    if time_s - document.get("time_s", -SHOW_S) >= SHOW_S:
                        document = summarize(fleet, peer, grids, time_s)
                        if isinstance(shown, Live):
                            shown.update(as_table(document), refresh=True)
                    # At each step of the engine: of maps that follow each other faster than they are drawn, the last.
                    with contextlib.suppress(TimeoutError):
                        async with asyncio.timeout(SHOW_S), peer.stepped:
                            await peer.stepped.wait()
            except asyncio.CancelledError:
                pass  # Ctrl-C: what was seen is what is wanted
        return summarize(fleet, peer, grids, time.monotonic() - started_s)


def summarize(fleet: str, peer: Peer, grids: dict[str, Grids], time_s: float) -> dict[str, Any]:
    """The document of `fleetmap stats --fleet NAME --json`."""
    stats = peer.stats()
    robots = []
    for info in peer.peers:
        if info.robot.startswith("stats-"):
            continue  # another one that watches
        kinds = received(stats, info.robot)
        size_bytes = sum(size for _, size in kinds.values())
        grid = grids.get(info.robot, Grids())
        would = {
            "grid_gzip_full": grid.gzip_full,
            "grid_gzip_updates": grid.gzip_updates,
            "grid_exact_updates": grid.exact_updates,
        }
        robots.append(
            {
                "robot": info.robot,
                "alive": info.alive,
                "edges": info.edges,
                "kinds": {kind: {"messages": n, "bytes": size} for kind, (n, size) in sorted(kinds.items())},
                "bytes": size_bytes,
                "wire_bytes": sum(estimate_wire_bytes(n, size) for n, size in kinds.values()),
                "required_bandwidth_kbps": required_bandwidth_kbps(size_bytes, time_s),
                "changes": grid.changes,
                "undrawn": grid.undrawn,
                **would,
                "ratios": {key: value / size_bytes if size_bytes else None for key, value in would.items()},
            }
        )
    return {"fleet": fleet, "time_s": round(time_s, 2), "robots": robots}


def received(stats: Stats, robot: str) -> dict[str, tuple[int, int]]:
    """By kind, the messages from a robot and their payload bytes."""
    return {kind: (c.messages, c.size_bytes) for (who, kind), c in stats.received.items() if who == robot}


def as_table(document: dict[str, Any]) -> Table:
    """One line a robot."""
    table = Table(title=f"{document['fleet']}, {document['time_s']:.0f} s")
    columns = ("robot", "", "edges", "messages", "bytes", "wire (est.)", "kbps")
    for column in (*columns, "whole grids", "rectangles", "differences"):
        table.add_column(column, justify="left" if column in ("robot", "") else "right")
    for row in document["robots"]:
        ratios = [
            "" if not row[key] else f"{row[key]:,} ({row['ratios'][key]:.1f} x)" if row["ratios"][key] else ""
            for key in ("grid_gzip_full", "grid_gzip_updates", "grid_exact_updates")
        ]
        kbps = row["required_bandwidth_kbps"]
        table.add_row(
            row["robot"],
            "alive" if row["alive"] else "absent",
            f"{row['edges']:,}",
            f"{sum(kind['messages'] for kind in row['kinds'].values()):,}",
            f"{row['bytes']:,}",
            f"{row['wire_bytes']:,}",
            "" if kbps is None else f"{kbps:.2f}",
            *ratios,
        )
    return table
