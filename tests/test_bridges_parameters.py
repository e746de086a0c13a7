"""Parameter files as ROS's users write them: whom they are for, and what is wrong with them in words."""

import pytest

from fleetmap.bridges.parameters import read_parameters
from fleetmap.model.errors import ConfigError


@pytest.fixture
def parameters(tmp_path):
    """What a file of that text has for /r1/fleetmap, or another node."""

    def read(text, node="fleetmap", namespace="/r1"):
        (tmp_path / "p.yaml").write_text(text)
        return read_parameters(tmp_path / "p.yaml", node=node, namespace=namespace)

    return read


MATCHING = ["/**", "fleetmap", "/r1/fleetmap", "r1/fleetmap", "/*/fleetmap", "/**/fleetmap", "/r1/*", "/r1/**", "/*/*"]
OTHER = [
    "/*",
    "/fleetmap/r1",
    "other",
    "/r2/fleetmap",
    "/r1",
    "/r1/fleetmap/x",
    "/*/*/fleetmap",
    "/r1/*/fleetmap",
    "r1",
]


@pytest.mark.parametrize("name", MATCHING)
def test_nodes_are_named_as_in_ros(parameters, name):
    assert parameters(f'"{name}": {{ros__parameters: {{robot: r1}}}}') == {"robot": "r1"}


@pytest.mark.parametrize("name", OTHER)
def test_other_nodes_parameters_are_not_taken_and_named(parameters, name):
    with pytest.raises(ConfigError) as caught:
        parameters(f'"{name}": {{ros__parameters: {{robot: r1}}}}')
    assert "has no parameters for /r1/fleetmap" in caught.value.reason
    assert f"found /{name.strip('/')}. --namespace" in caught.value.reason


@pytest.mark.parametrize("name", ["/**", "fleetmap", "/fleetmap", "/*", "/**/fleetmap"])
def test_in_the_root_there_is_no_namespace_to_match(parameters, name):
    assert parameters(f'"{name}": {{ros__parameters: {{level: 0}}}}', namespace="/") == {"level": 0}


def test_namespaces_may_be_nested(parameters):
    text = "a: {b: {fleetmap: {ros__parameters: {robot: x}}, other: {ros__parameters: {robot: y}}}}"
    assert parameters(text, namespace="/a/b") == {"robot": "x"}
    assert parameters(text, node="other", namespace="/a/b") == {"robot": "y"}


@pytest.mark.parametrize("exact", ["fleetmap", "/r1/fleetmap", "/*/fleetmap"])
def test_what_stands_later_and_more_exactly_wins(parameters, exact):
    text = f"""
/**: {{ros__parameters: {{robot: all, fleet: f}}}}
"{exact}": {{ros__parameters: {{robot: mine, level: 1}}}}
"""
    assert parameters(text) == {"robot": "mine", "fleet": "f", "level": 1}


def test_what_stands_later_wins_over_what_is_more_exact(parameters):
    # So it is in rclcpp; in rclpy the exact name wins wherever it stands.
    text = """
/r1/fleetmap: {ros__parameters: {robot: mine}}
/**: {ros__parameters: {robot: all}}
"""
    assert parameters(text) == {"robot": "all"}


def test_a_tree_that_holds_itself_has_an_end(parameters):
    assert parameters("fleetmap: &x {ros__parameters: {robot: r1}, inner: *x}") == {"robot": "r1"}


def test_of_two_that_are_as_exact_the_later_wins(parameters):
    text = """
/*/fleetmap: {ros__parameters: {robot: first}}
/r1/*: {ros__parameters: {robot: second}}
"""
    assert parameters(text) == {"robot": "second"}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "fleetmap: {ros__parameters: {robott: r1}}",
            "robott: there is no such parameter; expected one of robot, fleet",
        ),
        ("fleetmap: {robot: r1}", "found no ros__parameters at all"),
        ("fleetmap: {ros__parameters: {}}", "has no parameters for /r1/fleetmap"),
        ("fleetmap: {ros__parameters: [1]}", "/fleetmap: ros__parameters: expected {name: value}"),
        ("fleetmap: {ros__parameters:}", "/fleetmap: ros__parameters: expected {name: value}"),
        ("a: [", "no YAML"),
        ("a: !!python/object:os.system {}", "no YAML"),
        ("", "expected {node: {ros__parameters"),
        ("[1, 2]", "expected {node: {ros__parameters"),
        # Of yaml.safe_load comes a ValueError here, which is no YAMLError.
        ("fleetmap: {ros__parameters: {robot: 2026-13-45}}", "no YAML"),
    ],
)
def test_what_is_wrong_with_a_file_is_named(parameters, text, told):
    with pytest.raises(ConfigError) as caught:
        parameters(text)
    assert caught.value.option == "params_file"
    assert told in str(caught.value)


def test_files_that_cannot_be_read_are_named(tmp_path):
    (tmp_path / "latin1.yaml").write_bytes(b"a: \xe9\xff")
    for path in (tmp_path / "missing.yaml", tmp_path, tmp_path / "latin1.yaml"):
        with pytest.raises(ConfigError, match=r"params_file=.*can't be read"):
            read_parameters(path, node="fleetmap", namespace="/")
