"""What may be said finds its place in the merged map: far from 0 is fine, too far from each other is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exchange import commit, deliver, engine, life
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetmap.engine import Engine
from fleetmap.engine.quota import Quota
from fleetmap.engine.view import view
from fleetmap.merge import fold
from fleetmap.merge.origin import MAX_EXTENT, ORIGIN_STEPS
from fleetmap.model.errors import ConfigError
from fleetmap.model.lattice import Lattice
from fleetmap.model.mergedmap import FLEET_UM
from fleetmap.model.pose import FixedPose, Pose2
from fleetmap.model.vectormap import VectorMap


def square(size_y: int = 20, size_x: int = 30, *, low: tuple[int, int] = (0, 0), um: int = 50_000) -> VectorMap:
    y, x = low
    rows = [
        (y, x, y, x + size_x, 1),
        (y, x, y + size_y, x, 3),
        (y, x + size_x, y + size_y, x + size_x, 1),
        (y + size_y, x, y + size_y, x + size_x, 3),
    ]
    return VectorMap(Lattice(um), np.array(rows, np.int32), np.full(4, 4, np.uint8))


def fixed(x_m: float, y_m: float = 0.0, yaw_rad: float = 0.0) -> FixedPose:
    return FixedPose.from_pose(Pose2(x_m, y_m, yaw_rad))


def fleet(**starts_m: tuple[float, float]) -> list[Engine]:
    """Robots that have published a small room each, and heard each other's, whether or not they lie too far apart."""
    engines = [engine(robot, start=fixed(*start)) for robot, start in starts_m.items()]
    for one in engines:
        commit(one, submaps={"0": square()})
    for one in engines:
        deliver(one, *[other for other in engines if other is not one])
    return engines


@pytest.mark.parametrize("far_m", [6e3, 50e3])
@pytest.mark.parametrize("start", [None, (0.0, 0.0), (500e3, -500e3)])
def test_a_map_that_is_too_large_is_refused_and_nothing_is_said(
    far_m: float, start: tuple[float, float] | None
) -> None:
    one = engine("a", start=None if start is None else fixed(*start))
    one.publish("0", square())
    said = one.own.revision
    one.take_outputs()
    cells = round(far_m / 0.05)
    limit = r"5243 m"
    with pytest.raises(ConfigError, match=rf"submap='1': submap 1 extends {far_m:.0f} m; .*{limit}.*5 mm"):
        one.publish("1", square(10, cells))
    with pytest.raises(ConfigError, match=rf"submap='1': submaps 1 and 0 together .*{limit}"):
        one.publish("1", square(), anchor=fixed(far_m))
    with pytest.raises(ConfigError, match=limit):
        one.publish("1", square(low=(0, cells)))
    with pytest.raises(ConfigError, match=limit):
        one.publish("0", square(cells, 10))
    assert (one.own.revision, one.take_outputs()) == (said, [])
    assert one.publish("1", square(), anchor=fixed(5000.0))
    assert len(fold(view(one).sources)) == 8


def test_a_start_too_far_from_the_maps_of_others_is_refused_by_name() -> None:
    a, b = fleet(a=(0.0, 0.0), b=(10.0, 0.0))
    for x_m, yaw_rad in ((6e3, 0.0), (50e3, 1.0), (-500e3, 0.0)):
        with pytest.raises(
            ConfigError, match=r"start=Pose2.*submap 0 of a \(life [0-9a-f]{16}\).*5243 m.*forget\('a'\)"
        ):
            b.set_start(fixed(x_m, 0.0, yaw_rad))
    assert b.own.start == fixed(10.0)
    assert b.set_start(fixed(5.2e3, 0.0, 1.0))
    deliver(b, a)
    for one in (a, b):
        assert fold(view(one).sources).left_out == ()
    assert b.set_start(None)
    assert b.set_start(fixed(0.0))


def test_a_map_too_far_from_those_of_others_is_refused_by_name() -> None:
    a, b = engine("a", start=fixed(500e3)), engine("b", start=fixed(0.0))
    a.publish("0", square())
    deliver(a, b)
    with pytest.raises(
        ConfigError, match=r"submap='hall': together with submap 0 of a \(life [0-9a-f]{16}\) it extends 500002 m"
    ):
        b.publish("hall", square())
    assert b.publish("hall", square(), anchor=fixed(500e3 - 5.2e3))
    deliver(b, a)
    assert fold(view(a).sources).left_out == ()
    # Another level, or no start, is another component.
    for other in (engine("c", start=fixed(0.0), level="1"), engine("d")):
        deliver(a, other)
        assert other.publish("0", square())


@pytest.mark.parametrize("far_m", [8e3, 500e3])
@pytest.mark.parametrize("name", [".", "z"])
def test_a_single_robot_far_away_silences_nobody(far_m: float, name: str) -> None:
    a, b, bad = fleet(a=(500e3, 0.0), b=(500e3 + 20.0, 0.0), **{name: (500e3 + far_m, 0.0)})
    assert a.publish("0", square(21))
    assert a.set_start(fixed(500e3 - 1.0))
    deliver(a, b, bad)
    merged = [fold(view(one).sources) for one in (a, b, bad)]
    assert {m.digest for m in merged} == {merged[0].digest}
    assert [frame for frame, _ in merged[0].left_out] == [(name, life(name), "0")]
    with pytest.raises(ConfigError, match="submap 0 of a"):
        bad.publish("0", square(22))


