"""Facts: bounded, checked where their kind is known, and where it isn't, kept, digested and passed on unharmed."""

from __future__ import annotations

from dataclasses import replace

import pytest
from exchange import Fleet, asks, chain, commit, deliver, dropped, engine, held, life, meet, query, reply, room, tell
from hypothesis import given
from hypothesis import strategies as st

from fleetmap.codecs import facts as known
from fleetmap.codecs.envelope import encode
from fleetmap.codecs.facts import Facts, FactsStep, check_facts
from fleetmap.codecs.facts.facts import MAX_FACTS, MAX_FACTS_BYTES, MAX_KEY_BYTES, MAX_VALUE_BYTES, check_bounds
from fleetmap.codecs.facts.lives import MAX_NAMED
from fleetmap.codecs.messages import Change, Record
from fleetmap.engine import Engine, Stream
from fleetmap.engine.log import record_message
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import FixedPose, Pose2

NEW = 200
"""A kind that no version knows yet."""
UNKNOWN = {bytes([NEW]): b"of another version", bytes([NEW]) + b"about this": b"\x00\xff" * 40, b"\xff": b""}

_KEYS = st.binary(min_size=1, max_size=3)
_FACTS = st.dictionaries(_KEYS, st.binary(max_size=3), max_size=6)


@given(_FACTS, _FACTS)
def test_the_step_between_two_states_leads_from_one_to_the_other(
    old: dict[bytes, bytes], new: dict[bytes, bytes]
) -> None:
    before, after = Facts(old), Facts(new)
    step = before.step_to(after)
    assert before.after(step) == after
    assert all(before.get(key) != value for key, value in step.items())
    assert after.after(step) is after


@given(_FACTS)
def test_facts_do_not_depend_on_the_order_in_which_they_were_said(items: dict[bytes, bytes]) -> None:
    backwards = Facts(dict(reversed(items.items())))
    assert list(backwards.items()) == sorted(items.items())
    assert Stream("r", 1, 1, backwards).digest == Stream("r", 1, 1, Facts(items)).digest
    for kind in {key[0] for key in items}:
        assert backwards.of(kind) == {key[1:]: value for key, value in items.items() if key[0] == kind}


@given(_FACTS, _KEYS, st.binary(max_size=3))
def test_every_fact_is_in_the_digest(items: dict[bytes, bytes], key: bytes, value: bytes) -> None:
    streams = [Stream("r", 1, 1, Facts(facts)) for facts in (items, {**items, key: value})]
    assert (streams[0].digest == streams[1].digest) == (items.get(key) == value)


LARGEST = {i.to_bytes(2, "big") + b"k" * 94: b"v" * 932 for i in range(255)}
"""Of 255 times 1028 bytes; 262144 are allowed."""


@pytest.mark.parametrize(
    ("facts", "reason"),
    [
        ({f"{i:05}".encode(): b"" for i in range(MAX_FACTS)}, None),
        ({f"{i:05}".encode(): b"" for i in range(MAX_FACTS + 1)}, "at most 2048 facts"),
        ({b"k" * MAX_KEY_BYTES: b"v" * MAX_VALUE_BYTES}, None),
        ({b"k" * (MAX_KEY_BYTES + 1): b""}, "keys of 1 to 96 B"),
        ({b"": b""}, "keys of 1 to 96 B"),
        ({b"k": b"v" * (MAX_VALUE_BYTES + 1)}, "values of at most 1024 B"),
        ({**LARGEST, b"k": b"v" * 3}, None),
        ({**LARGEST, b"k": b"v" * 4}, "at most 262144 B in all"),
    ],
)
def test_facts_are_bounded(facts: dict[bytes, bytes], reason: str | None) -> None:
    assert MAX_FACTS_BYTES == 262144
    if reason is None:
        check_bounds(facts)
    else:
        with pytest.raises(ValueError, match=reason):
            check_bounds(facts)


TURNED = FixedPose.from_pose(Pose2(1.0, -2.0, 0.5))


