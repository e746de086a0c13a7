"""The hash over all that is held is kept up to date; at any time it is the sum over all streams."""

from __future__ import annotations

import pytest
from exchange import chain, rooms
from format_reader import held_hash

from fleetmap.codecs.facts import Facts, supersede
from fleetmap.engine.author import Author
from fleetmap.engine.holdings import MAX_STREAMS, SPARED_S, Holdings
from fleetmap.engine.stream import Stream


def right(holdings: Holdings) -> bool:
    return holdings.held_hash() == held_hash([(s.robot, s.life, s.seq, s.digest) for s in holdings.streams()])


def hold(holdings: Holdings, robot: str, run: int, *, facts: Facts | None = None, edges: int = 4) -> Stream:
    its_chain = chain(robot, run, revisions=8)
    stream = Stream(robot, its_chain.life, 1, facts or Facts(), {"0": rooms(edges // 4)}, its_chain.link(1))
    replica = holdings.to_change(stream.key)
    holdings.hold(replica)
    replica.stream = stream
    return stream


@pytest.fixture
def holdings() -> Holdings:
    return Holdings(Author("me", chain("me")))


def test_a_superseded_life_that_is_spared_for_a_while(holdings: Holdings) -> None:
    former = hold(holdings, "r", 1)
    hold(holdings, "r", 2, facts=Facts().after(supersede({former.life: former.state})))
    for now_s, kept in ((0.0, 3), (SPARED_S + 1.0, 2)):
        holdings.now_s = now_s
        assert right(holdings)
        assert holdings.settle("r", lambda life: life == former.life, lambda _: False) == (
            [] if kept == 3 else [former]
        )
        assert len(holdings.streams()) == kept
        assert right(holdings)


def test_what_is_dropped_for_want_of_room(holdings: Holdings) -> None:
    for i in range(MAX_STREAMS + 2):
        hold(holdings, f"r{i}", 1)
    assert right(holdings)
    assert len(holdings.find_room(lambda _: False)) == 2
    assert right(holdings)


def test_a_revision_of_ones_own(holdings: Holdings) -> None:
    before = holdings.held_hash()
    holdings.author.commit(even_if_nothing=True)
    assert right(holdings)
    assert holdings.held_hash() != before