def test_a_step_away_from_the_others_that_would_leave_the_own_map_out_is_refused() -> None:
    """While both lie far apart one of two is left out, at 0 never; who moves from there may not become that one."""
    a, z = fleet(a=(500e3, 0.0), z=(0.0, 0.0))
    assert [frame[0] for frame, _ in fold(view(z).sources).left_out] == ["a"]
    with pytest.raises(ConfigError, match="submap 0 of a"):
        z.set_start(fixed(600e3))
    assert z.set_start(fixed(500e3 - 5.0))
    deliver(z, a)
    assert fold(view(a).sources).left_out == ()


def test_maps_that_wait_for_the_quota_count() -> None:
    a = engine("a", start=fixed(0.0))
    a.publish("0", square())
    b = engine("b", start=fixed(0.0), quota=Quota(max_rate_hz=0.1))
    deliver(a, b)
    assert b.publish("0", square())
    assert b.publish("1", square(), anchor=fixed(5000.0))
    assert b.own.submaps.keys() == {"0"}
    with pytest.raises(ConfigError, match=r"submap 0 of a"):
        b.set_start(fixed(1000.0))
    with pytest.raises(ConfigError, match=r"submaps 2 and 1"):
        b.publish("2", square(), anchor=fixed(-1000.0))
    assert b.set_start(fixed(-1000.0))


def test_together_beyond_what_poses_hold_is_refused() -> None:
    one = engine("a", start=fixed(10e6))
    with pytest.raises(ConfigError, match=r"start and anchor together.*17592186 m"):
        one.publish("0", square(), anchor=fixed(10e6))
    far = VectorMap(Lattice(50_000, fixed(10e6)), square().edges, square().thickness)
    with pytest.raises(ConfigError, match=r"start, anchor and origin together.*17592186 m"):
        one.publish("0", far)
    assert one.publish("0", far, anchor=fixed(-10e6))
    with pytest.raises(ConfigError, match="17592186 m"):
        one.set_start(fixed(0.0, -10e6, math.pi / 2))  # turned: the anchor adds 10 000 km along y


def test_a_long_map_may_lie_across_its_own_axes() -> None:
    """Corners around a diagonal corridor span more than its edges do once it is turned."""
    k = np.arange(0, 100_001, 1000)
    steps = [(a, a, b, b, 5) for a, b in zip(k, k[1:], strict=False)]
    back = [(a + 20, a, b + 20, b, 7) for a, b in zip(k, k[1:], strict=False)]
    ends = [(0, 0, 20, 0, 5), (100_000, 100_000, 100_020, 100_000, 7)]
    corridor = VectorMap(Lattice(50_000), np.array(steps + back + ends, np.int32), np.full(len(steps) * 2 + 2, 4))
    with pytest.raises(ConfigError, match="extends 7072 m"):
        engine("a", start=fixed(0.0, 0.0, -math.pi / 4)).publish("0", corridor)
    # A third shorter, so that it fits: the corners of its box would reach over 6600 m and more.
    shorter = VectorMap(Lattice(33_000), corridor.edges, corridor.thickness)
    one = engine("a", start=fixed(0.0, 0.0, -math.pi / 4))
    assert one.publish("0", shorter)
    assert fold(view(one).sources).left_out == ()


def test_the_limit_is_exact() -> None:
    cells = MAX_EXTENT * FLEET_UM // 5_000
    for place in (0.0, 123_456.789):
        one = engine("a", start=fixed(place))
        assert one.publish("0", square(9, cells, um=5_000))
        assert fold(view(one).sources).left_out == ()
        with pytest.raises(ConfigError):
            one.publish("0", square(9, cells + 1, um=5_000, low=(0, -1)))


places = st.integers(-2 * MAX_EXTENT, 2 * MAX_EXTENT) | st.sampled_from(
    [0, MAX_EXTENT - 300, MAX_EXTENT - 299, ORIGIN_STEPS // 2, MAX_EXTENT // 2, -MAX_EXTENT // 2]
)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([0, 10**8]),
    st.lists(st.tuples(st.sampled_from("abcd"), st.sampled_from("01"), places, places), min_size=1, max_size=12),
)
def test_what_a_publish_takes_the_merged_map_has(far: int, steps: list[tuple[str, str, int, int]]) -> None:
    """Robots that hear of each other before they speak never push each other's maps out."""
    engines = {robot: engine(robot, start=FixedPose(far * FLEET_UM, 0)) for robot in "abcd"}
    taken = 0
    for robot, submap, y, x in steps:
        one = engines[robot]
        try:
            taken += one.publish(submap, square(), anchor=FixedPose(x * FLEET_UM, y * FLEET_UM))
        except ConfigError as error:
            assert "5243 m" in str(error)
        deliver(one, *[other for other in engines.values() if other is not one])
        merged = fold(view(one).sources)
        assert merged.left_out == ()
        assert len(merged) >= 4
    assert taken >= 1
