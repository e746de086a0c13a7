"""``join()`` and ``Peer``: the engine on a transport, for asyncio."""

from fleetmap.peer.changes import Change
from fleetmap.peer.info import PeerInfo, TeammateInfo
from fleetmap.peer.join import join
from fleetmap.peer.options import JoinOptions
from fleetmap.peer.peer import Peer

__all__ = ["Change", "JoinOptions", "Peer", "PeerInfo", "TeammateInfo", "join"]
