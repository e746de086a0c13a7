"""TCP ports of this machine: which are free."""

from __future__ import annotations

import errno
import socket

from fleetmap.model.errors import LinkError
from fleetmap.peer.endpoints import split


def is_free(host: str, port: int) -> bool:
    """Whether nothing listens there."""
    with _socket(host) as probe:
        try:
            probe.bind((host.strip("[]"), port))
        except OSError as error:
            return error.errno != errno.EADDRINUSE
        return True


def free_port(host: str) -> int:
    """Any port of that host on which nothing listens.

    Raises
    ------
    LinkError : there is none, or this machine has no such host
    """
    with _socket(host) as probe:
        try:
            probe.bind((host.strip("[]"), 0))
        except OSError as error:
            raise LinkError(endpoint=f"tcp/{host}:0", reason=str(error)) from None
        return int(probe.getsockname()[1])


def at_free_port(endpoint: str) -> str:
    """An endpoint with a port that is free now instead of port 0."""
    protocol, host, port = split(endpoint)
    if port:
        return endpoint
    shown = f"[{host}]" if ":" in host else host
    end = endpoint.index(":0", endpoint.index(host) + len(host))
    return f"{protocol}/{shown}:{free_port(shown)}{endpoint[end + 2 :]}"


def is_local(host: str) -> bool:
    """Whether a name or an address is one of this machine's."""
    try:
        found = socket.getaddrinfo(host.strip("[]"), 0, type=socket.SOCK_DGRAM)
    except (OSError, ValueError):
        return False
    for family, kind, _, _, address in found:
        with socket.socket(family, kind) as probe:
            try:
                probe.bind(address)
            except OSError:
                continue
            return True
    return False


def _socket(host: str) -> socket.socket:
    probe = socket.socket(socket.AF_INET6 if host.startswith("[") else socket.AF_INET)
    # A port whose last connections are still in TIME_WAIT is free to listen on.
    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    return probe
