"""Zenoh configurations: where each setting comes from is measured, and said beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fleetmap.model.errors import ConfigError
from fleetmap.peer.endpoints import check_endpoints
from fleetmap.peer.settings import check_config, leaves

PROFILES = ("lan", "local", "narrow")
"""``lan``: peers that find each other by multicast, and by the endpoints given. ``local``: by endpoints only.
``narrow``: by endpoints only, over slow radios: what is sent to keep links, and how far one is, goes seldom."""

LEASE_S = {"lan": 12.0, "local": 12.0, "narrow": 60.0}
"""After such a silence a link counts as cut. A process that is stopped or starved for less keeps its links; the process
that ends, or is killed, is seen at once. Keep-alives go each quarter: 36 B/s a link each way at 12 s, 7 at 60 s."""
OPENING_S = {"lan": 10.0, "local": 10.0, "narrow": 60.0}
"""How long a link may take to open. Zenoh tries those that gossip told of once, and never again."""
HEARTBEAT_S = {"lan": 10.0, "local": 10.0, "narrow": 60.0}
"""How often a peer says how far it is while nothing changes."""


def zenoh_settings(
    profile: str, *, listen: Sequence[str], connect: Sequence[str], config: Mapping[str, object] | None
) -> dict[str, object]:
    """Zenoh's settings for a profile: configuration key -> value. ``config`` adds to them and overrides them.

    Raises
    ------
    ConfigError : an unknown profile, no endpoint (``peer.endpoints``), a setting that can't be written as JSON or names
        a file that can't be read
    """
    if profile not in PROFILES:
        raise ConfigError(option="profile", value=profile, reason=f"expected one of {', '.join(PROFILES)}")
    listening, connecting = check_endpoints("listen", listen), check_endpoints("connect", connect)
    further = check_config({} if config is None else config)
    allowed = dict(leaves(further, "")).get("transport/link/protocols")
    protocol = "tls" if isinstance(allowed, list) and "tls" in allowed and "tcp" not in allowed else "tcp"
    everywhere = f"{protocol}/127.0.0.1:0" if profile == "local" else f"{protocol}/0.0.0.0:0"
    return {
        "mode": "peer",
        "listen/endpoints": listening or [everywhere],
        "connect/endpoints": connecting,
        "scouting/multicast/enabled": profile == "lan",
        "scouting/gossip/enabled": True,
        "scouting/delay": 100,
        "transport/link/tx/lease": round(1000 * LEASE_S[profile]),
        "transport/unicast/open_timeout": round(1000 * OPENING_S[profile]),
        # Whoever accepts can't know how slow the other side is.
        "transport/unicast/accept_timeout": round(1000 * max(OPENING_S.values())),
        # zenoh issues 2787 and 2788: memory that is never freed, silent loss.
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": 64 << 20,
        **further,
    }
