"""Robots that don't know where they started find each other, say why not where they can't, and nobody's view jumps."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from align import off_m
from buildings import Pair, make_pair, sample, with_walls
from conftest import two_rooms

import fleetmap
from fleetmap.align.protocol import Alignment
from fleetmap.codecs.facts import (
    AlignmentFact,
    Facts,
    Seen,
    Verdict,
    Weight,
    alignments_of,
    drop_alignment,
    drop_verdict,
    set_alignment,
    set_landmark,
    set_verdict,
)
from fleetmap.engine import Stream
from fleetmap.engine.alignments import said_by_all
from fleetmap.model.errors import ConfigError, NoPath
from fleetmap.model.pose import Q30, FixedPose, Pose2
from fleetmap.peer import Peer, aligner
from fleetmap.peer.memory_link import LoopClock, MemoryHub
from fleetmap.peer.pairs import Job, Pairs, Snapshot
from fleetmap.vectorize import vectorize

PAIR = make_pair("same", 1)
PATIENCE_S = 60.0


async def until(peer: Peer, true: Callable[[], bool]) -> None:
    """Wait for a state of a peer."""
    async with asyncio.timeout(PATIENCE_S):
        while not true():
            async with peer.stepped:
                await peer.stepped.wait()


async def together(*peers: Peer) -> None:
    """Wait until all have found each other, and another one has confirmed it; then all hold the same map."""
    for peer in peers:
        await until(peer, lambda peer=peer: bool(peer.alignments) and all(a.confirmed_by for a in peer.alignments))  # type: ignore[misc]
    assert len({(await peer.refresh()).digest for peer in peers}) == 1


async def test_two_robots_with_unknown_starts_make_one_map() -> None:
    hub = MemoryHub(LoopClock())
    async with fleetmap.join("r1", link=hub.link("r1")) as one, fleetmap.join("r2", link=hub.link("r2")) as two:
        await one.publish(PAIR.a)
        assert one.T_fleet_robot is None
        await two.publish(PAIR.b)
        await together(one, two)
        assert one.T_fleet_robot == Pose2()
        found = two.T_fleet_robot
        assert found is not None
        assert PAIR.T_a_b is not None
        assert off_m(found, PAIR.T_a_b, PAIR.shared_xy) < 0.1
        (alignment,) = one.alignments
        assert (alignment.a[0], alignment.b[0], alignment.outcome) == ("r1", "r2", "committed")
        assert alignment.T_a_b == found
        assert 0.0 < alignment.sigma_m < 0.05
        assert alignment.explained_m > 20.0
        assert one.frame == two.frame == "r1"
        # The view of the second robot is still its own map frame.
        assert one.T_view_fleet == Pose2()
        there = two.T_view_fleet @ found
        assert (there.x_m, there.y_m, there.yaw_rad) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
        # Poses in the map of the other.
        await two.set_pose(Pose2(1.0, 2.0, 0.5))
        await until(one, lambda: bool(one.teammates()))
        (mate,) = one.teammates()
        assert mate.pose is not None
        assert (mate.pose.x_m, mate.pose.y_m) == pytest.approx(tuple(found.apply((1.0, 2.0))), abs=0.002)
        assert one.alignments[0].confirmed_by == ("r2",)
        assert not [problem for problem in one.health() if problem.kind in ("not merged", "start")]


async def test_who_is_not_merged_is_told_why() -> None:
    pair = make_pair("rooms", 0)
    hub = MemoryHub(LoopClock())
    async with fleetmap.join("r1", link=hub.link("r1")) as one, fleetmap.join("r2", link=hub.link("r2")) as two:
        await one.publish(pair.a)
        await two.publish(pair.b)
        for peer, other in ((one, "r2"), (two, "r1")):
            await until(peer, lambda peer=peer: bool(peer.alignments))  # type: ignore[misc]
            (problem,) = [problem for problem in peer.health() if problem.kind == "not merged"]
            assert problem.robot == other
            assert problem.text.startswith(f"not merged with {other}: ambiguous (two places fit: ")
            assert peer.T_fleet_robot is None


async def test_a_start_that_is_off_is_corrected_by_the_map_and_said_to_be() -> None:
    assert PAIR.T_a_b is not None
    for off, corrected in ((Pose2(0.3, 0.0, math.radians(2)), True), (Pose2(0.01, 0.0, 0.0), False)):
        hub = MemoryHub(LoopClock())
        start = PAIR.T_a_b @ off
        async with (
            fleetmap.join("r1", start=Pose2(), link=hub.link("r1")) as one,
            fleetmap.join("r2", start=start, link=hub.link("r2")) as two,
        ):
            await one.publish(PAIR.a)
            await two.publish(PAIR.b)
            await one.synced(at_least=1)
            await one.aligned(PATIENCE_S)
            await two.synced(at_least=1)
            assert bool(two.alignments) == corrected
            if corrected:
                await together(one, two)
            told = [problem.text for problem in two.health() if problem.kind == "start"]
            found = two.T_fleet_robot
            assert found is not None
            if corrected:
                (text,) = told
                assert re.fullmatch(r"the start of r2 contradicts the map by 0\.3 m, (1\.9|2\.0|2\.1)°; .*", text)
                assert off_m(found, PAIR.T_a_b, PAIR.shared_xy) < 0.1
            else:
                assert not told
                assert off_m(found, start, PAIR.shared_xy) < 1e-5


async def test_starts_that_are_exact_are_believed_whatever_the_maps_say() -> None:
    assert PAIR.T_a_b is not None
    hub = MemoryHub(LoopClock())
    start = PAIR.T_a_b @ Pose2(0.3, 0.0, 0.0)
    async with (
        fleetmap.join("r1", start=Pose2(), start_sigma=(0, 0), link=hub.link("r1")) as one,
        fleetmap.join("r2", start=start, start_sigma=(0, 0), link=hub.link("r2")) as two,
    ):
        await one.publish(PAIR.a)
        await two.publish(PAIR.b)
        await one.synced(at_least=1)
        await one.aligned(PATIENCE_S)
        assert not one.alignments
        await two.synced(at_least=1)
        assert two.T_fleet_robot is not None
        assert off_m(two.T_fleet_robot, start, PAIR.shared_xy) < 1e-5


async def test_a_landmark_or_a_sighting_tells_like_rooms_apart() -> None:
    pair = next(pair for pair in (make_pair("rooms", seed) for seed in range(9)) if pair.overlap > 0.3)
    assert pair.T_a_b is not None
    for landmark in (True, False):
        hub = MemoryHub(LoopClock())
        async with fleetmap.join("r1", link=hub.link("r1")) as one, fleetmap.join("r2", link=hub.link("r2")) as two:
            await one.publish(pair.a)
            await two.publish(pair.b)
            await until(one, lambda one=one: bool(one.alignments))  # type: ignore[misc]
            assert one.alignments[0].outcome == "ambiguous"
            tag = Pose2(*pair.shared_xy[0], 0.7)
            if landmark:
                await one.saw_landmark("tag-17", pair.T_a_b @ tag)
                await two.saw_landmark("tag-17", tag)
            else:
                with pytest.raises(ConfigError, match="announces its pose"):
                    await one.saw("r2", Pose2())
                await two.set_pose(tag)
                await until(one, lambda one=one: "r2" in one._engine.teammates.by_name)  # type: ignore[misc]
                await one.saw("r2", pair.T_a_b @ tag @ Pose2(0.2, -0.1, 0.1))
            await together(one, two)
            assert two.T_fleet_robot is not None
            assert off_m(two.T_fleet_robot, pair.T_a_b, pair.shared_xy) < 0.1


@pytest.mark.parametrize("sigma", [(1.0,), (-1.0, 0.0), ("a", 0.0), (math.nan, 0.0), 3.0, (2000.0, 0.0)])
def test_an_impossible_start_sigma_is_refused(sigma: object) -> None:
    with pytest.raises(ConfigError, match="start_sigma"):
        fleetmap.join("r1", start=Pose2(), start_sigma=sigma)  # type: ignore[arg-type]


# The pairs of one peer, without threads or links


def stream(robot: str, life: int, vector_map: object, facts: dict[bytes, bytes | None] | None = None) -> Stream:
    base = Stream(robot, life)
    return Stream(robot, life, 1, base.facts.after(facts or {}), {"0": vector_map})  # type: ignore[dict-item]


def snapshot(own: Stream, *others: Stream, absent: tuple[str, ...] = ()) -> Snapshot:
    said = said_by_all([own, *others])
    held = frozenset(s.key for s in (own, *others))
    return Snapshot(own, others, said, frozenset(s.key for s in others if s.robot not in absent), held)


def part(pair: Pair, share: float) -> object:
    """What a robot had seen of its part when it had seen so much of it."""
    states = pair.a.states_yx()
    seen = np.zeros(states.shape, bool)
    seen[: int(states.shape[0] * share)] = True
    grid = fleetmap.OccupancyGrid.from_states(
        np.where(seen, states, 2).astype(np.uint8), pair.a.resolution_m, pair.a.origin
    )
    return vectorize(grid)


def test_the_smaller_name_looks_and_whoever_is_there_if_the_other_is_not() -> None:
    a, b = vectorize(PAIR.a), vectorize(PAIR.b)
    r1, r2 = stream("r1", 1, a), stream("r2", 2, b)
    job = Pairs().next(snapshot(r1, r2))
    assert job is not None
    assert (job.a.frame, job.b.frame, job.about) == (("r1", 1, "0"), ("r2", 2, "0"), None)
    assert Pairs().next(snapshot(r2, r1)) is None
    assert Pairs().next(snapshot(r2, r1, absent=("r1",))) is not None
    # A former life of its own is nobody else's to look at.
    assert Pairs().next(snapshot(r1, stream("r1", 9, b), absent=("r1",))) is not None


def test_nothing_is_looked_at_twice_before_it_has_grown() -> None:
    a, b = vectorize(PAIR.a), vectorize(PAIR.b)
    pairs, r1, r2 = Pairs(), stream("r1", 1, a), stream("r2", 2, b)
    job = pairs.next(snapshot(r1, r2))
    assert job is not None
    too_small = Alignment("too_small", None, ((0.0,) * 3,) * 3, (0.0, 0.0), None, None, "")
    assert pairs.found(job, too_small, r1) == set_alignment(AlignmentFact("0", ("r2", 2, "0"), "too_small"))
    assert pairs.next(snapshot(r1, r2)) is None
    small, pairs = stream("r1", 1, part(PAIR, 0.5)), Pairs()
    job = pairs.next(snapshot(small, r2))
    assert job is not None
    pairs.found(job, too_small, small)
    assert pairs.next(snapshot(small, r2)) is None
    assert pairs.next(snapshot(r1, r2)) is not None
    for again in (stream("r3", 3, b), stream("r2", 5, b)):  # another robot, another life
        assert pairs.next(snapshot(r1, r2, again)) is not None


def test_a_place_counts_once_it_is_found_again_in_maps_that_have_grown() -> None:
    from fleetmap.align.evidence import Evidence

    a, b = vectorize(PAIR.a), vectorize(PAIR.b)
    pairs, said = Pairs(), Facts()

    def look(explained_m: float, place: Pose2, outcome: str = "committed") -> str | None:
        nonlocal said
        own = stream("r1", 1, a, dict(said))
        job = pairs.next(snapshot(own, stream("r2", 2, b))) or last[-1]
        last.append(job)
        evidence = Evidence(explained_m, 0.0, explained_m, 5.0, 0.02, 9, 12.0)
        identity = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
        said = said.after(pairs.found(job, Alignment(outcome, place, identity, (0.0, 0.0), evidence, None, ""), own))
        (fact,) = alignments_of(said)
        return fact.outcome

    last: list[Job] = []
    assert look(20.0, Pose2(1.0, 0.0, 0.0)) == "provisional"
    assert look(22.0, Pose2(1.0, 0.0, 0.0)) == "provisional"
    assert look(24.5, Pose2(1.0, 0.0, 0.0)) == "committed"
    assert look(24.6, Pose2(1.0, 0.0, 0.0)) == "committed"
    # Elsewhere it is another place, which is to be found again itself.
    assert look(30.0, Pose2(9.0, 0.0, 0.0)) == "provisional"
    assert look(30.0, Pose2(9.0, 0.0, 0.0), "ambiguous") == "ambiguous"
    assert look(31.0, Pose2(9.0, 0.0, 0.0)) == "provisional"
    # So much can't be chance.
    assert look(70.0, Pose2(9.0, 0.0, 0.0)) == "committed"


def test_a_landmark_settles_what_is_provisional_though_no_map_grows() -> None:
    a, b = vectorize(PAIR.a), vectorize(PAIR.b)
    assert PAIR.T_a_b is not None
    place = FixedPose.from_pose(PAIR.T_a_b)
    before = set_alignment(AlignmentFact("0", ("r2", 2, "0"), "provisional", place, weight=Weight(30_000)))
    r1, r2 = stream("r1", 1, a, before), stream("r2", 2, b)
    pairs = Pairs()
    job = pairs.next(snapshot(r1, r2))
    assert job is not None
    nothing_new = Alignment("committed", PAIR.T_a_b, ((1e-6,) * 3,) * 3, (0.0, 0.0), None, None, "")
    pairs.found(job, nothing_new, r1)
    assert pairs.next(snapshot(r1, r2)) is None
    tag = Pose2(1.0, 2.0, 0.5)
    r1 = stream("r1", 1, a, before | set_landmark("tag", Seen(FixedPose.from_pose(PAIR.T_a_b @ tag), (0, 0))))
    r2 = stream("r2", 2, b, set_landmark("tag", Seen(FixedPose.from_pose(tag), (0, 0))))
    job = pairs.next(snapshot(r1, r2))
    assert job is not None
    assert job.prior is not None
    (fact,) = alignments_of(r1.facts.after(pairs.found(job, aligner.work(job), r1)))
    assert fact.outcome == "committed"


async def test_who_has_no_map_and_no_start_sees_what_most_robots_have_become() -> None:
    hub = MemoryHub(LoopClock())
    async with (
        fleetmap.join("r1", link=hub.link("r1")) as one,
        fleetmap.join("r2", link=hub.link("r2")) as two,
        fleetmap.join("a", link=hub.link("a")) as apart,
        fleetmap.join("0", link=hub.link("0")) as guest,
    ):
        await one.publish(PAIR.a)
        await two.publish(PAIR.b)
        await apart.publish(two_rooms())
        await until(guest, lambda: any(bool(alignment.confirmed_by) for alignment in guest.alignments))
        merged = await guest.synced(at_least=3)
        assert (guest.frame, guest.T_fleet_robot, guest.T_merged_robot) == ("r1", None, None)
        assert merged.digest == (await one.refresh()).digest == (await two.refresh()).digest
        with pytest.raises(NoPath, match="neither a map nor a start"):
            guest.plan((0.0, 0.0), (1.0, 0.0), radius_m=0.1)
        # With a map of its own it is alone with that.
        await guest.publish(two_rooms())
        assert (await guest.refresh()).digest != merged.digest
        assert guest.frame == "0"


def test_the_other_robot_of_the_pair_judges_or_else_the_smallest_name_that_is_there() -> None:
    a, b = vectorize(PAIR.a), vectorize(PAIR.b)
    assert PAIR.T_a_b is not None
    fact = AlignmentFact(
        "0", ("r2", 2, "0"), "committed", FixedPose.from_pose(PAIR.T_a_b), weight=Weight(explained=30_000)
    )
    r1 = stream("r1", 1, a, set_alignment(fact))
    r2, r3, r4 = stream("r2", 2, b), stream("r3", 3, a), stream("r4", 4, b)

    def judges(own: Stream, *others: Stream, absent: tuple[str, ...] = ()) -> bool:
        job = Pairs().next(snapshot(own, *others, absent=absent))
        return job is not None and job.about == ("r1", 1, fact.subject)

    assert judges(r2, r1, r3, r4)
    assert not judges(r3, r1, r2, r4)
    assert judges(r3, r1, r2, r4, absent=("r2",))
    assert not judges(r4, r1, r2, r3, absent=("r2",))
    # What is only provisional needs no judge.
    r1 = stream("r1", 1, a, set_alignment(replace(fact, outcome="provisional")))
    assert not judges(r2, r1, r3, r4)


def test_what_was_said_of_streams_that_are_gone_is_taken_back() -> None:
    a, b = vectorize(PAIR.a), vectorize(PAIR.b)
    fact = AlignmentFact("0", ("r2", 2, "0"), "too_small")
    verdict = Verdict(("r3", 3, fact.subject), FixedPose(), 1000)
    own = stream("r1", 1, a, {**set_alignment(fact), **set_verdict(verdict)})
    r2, r3 = stream("r2", 2, b), stream("r3", 3, b)
    pairs = Pairs()
    assert pairs.tidy(snapshot(own, r2, r3)) == {}
    assert pairs.tidy(snapshot(own, r3)) == drop_alignment("0", fact.other)
    assert pairs.tidy(snapshot(own)) == {**drop_alignment("0", fact.other), **drop_verdict(verdict.about)}


def test_who_says_much_is_not_served_before_the_others() -> None:
    """A stranger says a false place after the other, and shows many maps; the other robot is looked at all the same."""
    a, b = vectorize(PAIR.a), vectorize(PAIR.b)
    r1, r2 = stream("r1", 1, a), stream("r2", 2, b)
    maps = {f"s{k:03}": b for k in range(40)}
    pairs, looked = Pairs(), []
    for k in range(6):
        fact = AlignmentFact("s000", ("r1", 1, "0"), "committed", FixedPose(k * 1_000_000), weight=Weight(90_000))
        z = replace(stream("z", 9, b, set_alignment(fact)), submaps=maps)
        job = pairs.next(snapshot(r1, r2, z))
        assert job is not None
        looked.append(job.robot)
        nothing = Alignment("too_small", None, ((0.0,) * 3,) * 3, (0.0, 0.0), None, None, "")
        pairs.found(job, nothing, r1)
    assert looked == ["r2", "z", "z", "z", "z", "z"]
    # What grows meanwhile has its turn.
    assert pairs.next(snapshot(stream("r1", 1, vectorize(PAIR.b)), r2, z)) is not None


def test_what_was_judged_is_not_judged_again_whatever_became_of_the_verdict() -> None:
    a, b = vectorize(PAIR.a), vectorize(PAIR.b)
    fact = AlignmentFact("0", ("r1", 1, "0"), "committed", FixedPose(0, 0, Q30, 92_681), weight=Weight(90_000))
    r1, r2 = stream("r1", 1, a), stream("r2", 2, b, set_alignment(fact))
    pairs = Pairs()
    job = pairs.next(snapshot(r1, r2))
    assert job is not None
    assert job.about is not None
    pairs.failed(job)
    again = pairs.next(snapshot(r1, r2))
    assert again is not None
    assert again.about is None


async def test_a_stranger_with_many_maps_does_not_fill_what_a_robot_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aligner, "MOST_SAID_OF_ONE", 5)
    hub = MemoryHub(LoopClock())
    async with (
        fleetmap.join("r1", link=hub.link("r1")) as one,
        fleetmap.join("r2", link=hub.link("r2")) as two,
        fleetmap.join("z", link=hub.link("z")) as stranger,
    ):
        await one.publish(PAIR.a)
        for k in range(12):
            await stranger.publish(two_rooms(), submap=f"s{k:02}")
        await one.synced(at_least=2)
        await one.aligned(PATIENCE_S)
        assert sum(alignment.a[0] == "r1" for alignment in one.alignments) == 5
        await two.publish(PAIR.b)
        await until(one, lambda: any(a.b[0] == "r2" and bool(a.confirmed_by) for a in one.alignments))


async def test_a_map_that_can_not_be_looked_at_costs_its_own_place_and_nobody_elses(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(job: Job) -> Alignment:
        if "r2" in (job.a.frame[0], job.b.frame[0]):
            raise np.linalg.LinAlgError("singular")
        return work(job)

    work = aligner.work
    monkeypatch.setattr(aligner, "work", fail)
    hub = MemoryHub(LoopClock())
    async with (
        fleetmap.join("r1", link=hub.link("r1")) as one,
        fleetmap.join("r2", link=hub.link("r2")) as two,
        fleetmap.join("r3", link=hub.link("r3")) as three,
    ):
        for peer, grid in ((one, PAIR.a), (two, PAIR.b), (three, PAIR.b)):
            await peer.publish(grid)
        await together(one, three)
        await one.aligned(PATIENCE_S)  # it isn't tried for ever
        assert {alignment.b[0] for alignment in one.alignments} == {"r3"}
    told = [record.getMessage() for record in caplog.records if "can't be aligned" in record.getMessage()]
    assert len([text for text in told if text.startswith("r1")]) == 1


async def test_a_path_is_on_the_map_that_was_folded_whatever_was_found_since() -> None:
    hub = MemoryHub(LoopClock())
    async with (
        fleetmap.join("r1", link=hub.link("r1"), fold_interval_s=3600.0) as one,
        fleetmap.join("r2", link=hub.link("r2"), fold_interval_s=3600.0) as two,
    ):
        await two.publish(PAIR.b)
        await two.refresh()
        (x0, y0), (x1, y1) = PAIR.shared_xy[10], PAIR.shared_xy[-10]
        before = two.plan((x0, y0), (x1, y1), radius_m=0.1)
        assert (two.frame, two.T_merged_robot) == ("r2", None)
        await one.publish(PAIR.a)
        for peer in (one, two):
            await until(peer, lambda peer=peer: any(a.confirmed_by for a in peer.alignments))  # type: ignore[misc]
        assert two.T_fleet_robot is not None
        if two.frame == "r2":  # no fold in between
            again = two.plan((x0, y0), (x1, y1), radius_m=0.1)
            assert again.points_xy.tolist() == before.points_xy.tolist()
        await two.refresh()
        assert two.frame == "r1"
        assert two.T_merged_robot == two.T_fleet_robot
        after = two.plan((x0, y0), (x1, y1), radius_m=0.1)
        assert after.length_m < 1.5 * before.length_m
        assert after.points_xy[0].tolist() == pytest.approx([x0, y0], abs=1e-6)


def test_maps_with_hardly_any_wall_are_looked_at_with_nobody() -> None:
    little = vectorize(sample(*_cell(), bent=False))
    assert Pairs().next(snapshot(stream("r1", 1, little), stream("r2", 2, vectorize(two_rooms())))) is None


def _cell() -> tuple[np.ndarray, np.ndarray, Pose2, np.random.Generator]:
    solid = np.ones((60, 60), bool)
    solid[20:34, 20:34] = False
    return solid, with_walls(~solid, solid), Pose2(1.0, 1.0, 0.3), np.random.default_rng(0)
