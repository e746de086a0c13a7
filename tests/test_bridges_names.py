"""Names of ROS: what ROS refuses is refused here, and relative names mean what they mean there."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetmap.bridges import names
from fleetmap.model.errors import ConfigError

PART = st.from_regex("[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True)
TOPIC = st.lists(PART, min_size=1, max_size=4).map(lambda parts: "/" + "/".join(parts))
NAMESPACE = st.one_of(st.just("/"), TOPIC)


@pytest.fixture(scope="module")
def pamoja():
    return pytest.importorskip("pamoja.ros2")


@pytest.mark.parametrize(
    ("topic", "namespace", "whole"),
    [
        ("map", "/", "/map"),
        ("map", "/r1", "/r1/map"),
        ("a/map", "/r1/x", "/r1/x/a/map"),
        ("/map", "/r1", "/map"),
        ("~/map", "/", "/node/map"),
        ("~/a/map", "/r1", "/r1/node/a/map"),
    ],
)
def test_topics_are_resolved_as_in_ros(topic, namespace, whole):
    assert names.resolve(topic, namespace=namespace, node="node") == whole


@given(TOPIC, NAMESPACE, PART, st.sampled_from(["/", "~/", ""]))
def test_whole_names_are_names_that_ros_takes(pamoja, topic, namespace, node, begins):
    whole = names.resolve(begins + topic[1:], namespace=names.check_namespace("namespace", namespace), node=node)
    assert names.check_topic("map_topic", whole) == whole
    # Of two underscores in a row ROS's design says no, and its validators yes.
    assert pamoja.is_fully_qualified(whole) or "__" in whole


@given(st.text("ab9_/~-. {}é\n", max_size=7))
def test_names_that_ros_refuses_are_refused(pamoja, text):
    try:
        names.check_topic("map_topic", text)
    except ConfigError as error:
        assert error.option == "map_topic"
    else:
        assert pamoja.is_valid_name(text) or "__" in text


NO_PARTS = ["9map", "a b", "a-b", "map\n", "é", "{node}", 5, None, b"map"]


@pytest.mark.parametrize("value", [*NO_PARTS, "", "/", "~", "~map", "map/", "a//b", "//a", "a/9b", "a/~/b"])
def test_what_is_no_topic_is_refused(value):
    with pytest.raises(ConfigError, match=r"tf_topic=.*expected a topic"):
        names.check_topic("tf_topic", value)


@pytest.mark.parametrize("value", [*NO_PARTS, "//", "/r1/", "~", "~/a", "/a//b", "//a", "/a/9b"])
def test_what_is_no_namespace_is_refused(value):
    with pytest.raises(ConfigError, match=r"namespace=.*expected a namespace"):
        names.check_namespace("namespace", value)


@pytest.mark.parametrize("value", [*NO_PARTS, "", "/", "a/b", "~"])
def test_what_is_no_node_is_refused(value):
    with pytest.raises(ConfigError, match="node="):
        names.check_node("node", value)


@pytest.mark.parametrize("value", ["", "/", "//", "a" * 256, "a\x00b", None, 5])
def test_what_is_no_frame_is_refused(value):
    with pytest.raises(ConfigError, match="base_frame="):
        names.check_frame("base_frame", value)


def test_names_that_may_be_empty_are_and_slashes_are_put_right():
    assert names.check_topic("tf_topic", "", may_be_empty=True) == ""
    assert names.check_frame("map_frame", "/", may_be_empty=True) == ""
    assert names.check_frame("map_frame", "/r1/map") == "r1/map"
    assert [names.check_namespace("namespace", given) for given in ("", "/", "r1", "/r1/x")] == [
        "/",
        "/",
        "/r1",
        "/r1/x",
    ]


def test_topics_longer_than_ros_takes_are_refused():
    # rmw_validate_full_topic_name: at most 247 characters (RMW_TOPIC_MAX_NAME_LENGTH).
    assert names.check_topic("map_topic", "/" + "a" * 246)
    with pytest.raises(ConfigError):
        names.check_topic("map_topic", "/" + "a" * 247)
