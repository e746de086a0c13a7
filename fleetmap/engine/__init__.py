"""Streams, replicas and the decisions of the exchange; no I/O, no thread, no clock.

engine = Engine("r1", chain=Chain(seed))
engine.receive(Message("r2", life, "delta", payload), now_s=now_s)    # or Alive, Gone, Query, Reply, ReplyEnd
engine.tick(now_s)                                                    # ten times a second
for output in engine.take_outputs(): ...                              # Put, Ask, Answer: for the link; others: events
"""

from fleetmap.engine.chain import Chain
from fleetmap.engine.engine import Engine
from fleetmap.engine.inputs import Alive, Foreign, Gone, Input, Message, Query, Reply, ReplyEnd, Replying
from fleetmap.engine.outputs import (
    Answer,
    Ask,
    Event,
    LifeChanged,
    LookAgain,
    MapChanged,
    Output,
    PeersChanged,
    Put,
)
from fleetmap.engine.relays import RELAY_S
from fleetmap.engine.stream import Limits, Stream, advance

__all__ = [
    "RELAY_S",
    "Alive",
    "Answer",
    "Ask",
    "Chain",
    "Engine",
    "Event",
    "Foreign",
    "Gone",
    "Input",
    "LifeChanged",
    "Limits",
    "LookAgain",
    "MapChanged",
    "Message",
    "Output",
    "PeersChanged",
    "Put",
    "Query",
    "Reply",
    "ReplyEnd",
    "Replying",
    "Stream",
    "advance",
]
