"""Zenoh configurations: where each setting comes from is measured, and said beside it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from fleetmap.model.errors import ConfigError
from fleetmap.peer.endpoints import check_endpoints

PROFILES = ("lan", "local")
"""``lan``: peers that find each other by multicast, and by the endpoints given. ``local``: by endpoints only."""


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
        "timestamping/enabled": True,
        # A silent cut is noticed after the lease: 10 s by default.
        "transport/link/tx/lease": 3000,
        "transport/unicast/open_timeout": 2000,
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
