"""The robot's drive, its stop, and one robot that explores alone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fleetmap.model.pose import Pose2
from fleetmap.sims.agent import STEP_S, Agent
from fleetmap.sims.explore import BLACKLIST_S, Explorer, Teammate
from fleetmap.sims.lidar import Lidar
from fleetmap.sims.robot import Drive, Robot
from fleetmap.sims.view import MARGINS_M, View, look
from fleetmap.sims.worlds import World, choose_starts, make_world

START = Pose2(2.0, 2.0, 0.6)


def room(size: int = 120) -> World:
    solid = np.ones((size, size), bool)
    solid[3:-3, 3:-3] = False
    return World(solid)


def robot(world: World, start: Pose2 = START, *, seed: int = 0, noise_m: float = 0.01) -> Robot:
    return Robot(world, start, Lidar(), Drive(pose_noise_m=noise_m), np.random.default_rng(seed))


def drive(body: Robot, path_world: list[tuple[float, float]], steps: int = 400) -> list[Pose2]:
    body.path_xy = body.start.inverse().apply(path_world)
    poses = [body.pose]
    for _ in range(steps):
        body.step(STEP_S)
        poses.append(body.pose)
    return poses


def test_a_robot_follows_its_path_within_the_least_margin() -> None:
    corners = [(2.0, 2.0), (4.0, 2.2), (4.0, 4.5), (1.2, 4.0)]
    poses = drive(robot(room()), corners)
    assert math.dist((poses[-1].x_m, poses[-1].y_m), corners[-1]) < 0.1
    for pose in poses:
        off = min(to_segment((pose.x_m, pose.y_m), a, b) for a, b in zip(corners[:-1], corners[1:], strict=True))
        assert off < 0.06


def to_segment(p, a, b) -> float:
    (px, py), (ax, ay), (bx, by) = p, a, b
    t = max(0.0, min(1.0, ((px - ax) * (bx - ax) + (py - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)))
    return math.hypot(px - ax - t * (bx - ax), py - ay - t * (by - ay))


def test_a_robot_keeps_its_speeds_and_counts_its_way() -> None:
    body = robot(room())
    poses = drive(body, [(4.5, 4.5), (2.0, 4.5)])
    way = [math.dist((a.x_m, a.y_m), (b.x_m, b.y_m)) for a, b in zip(poses[:-1], poses[1:], strict=True)]
    assert max(way) <= body.drive.speed_mps * STEP_S + 1e-9
    assert body.distance_m == pytest.approx(sum(way), rel=1e-3)
    turns = [abs(math.remainder(b.yaw_rad - a.yaw_rad, math.tau)) for a, b in zip(poses[:-1], poses[1:], strict=True)]
    assert max(turns) <= body.drive.yaw_rate_radps * STEP_S + 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_a_path_through_a_wall_ends_before_it_without_a_contact(seed: int) -> None:
    body = robot(room(), seed=seed)
    drive(body, [(9.0, 2.5)])
    assert body.stopped
    assert body.collisions == 0
    assert 5.85 - body.pose.x_m < 0.35


def test_a_robot_that_sees_nothing_touches_the_wall_once_and_stays_out_of_it() -> None:
    body = robot(room())
    body._near_xy = np.zeros((0, 2))
    body.scan = lambda: setattr(body, "_scanned_at", body.pose)  # type: ignore[method-assign]
    drive(body, [(9.0, 2.0)])
    assert body.collisions == 1
    assert 5.85 - body.pose.x_m >= body.drive.radius_m - 1e-9


def test_what_the_own_grid_knows_wins_over_the_merged_map() -> None:
    body = robot(room())
    for _ in range(3):
        body.scan()
    view = look(None, body.mapper, T_fleet_robot=START, radius_m=0.2)
    assert view.states_yx[view.cell((3.0, 3.0))] == 0
    assert view.price_yx[view.cell((3.0, 3.0))] == 1
    # Prices rise towards the wall and end before it.
    prices = [int(view.price_yx[view.cell((5.85 - gap, 3.0))]) for gap in (0.5, 0.12)]
    assert prices == [MARGINS_M[-1][1], 0]


def test_a_path_is_as_cheap_as_the_field_says_and_keeps_clear_of_walls() -> None:
    states = np.zeros((100, 100), np.uint8)
    states[50, 10:] = 1
    view = View(states, (0, 0), 0.2, 0.05)
    costs = view.costs_from((4.0, 1.0))
    path = view.path_to(costs, view.cell((4.0, 4.0)))
    assert len(path) < 12
    wall = np.column_stack([np.arange(10, 100) + 0.5, np.full(90, 50.5)]) * 0.05
    for a, b in zip(path[:-1], path[1:], strict=True):
        for t in np.linspace(0, 1, 50):
            assert np.hypot(*(wall - (a + t * (b - a))).T).min() > 0.2 + MARGINS_M[0][0]
    assert 4.5 < np.hypot(*np.diff(path, axis=0).T).sum() < 9.0


def two_ends() -> View:
    """A corridor with frontiers at both ends."""
    states = np.full((60, 300), 2, np.uint8)
    states[18:42] = 1
    states[20:40] = 0
    states[:, :10] = states[:, -10:] = 2
    return View(states, (0, 0), 0.2, 0.05)


def test_two_robots_go_to_different_frontiers_and_a_third_waits_for_none_to_be_left() -> None:
    view = two_ends()
    here, there = (7.0, 1.5), (8.0, 1.5)
    first = Explorer("a").choose(view, here, teammates=[Teammate("b", there)], now_s=0.0)
    second = Explorer("b").choose(view, there, teammates=[Teammate("a", here, first.frontier_xy)], now_s=0.0)
    assert first.frontier_xy[0] < 1.0
    assert second.frontier_xy[0] > 14.0
    third = Explorer("c")
    mates = [Teammate("a", here, first.frontier_xy), Teammate("b", there, second.frontier_xy)]
    assert third.choose(view, (7.5, 1.5), teammates=mates, now_s=0.0) is None
    assert third.waiting


def test_a_goal_that_led_to_nothing_is_left_out_for_a_while_and_longer_the_second_time() -> None:
    explorer, place = Explorer("a"), (1.0, 2.0)
    explorer.failed(place, now_s=10.0)
    assert explorer.blacklisted((1.2, 2.2), now_s=10.0 + BLACKLIST_S - 1)
    assert not explorer.blacklisted((3.0, 2.0), now_s=11.0)
    assert not explorer.blacklisted(place, now_s=10.0 + BLACKLIST_S + 1)
    explorer.failed(place, now_s=100.0)
    assert explorer.blacklisted(place, now_s=100.0 + 2 * BLACKLIST_S - 1)


def test_a_place_that_a_teammate_has_been_at_is_not_visited_again() -> None:
    view, explorer = two_ends(), Explorer("z")
    left, right = (0.55, 1.5), (14.45, 1.5)
    explorer.choose(view, (7.0, 1.5), teammates=[Teammate("a", (0.9, 1.5), left)], now_s=0.0)
    choice = explorer.choose(view, (3.0, 1.5), teammates=[Teammate("a", (0.7, 1.5))], now_s=3.0)
    assert choice is not None
    assert math.dist(choice.frontier_xy, right) < 1.0


@pytest.mark.parametrize("name", ["maze", "office", "unstructured"])
def test_one_robot_alone_explores_all_of_a_small_world_without_a_contact(name: str) -> None:
    world = make_world(name, size_m=10, seed=2)
    start = choose_starts(world, 1, radius_m=0.2, rng=np.random.default_rng(2))[0]
    body = robot(world, start, seed=3)
    agent = Agent(body, T_fleet_robot=start, explorer=Explorer("r0"))
    idle = 0
    while idle < 3 and agent.now_s < 600:
        until_s = agent.now_s + 3.0
        while agent.now_s < until_s - 1e-6:
            agent.advance(until_s)
            if agent.publish_due:
                agent.published()
        idle = idle + 1 if agent.idle else 0
    assert idle == 3
    assert body.collisions == 0
    reachable = world.reachable([start], radius_m=0.2)
    xy = start.inverse().apply(world.centres_xy(np.argwhere(reachable)))
    cells = np.floor(xy[:, ::-1] / 0.05).astype(int) - body.mapper.low_yx
    assert (body.mapper.states_yx[cells[:, 0], cells[:, 1]] == 0).mean() >= 0.99
