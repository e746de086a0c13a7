"""Options of the bridge: what is wrong is refused and named, and what YAML makes of values is put right."""

import json

import pytest

from fleetmap.bridges.options import BridgeOptions, WireOptions, checked, options_of, parse_start
from fleetmap.bridges.rmw_zenoh import RmwZenoh
from fleetmap.bridges.ros2dds import Ros2Dds
from fleetmap.model.errors import ConfigError
from fleetmap.model.pose import FixedPose, Pose2

TOPICS = ["map_topic", "fleet_map_topic"]
TOPICS_OR_NONE = [
    "map_updates_topic",
    "tf_topic",
    "tf_static_topic",
    "pose_topic",
    "markers_topic",
    "teammates_topic",
    "diagnostics_topic",
]
RATES = ["map_rate_hz", "fleet_map_rate_hz", "tf_rate_hz"]

WRONG_OF_BRIDGE = [
    *(("robot", value) for value in ("", "a b", "é", "r" * 65, 7)),
    *(("fleet", value) for value in ("", "a/b", None)),
    *(("level", value) for value in ("", "first floor", 0)),
    *(("start", value) for value in ("1,2", "1,2,3,4", "x,y,z", "nan,0,0", "inf,0,0", ",,", [1, 2], [1, 2, "?"])),
    # Here a TypeError comes out; and the last one, farther than poses reach, is refused as "pose".
    *(("start", value) for value in (5, None, "1e9,0,0")),
    *(("connect", value) for value in (["udp/1.2.3.4:7"], ["tcp/1.2.3.4"], [5], "tcp/1.2.3.4:7447")),
    *(("listen", value) for value in (["tcp://0.0.0.0:7447"], ["tcp/0.0.0.0:99999"])),
    ("profile", "wide"),
    ("config", "/nowhere/zenoh.json"),
    *(("budget_bps", value) for value in (-1, float("nan"), float("inf"), "5", True)),
    *((name, value) for name in RATES for value in (0, -1, 1001, float("nan"), "2", None, True)),
    # Not checked before the first map comes.
    *(("free_below", value) for value in (0, -5, 101, float("nan"), "20")),
    *(("occupied_above", value) for value in (100, -1, float("nan"), "64", 0.64, 10)),
    *((name, value) for name in TOPICS for value in ("", "9map", "a b", "map/", None)),
    *((name, value) for name in TOPICS_OR_NONE for value in ("9map", "~", "a//b", None)),
    *((name, value) for name in ("base_frame", "fleet_frame") for value in ("", "/", "f" * 256, None)),
    *(("map_frame", value) for value in ("f" * 256, 5)),
    *(("resolution_m", value) for value in (-0.05, 0.001, float("nan"), "0.05")),
    *((name, value) for name in ("fleet_map_updates", "publish_tf") for value in (1, "true", None)),
]
WRONG_OF_WIRE = [
    *(("via", value) for value in ("dds", "", None)),
    *(("ros_endpoint", value) for value in ("", "7447", "udp/1.2.3.4:7447", "tcp/1.2.3.4:0", None)),
    *(("ros_listen", value) for value in ("7447", "tcp/1.2.3.4")),
    *(("domain", value) for value in (-2, 233, 0.5, "0", True, None)),
    *(("namespace", value) for value in ("/9", "r1/", None)),
    *(("node", value) for value in ("", "a/b", "9n", None)),
    # Not checked.
    *((name, value) for name in ("humble", "use_sim_time") for value in ("true", 1, None)),
]


@pytest.fixture(autouse=True)
def no_domain(monkeypatch):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)


@pytest.mark.parametrize(("name", "value"), WRONG_OF_BRIDGE)
def test_a_wrong_option_of_the_bridge_is_refused_and_named(name, value):
    with pytest.raises(ConfigError) as caught:
        BridgeOptions(**{"robot": "r1", name: value})
    assert name in caught.value.option


@pytest.mark.parametrize(("name", "value"), WRONG_OF_WIRE)
def test_a_wrong_option_of_the_wire_is_refused_and_named(name, value):
    with pytest.raises(ConfigError) as caught:
        WireOptions(**{name: value})
    assert name in caught.value.option


@pytest.mark.parametrize("name", TOPICS_OR_NONE)
def test_topics_that_may_be_none_may_be_empty(name):
    assert BridgeOptions("r1", **{name: ""})


def test_a_robot_joins_with_what_the_options_say(tmp_path):
    (tmp_path / "z.json").write_text(json.dumps({"scouting/delay": 5}))
    options = BridgeOptions(
        "r1",
        fleet="f",
        level="2",
        start="2, 1,1.5",
        connect=["tcp/10.0.0.2:7448"],
        listen=["tcp/0.0.0.0:0"],
        profile="narrow",
        config=str(tmp_path / "z.json"),
        budget_bps=1000,
        fleet_map_rate_hz=4,
    ).join_options()
    assert (options.robot, options.fleet, options.level, options.profile) == ("r1", "f", "2", "narrow")
    assert (options.connect, options.listen) == (("tcp/10.0.0.2:7448",), ("tcp/0.0.0.0:0",))
    assert options.start == Pose2(2.0, 1.0, 1.5)
    assert (options.config, options.budget_Bps, options.fold_interval_s) == ({"scouting/delay": 5}, 1000, 0.25)
    assert BridgeOptions("r1").join_options().budget_Bps is None


