"""Why an endpoint isn't reached, found out by trying, in words that say what to do. Zenoh only tries again."""

from __future__ import annotations

import socket
import ssl
from collections.abc import Mapping
from contextlib import suppress
from types import TracebackType
from typing import Self

import zenoh

from fleetmap.peer import endings
from fleetmap.peer.endpoints import split
from fleetmap.peer.keys import living_keys, parse_token, zenoh_config
from fleetmap.peer.settings import leaves

CONNECT_S = 2.0
"""A computer that doesn't answer within this is out of reach."""
REFUSAL_S = 0.5
"""With TLS 1.3 a certificate is refused after the handshake: so long that may take."""
TLS = "transport/link/tls"


def why_not(endpoint: str, settings: Mapping[str, object]) -> str | None:
    """What keeps a session with these settings from that endpoint; None if it isn't that. Takes a few seconds."""
    protocol, host, port = split(endpoint)
    try:
        socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        return f"no computer is known by the name {host!r} ({reason}): check the name, or write its address"
    try:
        connection = socket.create_connection((host, port), timeout=CONNECT_S)
    except ConnectionRefusedError:
        return "nobody listens there: start the robot that should, or check the address and the port"
    except TimeoutError:
        return "no answer: the computer is off or out of reach, or a firewall drops what is sent to it"
    except OSError as error:
        return f"can't be reached ({error.strerror}): check the network, and the address"
    with connection:
        if protocol == "tls":
            return _why_no_tls(connection, host, port, _tls(settings))
        if _wants_tls(connection, host):
            return f"it wants TLS: write tls/{host}:{port}, and give the certificates of the fleet in config="
    return None


class Visit:
    """A session as a client of one endpoint, which hears what a router keeps from peers; use it as ``with``.

    Parameters
    ----------
    endpoint : of the router
    settings : Zenoh's, of the peer
    """

    def __init__(self, endpoint: str, settings: Mapping[str, object]) -> None:
        self._settings = {
            **settings,
            "mode": "client",
            "connect/endpoints": [endpoint],
            "connect/timeout_ms": round(1000 * CONNECT_S),
            "connect/exit_on_failure": True,
            "listen/endpoints": [],
            "scouting/multicast/enabled": False,
        }
        self._session: zenoh.Session | None = None

    def __enter__(self) -> Self:
        endings.opened(self)
        with suppress(zenoh.ZError):
            self._session = zenoh.open(zenoh_config(self._settings))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close_now()

    def robots(self, fleet: str) -> set[str]:
        """Names of those that show a token under ``fleetmap/<fleet>``; none if nobody let this session in."""
        if self._session is None:
            return set()
        tokens = map(parse_token, living_keys(self._session, f"{fleet}/*/alive/**", timeout_s=CONNECT_S))
        return {token[0] for token in tokens if token is not None}

    def close_now(self) -> None:
        """End the session. May be called twice, from any thread."""
        session, self._session = self._session, None
        with suppress(zenoh.ZError):
            if session is not None:
                session.close()  # type: ignore[no-untyped-call]
        endings.closed(self)


def _why_no_tls(connection: socket.socket, host: str, port: int, tls: Mapping[str, object]) -> str | None:
    def named(option: str) -> str | None:
        value = tls.get(option)
        return value if isinstance(value, str) else None

    certificate, key = named("connect_certificate"), named("connect_private_key")
    try:
        context = ssl.create_default_context(cafile=named("root_ca_certificate"))
        context.check_hostname = tls.get("verify_name_on_connect") is not False
        if certificate is not None and tls.get("enable_mtls"):
            context.load_cert_chain(certificate, key)
    except (OSError, ValueError) as error:
        return f"the certificates that this robot was given can't be used ({error}): expected PEM"
    if any(name.endswith("_base64") for name in tls):
        return None  # they are Zenoh's to judge: what is found without them would mislead
    try:
        with context.wrap_socket(connection, server_hostname=host) as secured:
            secured.settimeout(REFUSAL_S)
            with suppress(TimeoutError):
                if not secured.recv(1):
                    return _REFUSED.format("it closed the link")
    except ssl.SSLCertVerificationError as error:
        return (
            f"its certificate is not trusted here ({error.verify_message}): it must be issued by the fleet's key, for "
            "the name that is dialled, and be in its time"
        )
    except TimeoutError:
        return f"it speaks no TLS: write tcp/{host}:{port} if its robots use none, or give them certificates, too"
    except (OSError, ValueError) as error:
        reason = getattr(error, "reason", None) or str(error)
        return _REFUSED.format(str(reason).lower().replace("_", " "))
    return None


def _wants_tls(connection: socket.socket, host: str) -> bool:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    connection.settimeout(REFUSAL_S)  # Zenoh waits for more, and says nothing
    try:
        context.wrap_socket(connection, server_hostname=host).close()
    except ssl.SSLError as error:
        # An alert: it speaks TLS, and wants a certificate.
        return "ALERT" in str(error.reason or "")
    except OSError:
        return False
    return True


_REFUSED = (
    "it refuses the certificate of this robot ({}): it must be issued by the fleet's key and be in its time, and "
    "connect_certificate, connect_private_key and enable_mtls must be set"
)


def _tls(settings: Mapping[str, object]) -> dict[str, object]:
    """The TLS settings, whether they stand together or one by one."""
    found: dict[str, object] = {}
    for path, value in leaves(settings, ""):
        if path.startswith(f"{TLS}/"):
            found[path.removeprefix(f"{TLS}/")] = value
    return found