ALIGNMENT = known.AlignmentFact(
    "0",
    ("q" * 64, 2**64 - 1, "s" * 64),
    "committed",
    TURNED,
    (100, -3, 2, 90, 1, 4),
    (10**6, -(10**7)),
    known.Weight(120_000, 30, 125_000, 44_000, 7_000),
)
REFUSED = known.AlignmentFact("1", ("q", 7, "0"), "too_small")
SEEN = known.Seen(TURNED, (10**12, 0), TURNED.inverse())
VERDICT = known.Verdict(("q", 9, ALIGNMENT.subject), TURNED, 100_000)


def test_every_kind_comes_back() -> None:
    facts = Facts()
    steps: list[FactsStep] = [
        known.set_level("2.upper"),
        known.set_start(TURNED),
        known.set_anchor("s", TURNED),
        known.name_lives(facts, [7, 2**64 - 1]),
        known.supersede({7: (3, 2**63)}),
        known.forget({("q", 9): (2**18, 1), ("r-1", 9): (1, 2)}),
        known.set_addresses(["tcp/10.0.0.2:7447", "tls/[fe80::1%eth0]:1"]),
        known.set_alignment(ALIGNMENT),
        known.set_alignment(REFUSED),
        known.set_verdict(VERDICT),
        known.set_start_sigma(300_000, 20_000),
        known.set_landmark("tag-1", SEEN),
        known.set_sighting("q", 2**64 - 1, SEEN),
    ]
    for step in steps:
        facts = facts.after(step)
    check_facts(facts)
    assert {key[0] for key in facts} == known.CHECKS.keys() == set(range(1, 12))
    assert known.level_of(facts) == "2.upper"
    assert known.start_of(facts) == known.anchor_of(facts, "s") == TURNED
    assert known.named_lives(facts) == {7, 2**64 - 1}
    assert known.superseded_lives(facts) == {7: (3, 2**63)}
    assert known.forgotten_streams(facts) == {("q", 9): (2**18, 1), ("r-1", 9): (1, 2)}
    assert {fact.other: fact for fact in known.alignments_of(facts)} == {f.other: f for f in (ALIGNMENT, REFUSED)}
    assert known.verdicts_of(facts) == [VERDICT]
    assert known.start_sigma_of(facts) == (300_000, 20_000)
    assert known.landmarks_of(facts) == {"tag-1": SEEN}
    assert known.sightings_of(facts) == {("q", 2**64 - 1): SEEN}
    for taken_back in (
        known.drop_alignment("0", ALIGNMENT.other),
        known.drop_alignment("1", REFUSED.other),
        known.drop_verdict(VERDICT.about),
    ):
        facts = facts.after(taken_back)
    assert not known.alignments_of(facts)
    assert not known.verdicts_of(facts)


def test_what_is_usual_is_not_said() -> None:
    facts = Facts()
    assert (known.level_of(facts), known.start_of(facts), known.anchor_of(facts, "s")) == ("0", None, FixedPose())
    assert known.start_sigma_of(facts) == (30_000, 2_000)
    usual: list[FactsStep] = [known.set_level("0"), known.set_start(None), known.set_anchor("s", FixedPose())]
    usual.append(known.set_start_sigma(30_000, 2_000))
    for step in usual:
        assert facts.after(step) is facts
    # A start at the origin is known, and says so.
    assert known.start_of(facts.after(known.set_start(FixedPose()))) == FixedPose()


def test_of_too_many_lives_the_greatest_numbers_are_named() -> None:
    facts = Facts().after(known.name_lives(Facts(), range(5)))
    facts = facts.after(known.name_lives(facts, range(3, MAX_NAMED + 13)))
    assert known.named_lives(facts) == set(range(13, MAX_NAMED + 13))


POSE = known.set_start(TURNED)[b"\x02"] or b""
STATE = b"\x00" * 12
BAD_ALIGNMENTS = [
    replace(ALIGNMENT, submap="a b"),
    replace(ALIGNMENT, other=("a/b", 7, "0")),
    replace(ALIGNMENT, other=("a", 7, "")),
    replace(ALIGNMENT, covariance=(-1, 0, 0, 1, 0, 1)),
    replace(ALIGNMENT, covariance=(1, 0, 0, 1, 0, 2**62 + 1)),
    replace(ALIGNMENT, middle_um=(0, 2**44 + 1)),
    replace(ALIGNMENT, weight=known.Weight(-1)),
    replace(ALIGNMENT, weight=known.Weight(second=2**31 + 1)),
]