@pytest.mark.parametrize(
    ("start", "pose"),
    [
        ("", None),
        ("  ", None),
        ([], None),
        ((), None),
        ("2,1,1.5708", Pose2(2, 1, 1.5708)),
        (" -2.5 , 1e1 ,0", Pose2(-2.5, 10, 0)),
        ([2, 1.5, -3], Pose2(2, 1.5, -3)),
        (("1", 2, "3"), Pose2(1, 2, 3)),
    ],
)
def test_starts_are_read_as_users_write_them(start, pose):
    assert parse_start(start) == pose
    assert BridgeOptions("r1", start=start).join_options().start in (pose, pose and FixedPose.from_pose(pose))


@pytest.mark.parametrize(
    "start", ["1", "1,2,", "1;2;3", "1,2,1e999", [True, 0, 0], ["", "", ""], [None] * 3, "1,x,3", "1,2,3,x"]
)
def test_what_is_no_start_is_refused_with_what_one_is(start):
    with pytest.raises(ConfigError, match=r"expected X,Y,YAW in metres and radians, as 2,1,1\.5708"):
        parse_start(start)


@pytest.mark.parametrize("kind", [BridgeOptions, WireOptions])
def test_each_option_is_explained_in_a_sentence(kind):
    assert {f.name for f in options_of(kind)} == set(kind.__dataclass_fields__) - {"_"}
    assert all(len(f.metadata["about"]) > 5 for f in options_of(kind))


def test_no_option_is_of_the_bridge_and_of_the_wire():
    assert not {f.name for f in options_of(BridgeOptions)} & {f.name for f in options_of(WireOptions)}


@pytest.mark.parametrize(("variable", "domain"), [(None, 0), ("", 0), ("0", 0), ("42", 42), ("232", 232), ("007", 7)])
def test_the_domain_is_that_of_the_environment_unless_one_is_given(monkeypatch, variable, domain):
    if variable is not None:
        monkeypatch.setenv("ROS_DOMAIN_ID", variable)
    assert WireOptions().dialect() == RmwZenoh(domain)
    assert WireOptions(domain=9, humble=True).dialect() == RmwZenoh(9, humble=True)


@pytest.mark.parametrize("variable", ["233", "-1", "x", "1.5", " ", "99999999999999999999"])
def test_a_domain_of_the_environment_that_is_none_is_named(monkeypatch, variable):
    monkeypatch.setenv("ROS_DOMAIN_ID", variable)
    with pytest.raises(ConfigError, match="ROS_DOMAIN_ID, 0 to 232"):
        WireOptions()
    assert WireOptions(via="ros2dds").dialect() == Ros2Dds()


@pytest.mark.parametrize(
    ("kind", "name", "value", "expected"),
    [
        (BridgeOptions, "map_rate_hz", 2, 2.0),
        (BridgeOptions, "level", 0, "0"),
        (BridgeOptions, "robot", 7, "7"),
        (BridgeOptions, "connect", "tcp/a:1", ["tcp/a:1"]),
        (BridgeOptions, "connect", ["", "tcp/a:1"], ["tcp/a:1"]),
        (BridgeOptions, "listen", "", []),
        (BridgeOptions, "start", [1, 2.0, 3], [1, 2.0, 3]),
        (BridgeOptions, "start", "1,2,3", "1,2,3"),
        (BridgeOptions, "publish_tf", False, False),
        (WireOptions, "domain", 5.0, 5),
    ],
)
def test_values_of_yaml_become_those_of_the_option(kind, name, value, expected):
    found = checked(kind, {name: value, "of another kind": 1})
    assert found == {name: expected}
    assert type(found[name]) is type(expected)


@pytest.mark.parametrize(
    ("kind", "name", "value", "told"),
    [
        (BridgeOptions, "map_rate_hz", "2", "a number"),
        (BridgeOptions, "map_rate_hz", True, "a number"),
        (BridgeOptions, "map_rate_hz", float("inf"), "a number"),
        (BridgeOptions, "level", 1.5, "text"),
        (BridgeOptions, "level", True, "text"),
        (BridgeOptions, "level", None, "text"),
        (BridgeOptions, "map_topic", ["map"], "text"),
        (BridgeOptions, "connect", 5, "a list of text"),
        (BridgeOptions, "connect", ["tcp/a:1", 5], "a list of text"),
        (BridgeOptions, "connect", {"a": "b"}, "a list of text"),
        (BridgeOptions, "start", 5, "text"),
        (BridgeOptions, "start", {"x": 1}, "text"),
        (BridgeOptions, "publish_tf", "true", "true or false"),
        (BridgeOptions, "publish_tf", 1, "true or false"),
        (WireOptions, "domain", 0.5, "a whole number"),
        (WireOptions, "domain", "0", "a whole number"),
        (WireOptions, "use_sim_time", 0, "true or false"),
    ],
)
def test_values_of_other_types_are_refused(kind, name, value, told):
    with pytest.raises(ConfigError, match=f"^{name}=.*expected {told}"):
        checked(kind, {name: value})
