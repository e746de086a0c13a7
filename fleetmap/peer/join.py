"""``fleetmap.join``: where a robot enters the fleet."""

from __future__ import annotations

import secrets

from fleetmap.peer.options import JoinOptions, taking
from fleetmap.peer.peer import Peer


def make_peer(options: JoinOptions) -> Peer:
    """A peer on the link that the options name, not yet connected."""
    link = options.link
    if link is None:
        # Zenoh takes 33 MB; a program that only works on maps never loads it.
        from fleetmap.peer.zenoh_link import ZenohLink

        link = ZenohLink(
            options.robot,
            fleet=options.fleet,
            profile=options.profile,
            listen=options.listen,
            connect=options.connect,
            config=options.config,
        )
    return Peer(options, link=link, seed=secrets.token_bytes(16))


@taking(JoinOptions)
def join(options: JoinOptions) -> Peer:
    """Join a fleet: ``async with fleetmap.join("r7", fleet="site-4") as peer: ...``.

    The options, one by one: ``help(fleetmap.JoinOptions)``.

    Returns
    -------
    Peer : not yet connected; ``async with`` connects and closes it, ``await`` connects it

    Raises
    ------
    ConfigError : an option has an impossible value
    NameInUse : on connecting: a living peer has this name
    LinkError : on connecting: the transport could not be opened
    """
    return make_peer(options)
