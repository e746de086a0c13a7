"""Why an endpoint isn't reached is told, whatever is there; finding it out never harms the robot."""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import Iterator
from pathlib import Path

import pytest

import fleetmap
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import Pose2
from fleetmap.peer.endpoints import check_endpoints
from fleetmap.peer.ports import free_port
from fleetmap.peer.probe import why_not

TLS = "transport/link/tls"


@pytest.fixture
def silent() -> Iterator[str]:
    """Host and port of a program that accepts and says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"127.0.0.1:{server.getsockname()[1]}"


@pytest.fixture
def garbage(tmp_path: Path) -> str:
    path = tmp_path / "ca.crt"
    path.write_text("no certificate")
    return str(path)


def test_each_kind_of_silence_and_refusal_has_its_words(silent: str, garbage: str, monkeypatch) -> None:
    nobody = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
    assert "nobody listens there" in why_not(nobody, {})
    assert why_not(f"tcp/{silent}", {}) is None
    assert f"it speaks no TLS: write tcp/{silent}" in why_not(f"tls/{silent}", {})
    assert "can't be used" in why_not(f"tls/{silent}", {TLS: {"root_ca_certificate": garbage}})
    assert "can't be used" in why_not(f"tls/{silent}", {f"{TLS}/root_ca_certificate": "/gone/ca.crt"})
    keys = {"enable_mtls": True, "connect_certificate": garbage, "connect_private_key": "/gone/r.key"}
    assert "can't be used" in why_not(f"tls/{silent}", {TLS: keys})
    assert why_not(f"tls/{silent}", {TLS: {"root_ca_certificate_base64": "eA=="}}) is None
    assert "no computer is known by the name" in why_not("tcp/a..b:7447", {})

    def fails(address: object, timeout: float) -> socket.socket:
        raise TimeoutError

    monkeypatch.setattr(socket, "create_connection", fails)
    assert "the computer is off or out of reach" in why_not(nobody, {})


def test_whoever_resets_the_handshake_refuses(monkeypatch, silent: str) -> None:
    def reset(*_: object, **__: object) -> ssl.SSLSocket:
        raise ConnectionResetError("reset")

    monkeypatch.setattr(ssl.SSLContext, "wrap_socket", reset)
    assert "it refuses the certificate of this robot" in why_not(f"tls/{silent}", {})
    assert why_not(f"tcp/{silent}", {}) is None


async def test_what_can_not_be_found_out_ends_no_robot(monkeypatch, caplog, timeout_factor) -> None:
    def fails(*_: object) -> None:
        raise RuntimeError("the probe is broken")

    monkeypatch.setattr("fleetmap.peer.outlook.why_not", fails)
    place = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
    async with fleetmap.join("a", fleet="probe", profile="local", start=Pose2(), connect=[place]) as peer:
        async with asyncio.timeout(10.0 * timeout_factor):
            while "could not be found out" not in caplog.text:  # noqa: ASYNC110 - the log is for looking
                await asyncio.sleep(0.1)
        await peer.refresh()


@pytest.mark.parametrize("endpoint", ["tcp/a..b:7447", f"tcp/{'a' * 64}.b:7447", "tcp/-a-:7447"])
def test_a_host_that_can_not_be_a_name_is_refused(endpoint: str) -> None:
    with pytest.raises(ConfigError, match="no name of a host"):
        check_endpoints("connect", [endpoint])


def test_a_url_is_told_how_to_be_written() -> None:
    with pytest.raises(ConfigError, match=r"write tcp/10.0.0.2:7447"):
        check_endpoints("connect", ["TCP://10.0.0.2:7447"])


async def test_robots_of_other_fleets_are_named_where_none_of_the_own_is_there(caplog, timeout_factor) -> None:
    place = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
    common = {"profile": "local", "start": Pose2()}
    async with (
        fleetmap.join("a", fleet="site-4", listen=[place], **common),
        fleetmap.join("b", fleet="sitd-4", connect=[place], **common) as b,
    ):
        async with asyncio.timeout(10.0 * timeout_factor):
            while not b.health():  # noqa: ASYNC110 - health is for looking
                await asyncio.sleep(0.1)
        (problem,) = b.health()
        assert problem.kind == "fleet"
        assert problem.text.startswith("no robot of fleet 'sitd-4' there, but robots of site-4")
        with pytest.raises(TimeoutError, match="but robots of site-4"):
            await b.synced(0.5)


async def test_the_own_endpoint_among_those_to_dial_is_no_problem(timeout_factor) -> None:
    place, other = (f"tcp/127.0.0.1:{free_port('127.0.0.1')}" for _ in range(2))
    common = {"fleet": "alike", "profile": "local", "start": Pose2(), "connect": [place, other]}
    everywhere = place.replace("127.0.0.1", "0.0.0.0")
    async with fleetmap.join("a", listen=[everywhere], **common) as a:
        async with asyncio.timeout(10.0 * timeout_factor):
            while not a.health():  # noqa: ASYNC110 - health is for looking
                await asyncio.sleep(0.1)
        assert [problem.robot for problem in a.health()] == [other]
