"""Zenoh configurations: where each setting comes from is measured, and said beside it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from fleetmap.model.errors import ConfigError
from fleetmap.peer.endpoints import check_endpoints

PROFILES = ("lan", "local", "narrow")
"""``lan``: peers that find each other by multicast, and by the endpoints given. ``local``: by endpoints only.
``narrow``: by endpoints only, over slow radios: what is sent to keep links, and how far one is, goes seldom."""

LEASE_S = {"lan": 10.0, "local": 10.0, "narrow": 60.0}
"""After such a silence a link counts as cut. A process that is stopped or starved for less keeps its links; the process
that ends, or is killed, is seen at once. Keep-alives go each quarter: 43 B/s a link each way at 10 s, 7 at 60 s."""
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
    ConfigError : an unknown profile, no endpoint (``peer.endpoints``), or a setting that can't be written as JSON
    """
    if profile not in PROFILES:
        raise ConfigError(option="profile", value=profile, reason=f"expected one of {', '.join(PROFILES)}")
    listening, connecting = check_endpoints("listen", listen), check_endpoints("connect", connect)
    further = _checked_config({} if config is None else config)
    everywhere = "tcp/127.0.0.1:0" if profile == "local" else "tcp/0.0.0.0:0"
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


def _checked_config(config: object) -> dict[str, object]:
    if not isinstance(config, Mapping) or not all(isinstance(key, str) for key in config):
        reason = 'expected Zenoh\'s keys -> values, as {"scouting/multicast/enabled": False}'
        raise ConfigError(option="config", value=config, reason=reason)
    for key, value in config.items():
        try:
            as_json5(value)
        except (TypeError, ValueError) as error:
            reason = f"the value of {key!r} can't be written as JSON: {error}"
            raise ConfigError(option="config", value={key: value}, reason=reason) from None
    return dict(config)


def as_json5(value: object) -> str:
    """A setting as the JSON text that ``zenoh.Config.insert_json5`` expects; text stays as it is."""
    return value if isinstance(value, str) and value[:1] in '"[{' else json.dumps(value)
