"""Which frames are connected, and where each lies: by what is said, whoever asks, in whatever order it came."""

from __future__ import annotations

import itertools
import math
import time

import numpy as np
import pytest
from alignment_histories import Said, confirms, costs_its_own_place, place, run_revocation, run_schedule, says

from fleetmap.codecs.facts import (
    AlignmentFact,
    Weight,
    name_lives,
    set_alignment,
    set_anchor,
    set_level,
    set_start,
)
from fleetmap.codecs.facts.facts import Facts
from fleetmap.engine.alignments import near
from fleetmap.engine.components import components_of
from fleetmap.model.pose import MAX_UM, Q30, FixedPose, Pose2

A, B, C, D = [(name, 1) for name in "abcd"]


def four(seed: int = 0) -> Said:
    rng = np.random.default_rng(seed)
    return Said({key: place(rng) for key in (A, B, C, D)})


def test_who_says_nothing_is_alone_in_its_own_frame() -> None:
    found = four().components()
    assert [found.members(key) for key in (A, B, C, D)] == [[A], [B], [C], [D]]
    assert all(found.pose(key) == FixedPose() for key in (A, B, C, D))


def test_alignments_are_composed_and_the_smallest_name_gives_the_frame() -> None:
    said = four()
    for pair in ((D, C), (B, C), (B, A)):
        said.align(*pair)
    found = said.components()
    assert found.members(D) == [A, B, C, D]
    assert found.pose(A) == FixedPose()
    for a, b in itertools.combinations((A, B, C, D), 2):
        assert said.is_true(found, a, b, most_m=1e-4)


def test_order_does_not_matter() -> None:
    said = four()
    for pair in itertools.combinations((A, B, C, D), 2):
        said.align(*pair, off=Pose2(0.01, 0.0, 0.001))
    streams = said.streams()
    for order in itertools.permutations(streams):
        assert components_of(order).poses == said.components().poses


def test_of_a_loop_that_does_not_close_what_more_support_wins() -> None:
    said = four()
    for pair in itertools.combinations((A, B, C, D), 2):
        said.align(*pair)
    said.align(A, D, off=Pose2(5.0, 0.0, 0.0), explained_m=500.0)
    found = said.components()
    assert [(edge.a, edge.b) for edge in found.lost] == [(A, D)]
    assert said.is_true(found, A, D, most_m=1e-4)


@pytest.mark.parametrize(("off", "lost"), [(0.25, 0), (0.35, 1)])
def test_a_loop_closes_to_within_0_3_m(off: float, lost: int) -> None:
    said = four()
    for pair in ((A, B), (B, C)):
        said.align(*pair, explained_m=50.0)
    said.align(A, C, off=Pose2(off, 0.0, 0.0), explained_m=20.0)
    assert len(said.components().lost) == lost


def test_what_nobody_confirmed_places_its_author_alone() -> None:
    said = four()
    said.align(A, B)
    said.align(C, B, confirmed=False)
    said.align(C, D, confirmed=False)
    found = said.components()
    # C hangs itself on one of both, and brings the other nowhere.
    assert found.members(A) in ([A, B, C], [A, B])
    assert D not in found.members(A)
    assert not costs_its_own_place(said, [A, B, D], C)


def test_the_other_robot_of_the_pair_may_refuse_and_nobody_else() -> None:
    said = four()
    said.align(A, B)
    fact = says(said.poses[A], said.poses[B], B)
    said.say(C, confirms(A, fact, holds=False))
    assert said.components().members(A) == [A, B]
    said.say(B, confirms(A, fact, holds=False))
    assert said.components().members(A) == [A]


def test_a_verdict_holds_for_places_nearby() -> None:
    for off_m, together in ((0.05, True), (0.2, False)):
        said = four()
        said.align(A, B, off=Pose2(off_m, 0.0, 0.0), confirmed=False)
        said.align(A, C)
        said.say(B, confirms(A, says(said.poses[A], said.poses[B], B)))
        edge = next(each for each in said.components().said if each.other == B)
        assert bool(edge.confirmed_by) == together


def test_a_start_gives_the_frame_and_its_own_robot_goes_where_the_maps_say() -> None:
    said = four()
    for pair in ((A, B), (B, C)):
        said.align(*pair)
    said.say(B, set_start(FixedPose.from_pose(Pose2(100.0, 50.0, 1.0))))
    said.say(C, set_start(FixedPose.from_pose(Pose2())))
    said.say(D, set_start(FixedPose.from_pose(Pose2(7.0, 0.0, 0.0))))
    found = said.components()
    # D has a start, so that it lies in the same frame, if nobody has seen it.
    assert found.members(A) == [A, B, C, D]
    pose = found.pose(B)
    assert pose is not None
    assert pose.to_pose().x_m == pytest.approx(100.0, abs=1e-5)
    assert said.is_true(found, B, C, most_m=1e-4)


