"""What the estimator of ``fleetmap.accounting.wire`` says of a link between two robots, beside the kernel's counters.

Two peers, each with a Zenoh session of its own, in a network namespace that nothing else uses, over a loopback of
Ethernet's 1500 bytes. One publishes a map each 0.1, 1, 5 or 30 seconds, or nothing; or both each 2.5 s, a pose with
each map. Heartbeats and keep-alives of both go on beside it. Counted are IP bytes, both ways, from the kernel's
counters of that namespace (/proc/net/netstat and snmp: octets, and for what a network card would cut into segments the
headers of each), while the link is up: what is said once when it opens stands apart. In a second table one side puts
payloads of the sizes that grids have.

- payload: what both handed to the link; estimate: ``wire_bytes`` of both; kernel: what was counted
- off: (estimate - kernel) / kernel

    python benchmarks/wire.py [--for-s 60] [--json]

Needs Linux and the right to make a namespace (``unshare --user --net``); says so where it has none.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from namespaces import counted_bytes, in_a_namespace

import fleetmap
from fleetmap.accounting import Count, wire_bytes
from fleetmap.accounting.ledger import Stats
from fleetmap.engine import Input, Query
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import Pose2
from fleetmap.model.vectormap import VectorMap
from fleetmap.peer.zenoh_link import ZenohLink

LIFE = 2**63 + 1
ENDPOINT = "tcp/127.0.0.1:7447"
PERIODS_S = (None, 0.1, 1.0, 5.0, 30.0)
"""Between two publishes; None: none."""
BOTH_S = 2.5
"""As two robots on their way do, with a pose each time."""
PAYLOADS = (200, 1000, 2000, 8000, 40_000)
PUTS = 20
PUT_EVERY_S = 0.3


def room(size: int) -> VectorMap:
    """A square of so many cells."""
    corners = [(0, 0), (0, size), (size, size), (size, 0)]
    rows = [(*a, *b, 1) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    return VectorMap(Lattice(50_000), np.array(rows, np.int32), np.full(4, 4, np.uint8))


def between(before: Stats, after: Stats) -> dict[str, Count]:
    """What was sent between two looks."""
    kinds = {}
    for kind, count in after.sent.items():
        was = before.sent.get(kind, Count())
        kinds[kind] = Count(
            count.messages - was.messages, count.size_bytes - was.size_bytes, count.segments - was.segments
        )
    return kinds


async def publishing(period_s: float | None, for_s: float, *, both: bool = False) -> dict[str, object]:
    """Two peers, one of which publishes; or both, a pose with each map."""
    common = {"fleet": "sim", "start": Pose2(), "profile": "local"}
    opening = counted_bytes()
    async with (
        fleetmap.join("r0", listen=[ENDPOINT], **common) as a,
        fleetmap.join("r1", connect=[ENDPOINT], **common) as b,
    ):
        await a.publish(room(50))
        await b.synced(30.0, at_least=1)
        await a.synced(30.0, at_least=1)
        opening = counted_bytes() - opening
        await asyncio.sleep(1.0)
        began_s, kernel, before = time.monotonic(), counted_bytes(), (a.stats(), b.stats())
        speakers = 0 if period_s is None else 2 if both else 1
        publishes = 0
        while (now_s := time.monotonic() - began_s) < for_s:
            # From half a period on, and two speakers in turn: the window holds as many as its length is periods.
            due_s = for_s if period_s is None else min(for_s, (publishes + 0.5) * period_s / speakers)
            if now_s < due_s:
                await asyncio.sleep(due_s - now_s)
                continue
            speaker = (a, b)[publishes % speakers]
            await speaker.publish(room(60 + publishes % 7))
            if both:
                await speaker.set_pose(Pose2(0.1 * publishes, 1.0, 0.0))
            publishes += 1
        kernel, time_s = counted_bytes() - kernel, time.monotonic() - began_s
        sent = [between(then, peer.stats()) for then, peer in zip(before, (a, b), strict=True)]
    shares = [wire_bytes(kinds, time_s) for kinds in sent]
    what = "nothing" if period_s is None else f"each {period_s:g} s" + (", both" if both else "")
    payload, estimate = sum(s.payload for s in shares), sum(s.total for s in shares)
    return {**row(what, publishes, time_s, payload, estimate, kernel), "opening": opening}


class Deaf:
    """A receiver that wants nothing."""

    def deliver(self, item: Input) -> None:
        """Take it; answer with nothing."""
        if isinstance(item, Query):
            item.reply([])


async def putting(size_bytes: int, puts: int) -> dict[str, object]:
    """Two bare links, one of which puts."""
    a = ZenohLink("r0", fleet="sim", profile="local", listen=[ENDPOINT])
    b = ZenohLink("r1", fleet="sim", profile="local", connect=[ENDPOINT])
    try:
        await a.open(Deaf())
        await b.open(Deaf())
        await a.show(LIFE)
        await asyncio.sleep(1.0)
        began_s, kernel, count = time.monotonic(), counted_bytes(), Count()
        for _ in range(puts):
            a.put(LIFE, "delta", os.urandom(size_bytes))
            count.add(size_bytes)
            await asyncio.sleep(PUT_EVERY_S)
        kernel, time_s = counted_bytes() - kernel, time.monotonic() - began_s
    finally:
        await a.close()
        await b.close()
    estimate = wire_bytes({"delta": count}, time_s).total + wire_bytes({}, time_s).total
    return row(f"{size_bytes} B", puts, time_s, puts * size_bytes, estimate, kernel)


def row(what: str, messages: int, time_s: float, payload: int, estimate: int, kernel: int) -> dict[str, object]:
    """One line of a table."""
    return {
        "what": what,
        "messages": messages,
        "time_s": round(time_s, 2),
        "payload": payload,
        "estimate": estimate,
        "kernel": kernel,
        "off": round(estimate / kernel - 1, 4) if kernel else None,
    }


def main() -> None:
    """Measure, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--for-s", type=float, default=60.0, help="how long each period is watched")
    parser.add_argument("--tiny", action="store_true", help="seconds, to see that it runs")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not options.inside:
        sys.exit(in_a_namespace(__file__))
    periods, for_s = ((0.1,), 3.0) if options.tiny else (PERIODS_S, options.for_s)
    payloads, puts = ((8000,), 5) if options.tiny else (PAYLOADS, PUTS)
    tables = {
        "publish": [asyncio.run(publishing(period_s, for_s)) for period_s in periods]
        + [asyncio.run(publishing(BOTH_S, for_s, both=True))],
        "put": [asyncio.run(putting(size, puts)) for size in payloads],
    }
    if options.json:
        print(json.dumps(tables, indent=1))
        return
    for name, rows in tables.items():
        print(f"{name:16} {'messages':>9} {'s':>6} {'payload':>9} {'estimate':>9} {'kernel':>9} {'off':>7}")
        for r in rows:
            print(
                f"{r['what']:16} {r['messages']:9} {r['time_s']:6.1f} {r['payload']:9,} {r['estimate']:9,} "
                f"{r['kernel']:9,} {100 * float(str(r['off'])):6.1f}%"
            )
    print(
        f"said once, when the link opens: {statistics.median(int(str(r['opening'])) for r in tables['publish']):,.0f} B"
    )


if __name__ == "__main__":
    main()
