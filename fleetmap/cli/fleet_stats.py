"""``fleetmap stats --fleet``: watch a fleet without being in it: what each robot says that it has sent."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rich.live import Live
from rich.table import Table

from fleetmap.accounting import BASELINES, Transport, compare
from fleetmap.accounting.wire import required_bandwidth_kbps
from fleetmap.cli.output import stderr
from fleetmap.codecs.messages import StatsMessage
from fleetmap.model.errors import LinkError
from fleetmap.peer.figures import DM2_A_M2, counts
from fleetmap.peer.watcher import Seen, Watcher

LOOK_S = 1.0
"""Between two questions to all robots."""
FIRST_LOOK_S = 0.2
"""While nobody has answered."""
SAY_NOBODY_S = 5.0


@dataclass(slots=True)
class Watched:
    """One robot over all looks."""

    last: Seen
    first: StatsMessage | None = None
    """Its first answer of this life."""
    life: int = 0
    figures: StatsMessage | None = None
    """Its latest answer."""

    def look(self, seen: Seen) -> None:
        """Take in what was seen now."""
        self.last = seen
        if seen.figures is not None:
            if self.first is None or self.life != seen.life or self.first.age_ms > seen.figures.age_ms:
                self.first, self.life = seen.figures, seen.life
            self.figures = seen.figures


@dataclass(slots=True)
class Watch:
    """All that was seen of a fleet."""

    fleet: str
    endpoint: str
    robots: dict[str, Watched] = field(default_factory=dict)

    @property
    def reached(self) -> int:
        """How many robots have answered."""
        return sum(watched.figures is not None for watched in self.robots.values())

    def look(self, seen: list[Seen]) -> None:
        """Take in a look; who is not in it is gone, and stays with its last figures."""
        for robot in self.robots.keys() - {s.robot for s in seen}:
            self.robots[robot].last = Seen(robot, False, None, None)
        for s in seen:
            known = self.robots.get(s.robot)
            if known is None:
                known = self.robots[s.robot] = Watched(s)
            if known.figures is None and s.figures is not None:
                stderr.print(f"reached {s.robot} by {s.endpoint or self.endpoint}", markup=False, highlight=False)
            known.look(s)


async def watch_fleet(
    fleet: str,
    *,
    connect: list[str],
    listen: list[str],
    profile: str,
    for_s: float | None,
    live: bool,
) -> dict[str, Any]:
    """Watch until the time is up or Ctrl-C; returns what was seen.

    Raises
    ------
    ConfigError : an option has an impossible value
    LinkError : no robot of that fleet was reached; or the transport could not be opened
    """
    began_s = time.monotonic()
    async with Watcher(fleet, profile=profile, connect=connect, listen=listen) as watcher:
        watch = Watch(fleet, watcher.endpoint)
        said = False
        with Live(console=stderr, auto_refresh=False) if live else stderr.status(f"watching {fleet}") as shown:
            try:
                while True:
                    watch.look(await watcher.look())
                    time_s = time.monotonic() - began_s
                    if isinstance(shown, Live):
                        shown.update(as_table(summarize(watch, watcher, time_s)), refresh=True)
                    if not watch.reached and not said and time_s >= SAY_NOBODY_S:
                        said = True
                        stderr.print(f"nobody yet: {await nobody(watch, watcher)}", markup=False, highlight=False)
                    if for_s is not None and time_s >= for_s:
                        break
                    pause_s = LOOK_S if watch.reached else FIRST_LOOK_S
                    await asyncio.sleep(pause_s if for_s is None else min(pause_s, max(0.0, for_s - time_s)))
            except asyncio.CancelledError:
                pass  # Ctrl-C: what was seen is what is wanted
        if not watch.reached:
            raise LinkError(endpoint=watcher.endpoint, reason=await nobody(watch, watcher))
        return summarize(watch, watcher, time.monotonic() - began_s)


async def nobody(watch: Watch, watcher: Watcher) -> str:
    """Why no robot of the fleet has answered, and what to do."""
    if watch.robots:
        return f"{', '.join(watch.robots)} lives, but has not answered: busy, or of a version before; watch longer"
    endpoints, fleets = await watcher.surroundings()
    if fleets:
        names = ", ".join(fleets)
        return f"no robot of fleet {watcher.fleet!r} there, but robots of {names}: name one of these with --fleet"
    if endpoints:
        return f"{', '.join(endpoints)} answers, but no robot of fleet {watcher.fleet!r} is linked to it"
    return (
        f"nobody answers, so that no robot of fleet {watcher.fleet!r} was reached: start one, or give with --connect "
        "an endpoint where one listens, as tcp/127.0.0.1:7447 (`fleetmap sim` prints its own)"
    )


def summarize(watch: Watch, watcher: Watcher, time_s: float) -> dict[str, Any]:
    """The document of `fleetmap stats --fleet NAME --json`."""
    return {
        "fleet": watch.fleet,
        "endpoint": watch.endpoint,
        "time_s": round(time_s, 2),
        "reached": watch.reached,
        "watcher": {
            "questions": watcher.questions.messages,
            "answers": watcher.answers.messages,
            "answer_bytes": watcher.answers.size_bytes,
        },
        "robots": [row(watched, watch.fleet) for _, watched in sorted(watch.robots.items())],
    }


def row(watched: Watched, fleet: str) -> dict[str, Any]:
    """One robot: what it has counted since it joined, to one receiver, and what this watch caused apart."""
    seen, figures = watched.last, watched.figures
    state = "alive" if seen.alive else "gone"
    head = {"robot": seen.robot, "alive": seen.alive, "state": state, "endpoint": seen.endpoint}
    if figures is None or watched.first is None:
        return {**head, "state": f"{state}, no answer"}
    sent, age_s = counts(figures.sent), figures.age_ms / 1000
    found = compare(sent, counts(figures.grids), age_s, Transport(seen.robot, fleet))
    area_m2 = figures.explored_dm2 / DM2_A_M2
    before = sum(size for _, size, _ in watched.first.sent.values())
    since_s = (figures.age_ms - watched.first.age_ms) / 1000
    return {
        **head,
        "age_s": round(age_s, 2),
        "links": figures.links,
        "edges": figures.edges,
        "explored_m2": area_m2,
        "kinds": {kind: {"messages": c.messages, "bytes": c.size_bytes} for kind, c in sorted(sent.items())},
        "bytes": found.vector,
        "wire_bytes": found.wire.total,
        "wire": found.wire._asdict(),
        "bytes_per_s": _per(found.vector, age_s),
        "wire_bytes_per_s": _per(found.wire.total, age_s),
        "bytes_per_m2": _per(found.vector, area_m2),
        "wire_bytes_per_m2": _per(found.wire.total, area_m2),
        "recent_bytes_per_s": _per(found.vector - before, since_s),
        "required_bandwidth_kbps": required_bandwidth_kbps(found.vector, age_s),
        **found.grids,
        **{f"wire_{name}": size for name, size in found.wire_grids.items()},
        "ratios": {name: found.ratio(name) for name in found.grids},
        "wire_ratios": {name: found.wire_ratio(name) for name in found.grids},
        "watchers": {"messages": figures.watched[0], "bytes": figures.watched[1]},
    }


def as_table(document: Mapping[str, Any]) -> Table:
    """One line a robot."""
    title = f"{document['fleet']}, {document['time_s']:.0f} s, {document['reached']} reached"
    asked = document["watcher"]
    caption = (
        "payload / on the wire (IP, estimated), to one receiver, since the robot joined; grids: times as many bytes. "
        f"This watcher asked {asked['questions']} times and was answered {asked['answer_bytes']:,} B: not in the table."
    )
    table = Table(title=title, caption=caption)
    for column in ("robot", "", "by", "edges", "messages", "bytes", "B/s", "B/m²", *NAMES.values()):
        table.add_column(column, justify="left" if column in ("robot", "", "by") else "right")
    for r in document["robots"]:
        head = (r["robot"], r["state"], r["endpoint"] or "")
        if "bytes" not in r:
            table.add_row(*head)
            continue
        ratios = [pair(r["ratios"].get(name), r["wire_ratios"].get(name), ".1f") for name in NAMES]
        table.add_row(
            *head,
            f"{r['edges']:,}",
            f"{sum(kind['messages'] for kind in r['kinds'].values()):,}",
            pair(r["bytes"], r["wire_bytes"], ",d"),
            pair(r["bytes_per_s"], r["wire_bytes_per_s"], ".1f"),
            pair(r["bytes_per_m2"], r["wire_bytes_per_m2"], ".1f"),
            *ratios,
        )
    return table


NAMES = dict(zip(BASELINES, ("whole grids", "rectangles", "differences"), strict=True))


def pair(payload: float | None, wire: float | None, form: str) -> str:
    """Payload and wire in one cell."""
    return "" if payload is None or wire is None else f"{payload:{form}} / {wire:{form}}"


def _per(size_bytes: int, of: float) -> float | None:
    return round(size_bytes / of, 2) if of > 0 else None
