"""``join()``, ``Peer`` and the links: the only room that knows Zenoh."""
