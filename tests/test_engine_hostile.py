"""What a hostile robot may send costs others neither their merged map nor their memory."""

import numpy as np
import pytest

from fleetmap.codecs import envelope
from fleetmap.codecs.messages import Change, Header, Record, Revision, RevisionList
from fleetmap.engine import Ask, Engine, Put
from fleetmap.engine.stream import Stream, Submap, advance
from fleetmap.engine.view import view
from fleetmap.model.errors import ConfigError
from fleetmap.model.lattice import Lattice
from fleetmap.model.pose import MAX_UM, FixedPose
from fleetmap.model.vectormap import VectorMap

SQUARE = np.array([[0, 0, 0, 5, 1], [0, 5, 5, 5, 1], [0, 0, 5, 0, 3], [5, 0, 5, 5, 3]], np.int32)


def tell(engine: Engine, robot: str, author: Engine) -> None:
    for output in author.take_outputs():
        if isinstance(output, Put):
            engine.on_message(robot, output.suffix, output.payload, now_s=0.0)


def test_a_start_and_an_anchor_too_far_together_leave_that_submap_out() -> None:
    me, bad = Engine("me", start=FixedPose()), Engine("bad", start=FixedPose(MAX_UM, 0))
    square = VectorMap(Lattice(50_000), SQUARE, np.zeros(4, np.uint8))
    with pytest.raises(ConfigError, match="together"):
        bad.publish("far", square, anchor=FixedPose(MAX_UM, 0))
    # Another program may say it all the same.
    bad._commit(submaps={"far": Submap(square, FixedPose(MAX_UM, 0)), "near": Submap(square, FixedPose(-MAX_UM, 0))})
    tell(me, "bad", bad)
    assert [source.frame for source in view(me).sources] == [("bad", 1, "near")]
    ((frame, reason),) = view(me).left_out
    assert (frame, "together" in reason) == (("bad", 1, "far"), True)


def test_epochs_of_one_robot_that_never_begin_leave_room_for_others() -> None:
    me, good = Engine("me"), Engine("good")
    for epoch in range(1, 1100):
        gap = Record(epoch, 2, 5, Change(None, ()))
        me.on_message("bad", "delta", envelope.encode(gap), now_s=0.0)
    tell(me, "good", good)
    assert ("good", 1) in me.holdings.replicas
    assert len(me.holdings.replicas) < 10


def test_streams_that_a_peer_lists_no_more_are_forgotten() -> None:
    me = Engine("me")
    me.on_alive("bad", 1, "x", now_s=0.0)
    for turn in range(1, 6):
        for output in me.take_outputs():
            if isinstance(output, Ask) and output.suffix == "revisions":
                rows = tuple((f"ghost{turn}-{i}", Revision(1, 1, 1)) for i in range(100))
                me.on_reply(output.ask_id, envelope.encode(RevisionList(rows)), now_s=10.0 * turn)
        # Questions about the ghosts take turns with the one for the list.
        me.ask_list("bad", now_s=10.0 * turn - 1.0)
        me.tick(10.0 * turn)
    assert len(me._catchup.announced_keys()) <= 100


def test_no_claim_about_its_epochs_silences_a_robot() -> None:
    me, victim = Engine("me"), Engine("v")
    header = Header(forgets=(("v", 2**32 - 1), ("me", 2**32 - 1)))
    change = Change(header, ())
    stream = advance(Stream("bad", 1), change, seq=1, digest=Stream("bad", 1, 1, header).digest)
    record = envelope.encode(Record(1, 1, stream.revision.check, change))
    for engine in (me, victim):
        engine.on_message("bad", "delta", record, now_s=0.0)
        assert ("bad", 1) in engine.holdings.replicas
    victim.publish("0", VectorMap(Lattice(50_000), SQUARE, np.zeros(4, np.uint8)))
    tell(me, "v", victim)
    assert me.holdings.replicas["v", victim.own.epoch].stream.edges == len(SQUARE)
