"""What a Zenoh session is linked to, and where it isn't, why, and whom else to dial."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial

from fleetmap.model.threads import in_thread
from fleetmap.peer.endpoints import split
from fleetmap.peer.health import Problem, behind_router, only_router, other_fleets, unreachable
from fleetmap.peer.link import Network
from fleetmap.peer.ports import is_local
from fleetmap.peer.probe import Visit, why_not

ALONE_S, COMING_S, LOOK_S = 1.5, 2.8, 10.0
"""After so long without any link it is found out why; that no reason is found isn't told before a link that is just
coming up had time for it; and again each so often."""
STRANGERS_S = 2.0
"""So long whoever is linked may take to show which fleet it belongs to."""
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
    fleets : which fleets have robots at the other ends of its links; takes a moment

    Attributes
    ----------
    network : as of the last look
    """

    def __init__(
        self,
        robot: str,
        fleet: str,
        settings: Mapping[str, object],
        dialled: Sequence[str],
        fleets: Callable[[], set[str]],
    ) -> None:
        self._robot, self._fleet, self._settings, self._fleets = robot, fleet, settings, fleets
        self._dialled = list(dialled)
        self.network = Network(reached=not dialled)
        self._look_s = self._dial_s = self._dial_pause_s = 0.0
        self._alone_s = self._unseen_s = time.monotonic()

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
            # What was found out without any says nothing of them.
            self._look_s = 0.0 if self._alone_s < now_s - ALONE_S else self._look_s
            self._alone_s = now_s
        if seen or not sources:
            self._unseen_s = now_s
        found = self.network.problems
        if sources and seen and not routers:
            found = ()
        elif not sources and now_s >= max(self._look_s, self._alone_s + ALONE_S):
            self._look_s = now_s + LOOK_S
            found = await self._why_alone(listening, now_s)
        elif sources and now_s >= max(self._look_s, self._unseen_s + STRANGERS_S if not seen else 0.0):
            self._look_s = now_s + LOOK_S
            found = await in_thread(partial(self._why_unseen, frozenset(seen), routers=routers))
        elif sources and any(problem.kind == "unreachable" for problem in found):
            found = ()
        addresses = _addresses(listening, sources) or self.network.addresses
        # A link that others dialled ends here where this session listens.
        ports = {split(each)[2] for each in listening}
        dialled = not self._dialled or any(split(source)[2] not in ports for source in sources)
        self.network = Network(self.network.reached or bool(seen) or dialled, found, addresses)
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

    async def _why_alone(self, listening: Sequence[str], now_s: float) -> tuple[Problem, ...]:
        others = await in_thread(lambda: [each for each in self._dialled if not _is_own(each, listening)])
        dialled = others[:MAX_PROBES]
        reasons = await asyncio.gather(*(in_thread(partial(why_not, each, self._settings)) for each in dialled))
        if None in reasons and now_s < self._alone_s + COMING_S:
            self._look_s = self._alone_s + COMING_S
            return ()
        return tuple(unreachable(endpoint, reason) for endpoint, reason in zip(dialled, reasons, strict=True))

    def _why_unseen(self, seen: frozenset[str], *, routers: bool) -> tuple[Problem, ...]:
        """There are links, and perhaps robots that aren't seen: behind a router, or of other fleets."""
        if routers:
            found: set[str] = set()
            for endpoint in self._dialled[:MAX_PROBES]:
                with Visit(endpoint, self._settings) as visit:
                    found |= visit.robots(self._fleet)
            if unheard := sorted(found - seen - {self._robot}):
                return (behind_router(unheard),)
            if not seen and self._settings.get("mode") == "peer":
                return (only_router(self._dialled),)
        others = sorted(self._fleets() - {self._fleet.partition("/")[2]}) if not seen else []
        return (other_fleets(self._fleet.partition("/")[2], others),) if others else ()


def _is_own(endpoint: str, listening: Sequence[str]) -> bool:
    """Whether whoever dials an endpoint reaches itself, as where all robots are given one list."""
    _, host, port = split(endpoint)
    return any(split(each)[2] == port for each in listening) and is_local(host)


def _addresses(listening: Sequence[str], sources: Sequence[str]) -> tuple[str, ...]:
    """Where others reach a session: where it listens, or if that is everywhere, there by its own addresses."""
    hosts = {split(source)[1] for source in sources}
    # On other computers this one's loopback would be their own.
    hosts = {host for host in hosts if not host.startswith("127.") and host != "::1"} or hosts
    found = []
    for endpoint in listening:
        protocol, host, port = split(endpoint)
        for each in sorted(hosts) if host in EVERYWHERE else [host]:
            found.append(f"{protocol}/[{each}]:{port}" if ":" in each else f"{protocol}/{each}:{port}")
    return tuple(sorted(found))