def test_a_reboot_does_not_turn_the_map() -> None:
    said = four()
    for pair in ((A, B), (B, C)):
        said.align(*pair)
    before = said.components().poses
    for life in (0, 2**63):
        again = ("a", life)
        said.poses[again] = said.poses[A] @ Pose2(3.0, 1.0, 2.0)
        said.say(again, name_lives(Facts(), [1]))
        said.align(again, B)
        after = said.components()
        assert after.members(A) == sorted([again, A, B, C])
        assert all(after.poses[key] == before[key] for key in (A, B, C))
        del said.poses[again]


def test_levels_are_never_aligned() -> None:
    said = four()
    said.align(A, B)
    said.say(B, set_level("2"))
    assert said.components().members(A) == [A]


def test_an_anchor_moves_what_was_aligned_by_its_submap() -> None:
    said = four()
    said.align(A, B)
    said.say(B, set_anchor("0", FixedPose.from_pose(Pose2(1.0, 2.0, math.pi / 2))))
    pose, stream = said.components().pose(B), next(s for s in said.streams() if s.key == B)
    assert pose is not None
    placed = (pose @ stream.anchor("0")).to_pose()
    truth = said.poses[A].inverse() @ said.poses[B]
    assert (placed.x_m, placed.y_m) == pytest.approx((truth.x_m, truth.y_m), abs=1e-4)


def test_places_beyond_all_bounds_are_left_alone() -> None:
    said = four()
    far = FixedPose.from_pose(Pose2(17_000_000.0, 0.0, 0.0))
    for pair in ((A, B), (B, C), (C, D)):
        said.align(*pair)
    for key in (A, B, C, D):
        said.say(key, set_anchor("0", far))
        said.components()
    said.say(A, set_start(far))
    assert set(said.components().poses) == {A, B, C, D}


@pytest.mark.parametrize("seed", range(20))
def test_peers_agree_whatever_is_said_of_alignments_and_however_it_comes(seed: int) -> None:
    assert run_schedule(seed) == []


@pytest.mark.parametrize("seed", range(40))
def test_what_is_taken_back_leaves_the_bytes_from_before(seed: int) -> None:
    assert run_revocation(seed) == []


def test_forty_robots_that_all_found_each_other_are_placed_in_a_moment() -> None:
    """All 780 pairs: by way of each third robot that would be 30 000 triangles."""
    rng = np.random.default_rng(4)
    said = Said({(f"r{k:02}", 1): place(rng) for k in range(40)})
    for pair in itertools.combinations(sorted(said.poses), 2):
        said.align(*pair)
    streams = said.streams()
    began_s = time.process_time()
    found = components_of(streams)
    assert time.process_time() - began_s < 0.6  # 0.13 s; it was 1.2 s
    assert len(found.members(("r00", 1))) == 40


def test_fifty_robots_in_a_chain_stay_one_fleet() -> None:
    """Rotations that are composed fifty times are rotations still."""
    rng = np.random.default_rng(5)
    keys = [(f"r{k:02}", 1) for k in range(50)]
    said = Said({key: place(rng) for key in keys})
    for a, b in itertools.pairwise(keys):
        said.align(a, b)
    found = said.components()
    assert found.members(keys[0]) == keys
    assert found.lost == ()
    assert said.is_true(found, keys[0], keys[-1], most_m=1e-3)


@pytest.mark.parametrize("name", ["a", "z"])
@pytest.mark.parametrize("sign", [-1, 1])
def test_who_says_that_it_is_at_the_end_of_the_world_pushes_nobody_over_it(name: str, sign: int) -> None:
    rng = np.random.default_rng(6)
    one, other, far = ("r1", 1), ("r2", 1), (name, 1)
    said = Said({one: place(rng), other: place(rng), far: Pose2()})
    said.align(one, other)
    fact = AlignmentFact("0", (*far, "0"), "committed", FixedPose(sign * (MAX_UM - 3_000_000)), weight=Weight(90_000))
    said.say(one, set_alignment(fact))
    said.say(far, confirms(one, fact))
    found = said.components()
    assert found.lost == ()
    assert found.poses[one][0] == found.poses[other][0]
    assert said.is_true(found, one, other, most_m=0.02)


def test_how_the_submaps_of_one_robot_lie_moves_no_two_others() -> None:
    """A stranger copies the maps of two robots, and says of itself how both copies lie to each other."""
    said = four()
    said.align(A, B, explained_m=20.0)
    identity = Weight(explained=200_000)
    for honest, submap in ((A, "0"), (B, "1")):
        fact = AlignmentFact(submap, (*honest, "0"), "committed", FixedPose(), weight=identity)
        said.say(D, set_alignment(fact))
        said.say(honest, confirms(D, fact))
    said.say(D, set_anchor("1", FixedPose.from_pose(Pose2(40.0, 0.0, 1.0))))
    found = said.components()
    assert [(edge.a, edge.b) for edge in found.lost] == [(D, B)]
    assert said.is_true(found, A, B)


def test_a_place_with_the_most_that_rounding_allows_is_near_itself() -> None:
    odd = FixedPose(0, 0, Q30, 92_681)
    assert near(odd, odd, (0, 0), 1, Q30 - 8)
