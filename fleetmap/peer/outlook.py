"""What a Zenoh session is linked to, and where it isn't, why, and whom else to dial."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection, Mapping, Sequence
from functools import partial

from fleetmap.model.threads import in_thread
from fleetmap.peer.health import Problem, behind_router, unreachable
from fleetmap.peer.link import Network
from fleetmap.peer.probe import Visit, split, why_not

ALONE_S, LOOK_S = 1.5, 10.0
"""After so long without any link it is found out why, and again each so often."""
MAX_PROBES = 8
DIAL_S, LONGEST_DIAL_PAUSE_S = 5.0, 300.0
"""After so long without any link those are dialled, too, of whom one has heard; and again, ever more seldom."""
EVERYWHERE = ("0.0.0.0", "::")


class Outlook:
    """Looks each second or so.

    Parameters
    ----------
    robot : own name
    fleet : the first two parts of its keys
    settings : of the session
    dialled : endpoints that it was told to dial

    Attributes
    ----------
    network : as of the last look
    """

    def __init__(self, robot: str, fleet: str, settings: Mapping[str, object], dialled: Sequence[str]) -> None:
        self._robot, self._fleet, self._settings = robot, fleet, settings
        self._dialled = list(dialled)
        self.network = Network(reached=not dialled)
        self._look_s = self._dial_s = self._dial_pause_s = 0.0
        self._alone_s = time.monotonic()

    async def look(
        self, sources: Sequence[str], *, routers: bool, listening: Sequence[str], seen: Collection[str]
    ) -> Network:
        """Find out what is wrong, if something is.

        Parameters
        ----------
        sources : own addresses of the links that there are
        routers : whether one of them leads to a router
        listening : endpoints
        seen : names of robots that are there, or heard by way of others
        """
        now_s = time.monotonic()
        if sources:
            self._alone_s = now_s
        found = self.network.problems
        if sources and not routers:
            found = ()
        elif now_s >= self._look_s and (sources or now_s >= self._alone_s + ALONE_S):
            self._look_s = now_s + LOOK_S
            behind = partial(self._behind_router, frozenset(seen))
            found = await (in_thread(behind) if sources else self._why_alone())
        addresses = _addresses(listening, sources) or self.network.addresses
        self.network = Network(self.network.reached or bool(sources), found, addresses)
        return self.network

    def dial_too(self, heard: Sequence[str]) -> list[str]:
        """Whom to dial now beside those that were to be dialled; mostly nobody."""
        now_s = time.monotonic()
        new = [each for each in heard if each not in {*self._dialled, *self.network.addresses}]
        if now_s < self._alone_s + DIAL_S:
            self._dial_s, self._dial_pause_s = 0.0, DIAL_S
            return []
        if not new or now_s < self._dial_s:
            return []
        self._dial_pause_s = min(2 * self._dial_pause_s, LONGEST_DIAL_PAUSE_S)
        self._dial_s = now_s + self._dial_pause_s
        return new

    async def _why_alone(self) -> tuple[Problem, ...]:
        dialled = self._dialled[:MAX_PROBES]
        reasons = await asyncio.gather(*(in_thread(partial(why_not, each, self._settings)) for each in dialled))
        return tuple(unreachable(endpoint, reason) for endpoint, reason in zip(dialled, reasons, strict=True))

    def _behind_router(self, seen: frozenset[str]) -> tuple[Problem, ...]:
        """Whom a client hears at the endpoints, and this peer doesn't: a router passes nothing on between peers."""
        found: set[str] = set()
        for endpoint in self._dialled[:MAX_PROBES]:
            with Visit(endpoint, self._settings) as visit:
                found |= visit.robots(self._fleet)
        unheard = sorted(found - seen - {self._robot})
        return (behind_router(unheard),) if unheard else ()


def _addresses(listening: Sequence[str], sources: Sequence[str]) -> tuple[str, ...]:
    """Where others reach a session: where it listens, or if that is everywhere, there by its own addresses."""
    hosts = sorted({split(source)[1] for source in sources})
    found = []
    for endpoint in listening:
        protocol, host, port = split(endpoint)
        for each in hosts if host in EVERYWHERE else [host]:
            found.append(f"{protocol}/[{each}]:{port}" if ":" in each else f"{protocol}/{each}:{port}")
    return tuple(sorted(found))
