"""Zenoh endpoints, as ``tcp/10.0.0.2:7447``: what can't be one is refused before anything is opened.

Zenoh itself takes most of what is wrong in silence, and then nobody is ever reached.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Sequence

from fleetmap.model.errors import ConfigError

_ENDPOINT = re.compile(r"(?P<protocol>tcp|tls)/(?P<host>\[[^\]]*\]|[^:\[\]]*)(:(?P<port>[^?#]*))?(?P<rest>[?#].*)?")
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9_.-]*[A-Za-z0-9])?\.?")
_DIGITS = re.compile(r"[\d.]+")


def check_endpoints(option: str, endpoints: object) -> list[str]:
    """The endpoints, if each is ``tcp/HOST:PORT`` or ``tls/HOST:PORT``.

    Parameters
    ----------
    option : ``connect``, or ``listen``, which takes port 0, too: any that is free

    Raises
    ------
    ConfigError : it is no list, or an endpoint is none; says what is wrong with it
    """
    if isinstance(endpoints, str) or not isinstance(endpoints, Sequence):
        raise ConfigError(option=option, value=endpoints, reason='expected a list, as ["tcp/10.0.0.2:7447"]')
    for endpoint in endpoints:
        reason = _fault(endpoint, free_port=option == "listen")
        if reason is not None:
            raise ConfigError(
                option=option, value=endpoint, reason=f"expected tcp/HOST:PORT or tls/HOST:PORT; {reason}"
            )
    return list(endpoints)


def is_endpoint(endpoint: object) -> bool:
    """Whether it is one to listen at."""
    return _fault(endpoint, free_port=True) is None


def split(endpoint: str) -> tuple[str, str, int]:
    """Protocol, host (without the brackets of IPv6) and port of an endpoint."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.split("?")[0].split("#")[0].rpartition(":")
    return protocol, host.strip("[]"), int(port)


def _fault(endpoint: object, *, free_port: bool) -> str | None:
    """What is wrong with an endpoint."""
    if not isinstance(endpoint, str):
        return f"this is {type(endpoint).__name__}"
    if any(character.isspace() for character in endpoint):
        return "it has a space in it"
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None and re.match("(tcp|tls)://", endpoint, re.IGNORECASE):
        return f"write {endpoint.lower().replace('://', '/', 1)}"
    if match is None:
        # Recovery over UDP stalls for 10 s once a reply is lost: state never travels on it.
        return "other transports than TCP and TLS lose state" if "/" in endpoint else "the protocol is missing"
    return _fault_of_host(match["host"]) or _fault_of_port(match["port"], least=0 if free_port else 1)


def _fault_of_host(host: str) -> str | None:
    if not host:
        return "the host is missing"
    try:
        if host.startswith("["):
            ipaddress.IPv6Address(host[1:-1].partition("%")[0])
        elif _DIGITS.fullmatch(host):
            ipaddress.IPv4Address(host)
        elif not _HOST.fullmatch(host) or not all(0 < len(label) < 64 for label in host.rstrip(".").split(".")):
            return f"{host!r} is no name of a host"
    except ValueError:
        return f"{host!r} is no address"
    return None


def _fault_of_port(port: str | None, *, least: int) -> str | None:
    if not port:
        return "the port is missing"
    if not (port.isascii() and port.isdigit() and least <= int(port) <= 65535):
        return f"the port is {port!r}, not {least} to 65535"
    return None
