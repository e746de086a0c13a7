"""Kind 7: where the author listens, for whoever has lost all links and finds nobody where it was told to dial."""

from __future__ import annotations

import re
from collections.abc import Sequence

from fleetmap.codecs.facts.facts import Facts, FactsStep

KIND = 7
MOST = 4
ADDRESS = re.compile(r"(tcp|tls)/[A-Za-z0-9._\-\[\]:%]{1,100}:[0-9]{1,5}")
_KEY = bytes([KIND])


def addresses_of(facts: Facts) -> tuple[str, ...]:
    """Endpoints, as ``tcp/10.0.0.2:7447``."""
    value = facts.get(_KEY)
    return () if value is None else tuple(value.decode().split(" "))


def set_addresses(addresses: Sequence[str]) -> FactsStep:
    """The step that says them; the first few, if they are many."""
    fit = [address for address in addresses if ADDRESS.fullmatch(address)][:MOST]
    return {_KEY: " ".join(fit).encode() if fit else None}


def check(subject: bytes, value: bytes) -> None:
    """``ValueError`` if this is no such fact."""
    addresses = value.decode().split(" ")
    if subject or len(addresses) > MOST or not all(map(ADDRESS.fullmatch, addresses)):
        raise ValueError(f"expected at most {MOST} addresses, as tcp/10.0.0.2:7447")
