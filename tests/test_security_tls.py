"""docs/security.md over real TLS links on loopback: its commands and its configuration are run as they stand there."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import shutil
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from attacks import ANSWERED, SAID, TOKEN, Stranger

import fleetmap
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import Pose2
from fleetmap.model.vectormap import VectorMap
from fleetmap.peer import Peer

PAGE = (Path(__file__).parent.parent / "docs" / "security.md").read_text()
(COMMANDS,) = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
(CERTIFY,) = re.findall(r"^certify\(\) \{.*?^\}$", COMMANDS, re.DOTALL | re.MULTILINE)
(SNIPPET,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
(FLEET,) = re.findall(r'^FLEET = "(.*)"$', SNIPPET, re.MULTILINE)
(MUST_LINK,) = re.findall(r'^    ("connect/timeout_ms".*)$', PAGE, re.MULTILINE)

TIMEOUT_FACTOR = float(os.environ.get("FLEETMAP_TEST_TIMEOUT_FACTOR", "1"))
TIMEOUT_S = 20.0 * TIMEOUT_FACTOR
ANY_PORT = "tls/127.0.0.1:0"
Secured = Callable[..., dict[str, object]]

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed: no certificates")


def run(script: str, folder: Path) -> None:
    done = subprocess.run(["sh", "-eu", "-c", script], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The certificates that the page's commands make, and one of a robot that the page's list doesn't name."""
    folder = tmp_path_factory.mktemp("fleet")
    run(f"{COMMANDS}\ncertify r9 '12 hours'", folder)
    return folder / "keys"


@pytest.fixture(scope="module")
def other_keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same names, certified by another CA."""
    folder = tmp_path_factory.mktemp("other")
    run(COMMANDS, folder)
    return folder / "keys"


@pytest.fixture(scope="module")
def secured(keys: Path) -> Secured:
    """The page's function. The page runs where the keys are."""
    names: dict[str, Secured] = {}
    with contextlib.chdir(keys.parent):
        exec(SNIPPET, names)
    return names["secured"]


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tls/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


def must_link() -> dict[str, object]:
    """What the page adds so that a refused robot is told."""
    settings = json.loads(f"{{{MUST_LINK.replace('True', 'true')}}}")
    return {**settings, "connect/timeout_ms": int(settings["connect/timeout_ms"] * TIMEOUT_FACTOR)}


def join(robot: str, config: dict[str, object], **kw: object) -> Peer:
    where = {"listen": [ANY_PORT], **kw}
    return fleetmap.join(robot, fleet=FLEET, profile="local", start=Pose2(), config=config, **where)  # type: ignore[arg-type]