@pytest.mark.parametrize(
    "fact",
    [
        (b"\x01", b"a b"),
        (b"\x01", b"\xff"),
        (b"\x01x", b"1"),
        (b"\x02", POSE[:-1]),
        (b"\x02", POSE + b"\x00"),
        (b"\x02", b"\x94\x00\x00\x01\x01"),
        (b"\x02", b"\x94" + b"\xcf" + b"\xff" * 8 + POSE[2:]),
        (b"\x02", b"\xc1"),
        (b"\x02x", POSE),
        (b"\x03", POSE),
        (b"\x03a/b", POSE),
        (b"\x03\xff", POSE),
        (b"\x04" + b"\x00" * 7, b""),
        (b"\x04" + b"\x00" * 8, b"x"),
        (b"\x05" + b"\x00" * 8, STATE + b"\x00"),
        (b"\x05" + b"\x00" * 9, STATE),
        (b"\x06" + b"\x00" * 8, STATE),
        (b"\x06" + b"\x00" * 8 + b"a b", STATE),
        (b"\x06" + b"\x00" * 8 + b"a", STATE[1:]),
        (b"\x08" + ALIGNMENT.subject, REFUSED.pack()),
        (b"\x08" + ALIGNMENT.subject, ALIGNMENT.pack()[:-1]),
        (b"\x08" + ALIGNMENT.subject, ALIGNMENT.pack() + b"\x00"),
        (b"\x08" + ALIGNMENT.subject, b"\xc1"),
        *[(b"\x08" + fact.subject, fact.pack()) for fact in BAD_ALIGNMENTS],
        (b"\x09" + b"\x00" * 16, b"\x00" * 4),
        (b"\x09" + b"\x00" * 16 + b"a b", b"\x00" * 4),
        (b"\x09" + b"\x00" * 16 + b"a", b"\x00" * 3),
        (b"\x09" + b"\x00" * 16 + b"a", b"\x00" * 4 + POSE[:-1]),
        (b"\x0ax", b"\x00" * 10),
        (b"\x0a", b"\x00" * 9),
        (b"\x0bx", b"\x00" * 11),
        (b"\x0bla b", b"\x00" * 11),
        (b"\x0bla", b"\x00" * 10),
        (b"\x0bla", b"\x00" * 10 + bytes([len(POSE) - 1]) + POSE[:-1]),
        (b"\x0bla", b"\x00" * 11 + POSE[:-1]),
        (b"\x0br" + b"\x00" * 8, b"\x00" * 11),
    ],
)
def test_a_fact_that_is_not_of_its_kind_is_refused_and_nothing_is_changed(fact: tuple[bytes, bytes]) -> None:
    key, value = fact
    with pytest.raises((ValueError, ConfigError)):
        check_facts({key: value})
    me, links = engine("me"), chain("bad")
    facts = Facts({key: value})
    digest = Stream("bad", links.life, 1, facts).digest
    tell(me, ("bad", links.life), encode(Record(1, links.link(1), digest & 0xFFFF, Change(dict(facts), ()))))
    assert held(me, ("bad", links.life)).seq == 0
    assert sum(dropped(me).values()) == 1


def test_what_an_author_may_not_say_beyond_the_bounds_is_refused_by_it_and_by_its_peers() -> None:
    me, author = engine("me"), engine("r")
    commit(author, facts={bytes([NEW, i]): b"x" * 1000 for i in range(200)})
    deliver(author, me)
    said = author.own
    assert held(me, author).revision == said.revision
    more = {bytes([NEW + 1, i]): b"x" * 1000 for i in range(200)}
    with pytest.raises(ConfigError, match="at most 262144 B in all"):
        commit(author, facts=more)
    assert author.own is said
    # Another program may say it all the same.
    there = Stream("r", said.life, said.seq + 1, said.facts.after(more), link=chain("r").link(said.seq + 1))
    record, _ = record_message(said, there)
    tell(me, author, record)
    assert held(me, author).revision == said.revision
    assert dropped(me) == {("r", "delta/expected facts of at most  B in all"): 1}


@pytest.mark.parametrize("way", ["record", "snapshot"])
def test_unknown_facts_come_by_record_and_by_snapshot(way: str) -> None:
    author, me = engine("other"), engine("me")
    meet(author, me)
    if way == "snapshot":
        author.publish("0", room(9))
        commit(author, facts=UNKNOWN)
        author.take_outputs()
        author.tick(0.0)
        deliver(author, me)  # the heartbeat alone
        me.tick(1.0)
        (ask,) = asks(me, "snapshot")
        reply(me, ask, *query(author, "snapshot", ask.payload), now_s=1.0)
    else:
        deliver(author, me)
        commit(author, facts=UNKNOWN)
        author.publish("0", room(9))
        deliver(author, me)
    assert held(me, author).revision == author.own.revision
    assert dict(held(me, author).facts) == UNKNOWN


def says_new_facts(author: Engine) -> None:
    """The other version: it has facts of a kind of its own, says them, and goes on as usual."""
    commit(author, facts=UNKNOWN)
    author.publish("0", room(9))
    commit(author, facts={bytes([NEW]): b"changed", b"\xff": None})


def test_a_peer_of_another_version_with_facts_that_this_one_does_not_know() -> None:
    """Both hold the same digests, and the unknown facts reach a third one unharmed, by way of the second alone."""
    fleet = Fleet("ab")
    a, b = fleet.nodes["a"], fleet.nodes["b"]
    says_new_facts(a.engine)
    a.carry_out()
    fleet.run(3.0)
    fleet.assert_equal()
    said = {bytes([NEW]): b"changed", bytes([NEW]) + b"about this": UNKNOWN[bytes([NEW]) + b"about this"]}
    assert {key: value for key, value in held(b.engine, a.engine).facts.items() if key[0] >= NEW} == said
    fleet.kill("a")
    fleet.run(0.5)
    c = fleet.add("c")
    fleet.run(3.0)
    fleet.assert_equal()
    assert held(c.engine, a.engine).digest == a.engine.own.digest
    assert held(c.engine, a.engine).facts == a.engine.own.facts
    assert ("a", life("a")) in c.merges()


def test_unknown_facts_go_with_their_author_into_its_next_life() -> None:
    author = engine("a", revisions=4)
    commit(author, facts=UNKNOWN)
    for size in range(5, 12):
        author.publish("0", room(size))
    assert author.own.life != life("a")
    assert {key: value for key, value in author.own.facts.items() if key[0] >= NEW} == UNKNOWN


def test_who_has_no_room_for_another_fact_still_listens() -> None:
    me, former = engine("a", run=2), engine("a", run=1)
    commit(me, facts={bytes([NEW]) + f"{i}".encode(): b"" for i in range(MAX_FACTS)})
    deliver(former, me)
    assert held(me, former).revision == former.own.revision
    assert me.own.names == frozenset()


def test_where_others_listen_is_known_and_bounded() -> None:
    me, others = engine("me"), [engine(f"r{i:02}") for i in range(20)]
    for i, other in enumerate(others):
        assert other.set_addresses([f"tcp/10.0.{i}.{k}:7447" for k in range(9)])
        assert not other.set_addresses([f"tcp/10.0.{i}.{k}:7447" for k in range(4)])
        deliver(other, me)
    assert me.addresses()[:5] == [*(f"tcp/10.0.0.{k}:7447" for k in range(4)), "tcp/10.0.1.0:7447"]
    assert len(me.addresses()) == 32
    others[0].set_addresses(["no address", "udp/10.0.0.1:1"])
    deliver(others[0], me)
    assert me.addresses()[0] == "tcp/10.0.1.0:7447"
    for wrong in (b"", b"tcp/10.0.0.1", b" ".join([b"tcp/a:1"] * 5), b"tcp/a b:1", b"\xff"):
        with pytest.raises(ValueError):  # noqa: PT011 - by the bytes or by the rule
            check_facts({b"\x07": wrong})