def rooms(count: int) -> VectorMap:
    """A map of so many square rooms in a row."""
    rows = []
    for x in range(0, 100 * count, 100):
        corners = [(0, x), (0, x + 50), (50, x + 50), (50, x)]
        rows += [(*a, *b, 1) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    return VectorMap(Lattice(50_000), np.array(rows, np.int32), np.full(len(rows), 4, np.uint8))


async def until(peer: Peer, condition: Callable[[], bool]) -> None:
    """Wait for something that the peer gets to know of."""
    async with asyncio.timeout(TIMEOUT_S), peer.stepped:
        await peer.stepped.wait_for(condition)


def edges_of(peer: Peer) -> dict[str, int]:
    """Robot -> edges, of all that a peer has heard of."""
    return {known.robot: known.edges for known in peer.peers}


async def test_certified_robots_of_the_list_hold_the_same_map(keys: Path, secured: Secured, endpoint: str) -> None:
    async with (
        join("r1", secured("r1", keys=keys), listen=[endpoint]) as r1,
        join("r2", secured("r2", keys=keys), connect=[endpoint]) as r2,
    ):
        await r1.publish(rooms(1))
        await r2.publish(rooms(2))
        # What was said before r3 came reaches it through answers, what it says itself goes out as a record.
        async with join("r3", secured("r3", keys=keys), connect=[endpoint]) as r3:
            await r3.synced(TIMEOUT_S, at_least=2)
            await r3.publish(rooms(3))
            merged = [await peer.synced(TIMEOUT_S, at_least=2) for peer in (r1, r2, r3)]
            assert len({m.digest for m in merged}) == 1
            assert edges_of(r1) == {"r2": 8, "r3": 12}
            assert edges_of(r2) == {"r1": 4, "r3": 12}
            assert edges_of(r3) == {"r1": 4, "r2": 8}


async def test_who_has_no_certificate_of_the_fleet_gets_no_link(
    keys: Path, other_keys: Path, secured: Secured, endpoint: str
) -> None:
    async def is_refused(
        config: dict[str, object], *, listen: str = "tcp/127.0.0.1:0", connect: str = endpoint
    ) -> None:
        with pytest.raises(fleetmap.LinkError, match="Unable to connect"):
            await join("r2", {**config, **must_link()}, listen=[listen], connect=[connect])

    uncertified = {"transport/link/tls": {"root_ca_certificate": f"{keys}/ca.crt", "verify_name_on_connect": False}}
    async with join("r1", secured("r1", keys=keys), listen=[endpoint]) as r1:
        await asyncio.gather(
            is_refused(secured("r2", keys=other_keys), listen=ANY_PORT),
            is_refused(uncertified),
            is_refused({}, connect=endpoint.replace("tls/", "tcp/")),
        )
        assert edges_of(r1) == {}
        async with join("r2", {**secured("r2", keys=keys), **must_link()}, connect=[endpoint]):
            await until(r1, lambda: edges_of(r1) == {"r2": 0})


async def test_a_robot_links_to_nobody_without_a_certificate_of_the_fleet(
    keys: Path, other_keys: Path, secured: Secured, endpoint: str
) -> None:
    async def is_shunned(config: dict[str, object], listen: str, dialled: str) -> None:
        async with join("r1", config, listen=[listen]) as impostor:
            with pytest.raises(fleetmap.LinkError, match="Unable to connect"):
                await join("r2", {**secured("r2", keys=keys), **must_link()}, connect=[dialled])
            assert edges_of(impostor) == {}

    plain = free_endpoint()
    await asyncio.gather(
        is_shunned(secured("r1", keys=other_keys), endpoint, endpoint),
        is_shunned({}, plain.replace("tls/", "tcp/"), plain),
    )


async def test_a_peer_never_listens_beside_tls(keys: Path, secured: Secured, endpoint: str) -> None:
    async with join("r1", secured("r1", keys=keys), listen=[]) as r1:
        assert [each.partition("/")[0] for each in r1._link._listening] == ["tls"]
    for listen in (["tcp/127.0.0.1:0"], [ANY_PORT, "tcp/127.0.0.1:0"]):
        with pytest.raises(fleetmap.LinkError, match="Unsupported protocol: tcp"):
            await join("r1", secured("r1", keys=keys), listen=listen)


async def test_a_missing_file_is_named(keys: Path, secured: Secured) -> None:
    with pytest.raises(fleetmap.ConfigError, match=r"r8.crt can't be read \(No such file"):
        await join("r8", secured("r8", keys=keys))


@pytest.mark.parametrize("fence", ["rules", "no rules"])
def test_a_certified_robot_speaks_under_its_own_name_only_if_there_are_rules(
    keys: Path, secured: Secured, endpoint: str, fence: str
) -> None:
    """r3 is the evil one, and says everything as r2 first; what it then says as r3 comes over the same link, later."""
    configs = [secured(robot, keys=keys) for robot in ("r1", "r3")]
    if fence == "no rules":
        for config in configs:
            del config["access_control"]
    below = f"fleetmap/{FLEET}"
    forged, own = ([f"{below}/{robot}/{what}" for what in SAID] for robot in ("r2", "r3"))
    everywhere = [f"{below}/*/{what}" for what in SAID]
    with (
        Stranger(listen=[endpoint], config=configs[0], timeout_s=TIMEOUT_S) as r1,
        Stranger(listen=[ANY_PORT], connect=[endpoint], config=configs[1], timeout_s=TIMEOUT_S) as evil,
    ):
        r1.listen_to(f"{below}/**")
        ready = f"{below}/r1/{TOKEN}"
        r1.token(ready)
        # Declarations come over the link in order: who sees the token knows of the subscriptions before it.
        evil.listen_to(f"{below}/r1/**")
        evil.until(lambda: ready in evil.alive)
        for robot in ("r2", "r3"):
            for what in ANSWERED:
                evil.answer(f"{below}/{robot}/{what}", [robot.encode()])
                evil.answer(f"{below}/r3/{what}", [b"under another key"], under=f"{below}/r2/{what}")
            evil.token(f"{below}/{robot}/{TOKEN}")
        for key in [*forged, *everywhere, *own]:
            evil.put(key, b"a lie")
        # Each of r1's ears has a thread of its own, and hears in order.
        r1.until(lambda: own[-1] in {key for key, _ in r1.heard} and f"{below}/r3/{TOKEN}" in r1.alive)
        heard, alive = sorted(key for key, _ in r1.heard), r1.alive - {ready}
        replies = {key for what in ANSWERED for key, _ in r1.ask(f"{below}/*/{what}")}

    truth = {f"{below}/r3/{what}" for what in ANSWERED}
    if fence == "rules":
        assert heard == sorted(own)
        assert alive == {f"{below}/r3/{TOKEN}"}
        assert replies == truth
    else:
        assert heard == sorted([*forged, *everywhere, *own])
        assert alive == {f"{below}/{robot}/{TOKEN}" for robot in ("r2", "r3")}
        assert replies == truth | {f"{below}/r2/{what}" for what in ANSWERED}


async def test_without_rules_a_certified_robot_is_whoever_it_says(keys: Path, secured: Secured, endpoint: str) -> None:
    def mtls_only(robot: str) -> dict[str, object]:
        return {key: value for key, value in secured(robot, keys=keys).items() if key != "access_control"}

    async with (
        join("r1", mtls_only("r1"), listen=[endpoint]) as r1,
        join("r2", mtls_only("r3"), connect=[endpoint]) as evil,
    ):
        await evil.publish(rooms(5))
        await until(r1, lambda: edges_of(r1) == {"r2": 20})


async def test_rules_leave_a_name_to_its_robot(keys: Path, secured: Secured, endpoint: str) -> None:
    async with (
        join("r1", secured("r1", keys=keys), listen=[endpoint]) as r1,
        join("r2", {**secured("r3", keys=keys), **must_link()}, connect=[endpoint]) as evil,
    ):
        await evil.publish(rooms(5))
        await r1.publish(rooms(1))
        await until(evil, lambda: edges_of(evil) == {"r1": 4})
        # The name is not in use, and the map of the robot that bears it is what it says itself.
        async with join("r2", secured("r2", keys=keys), connect=[endpoint]) as r2:
            await r2.publish(rooms(2))
            merged = [await peer.synced(TIMEOUT_S, at_least=1) for peer in (r1, r2)]
            assert merged[0].digest == merged[1].digest
            assert edges_of(r1) == {"r2": 8}
            assert edges_of(r2) == {"r1": 4}


async def test_a_certified_robot_that_the_list_does_not_name_neither_hears_nor_is_heard(
    keys: Path, secured: Secured, endpoint: str
) -> None:
    async with (
        join("r1", secured("r1", keys=keys), listen=[endpoint]) as r1,
        join("r9", {**secured("r9", keys=keys), **must_link()}, connect=[endpoint]) as r9,
    ):
        await r9.publish(rooms(5))
        async with join("r2", secured("r2", keys=keys), connect=[endpoint]) as r2:
            await r2.publish(rooms(2))
            await r1.publish(rooms(1))
            await r1.synced(TIMEOUT_S, at_least=1)
            await r2.synced(TIMEOUT_S, at_least=1)
            assert edges_of(r1) == {"r2": 8}
            assert edges_of(r2) == {"r1": 4}
            assert edges_of(r9) == {}


async def test_a_link_ends_with_its_certificate_and_comes_back_with_the_next_one(
    keys: Path, secured: Secured, endpoint: str
) -> None:
    def certify(how_long: str) -> None:
        run(f"{CERTIFY}\ncertify r3 '{how_long}'", keys)

    at_r3 = free_endpoint()
    async with join("r1", secured("r1", keys=keys), listen=[endpoint]) as r1:
        certify(f"{4 * TIMEOUT_FACTOR:.0f} seconds")
        async with join("r3", secured("r3", keys=keys), listen=[at_r3], connect=[endpoint]):
            await until(r1, lambda: [p.alive for p in r1.peers] == [True])
            await until(r1, lambda: [p.alive for p in r1.peers] == [False])
            certify("12 hours")
            # It dials on, and with the certificate that lies there by then.
            await until(r1, lambda: [p.alive for p in r1.peers] == [True])
            # To who dials it, it shows the certificate that it opened with.
            with pytest.raises(fleetmap.LinkError, match="Unable to connect"):
                await join("r2", {**secured("r2", keys=keys), **must_link()}, connect=[at_r3])
        async with (
            join("r3", secured("r3", keys=keys), listen=[at_r3]),
            join("r2", {**secured("r2", keys=keys), **must_link()}, connect=[at_r3]) as r2,
        ):
            await until(r2, lambda: any(p.robot == "r3" and p.alive for p in r2.peers))


async def test_whoever_is_refused_by_tls_is_told_why(
    keys: Path, other_keys: Path, secured: Secured, endpoint: str, caplog: pytest.LogCaptureFixture
) -> None:
    async def told(config: dict[str, object], dialled: str) -> str:
        listen = [ANY_PORT if config else "tcp/127.0.0.1:0"]
        async with join("r2", config, connect=[dialled], listen=listen) as refused, asyncio.timeout(TIMEOUT_S):
            while not refused.health():  # noqa: ASYNC110 - health is for looking
                await asyncio.sleep(0.05)
            (problem,) = refused.health()
            assert (problem.kind, problem.robot) == ("unreachable", dialled)
            return problem.text

    ours, theirs = secured("r2", keys=keys), secured("r2", keys=other_keys)
    tls = "transport/link/tls"
    mixed = {**ours, tls: {**theirs[tls], "root_ca_certificate": ours[tls]["root_ca_certificate"]}}
    async with join("r1", secured("r1", keys=keys), listen=[endpoint]):
        assert "its certificate is not trusted here" in await told(theirs, endpoint)
        assert "it refuses the certificate of this robot" in await told(mixed, endpoint)
        assert f"it wants TLS: write {endpoint}" in await told({}, endpoint.replace("tls/", "tcp/"))
