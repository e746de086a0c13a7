"""Keys, tokens and attachments, held against what others made of the same wire."""

import itertools
import struct

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from fleetmap.bridges import rmw_zenoh
from fleetmap.bridges.cdr import HASHES, MAP, MARKERS, TF
from fleetmap.bridges.dialect import Endpoint, Offer
from fleetmap.bridges.qos import LATCHED, LATEST, STREAM, Qos
from fleetmap.bridges.rmw_zenoh import NO_HASH, RmwZenoh
from fleetmap.bridges.ros2dds import Ros2Dds

ZID = "1f0c5f2a9d3b4e6788a1b2c3d4e5f607"
GID = bytes(range(16))
TOPICS = ["/map", "/r1/map", "/a/b/c/fleet_map_updates", "/_x/y9"]
NODES = [("/", "fleetmap"), ("/r1", "fleetmap"), ("/building/floor_2", "bridge7")]
ALL_QOS = [LATCHED, STREAM, LATEST, *itertools.starmap(Qos, itertools.product([True, False], [True, False], [1, 10]))]

PART = st.from_regex("[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True)
TOPIC = st.lists(PART, min_size=1, max_size=4).map(lambda parts: "/" + "/".join(parts))


@pytest.fixture(scope="module")
def pamoja():
    return pytest.importorskip("pamoja.ros2")


@pytest.fixture(scope="module")
def sdk():
    return pytest.importorskip("zenoh_ros2_sdk")


@pytest.mark.parametrize("domain", [0, 7, 232])
@pytest.mark.parametrize("topic", TOPICS)
@pytest.mark.parametrize("type_name", HASHES)
def test_data_goes_under_the_keys_that_two_others_have(pamoja, sdk, domain, topic, type_name):
    from zenoh_ros2_sdk.keyexpr import topic_keyexpr

    key = RmwZenoh(domain).said(topic, type_name)
    assert key == pamoja.entity_key(domain, topic, type_name, HASHES[type_name])
    assert key == topic_keyexpr(domain, topic, pamoja.dds_type_name(type_name), HASHES[type_name])
    humble = topic_keyexpr(domain, topic, pamoja.dds_type_name(type_name), NO_HASH)
    assert RmwZenoh(domain, humble=True).said(topic, type_name) == humble


@pytest.mark.parametrize("dialect", [RmwZenoh(3), RmwZenoh(3, humble=True), Ros2Dds()])
@pytest.mark.parametrize("topic", TOPICS)
def test_what_is_said_is_heard_and_tokens_are_found(dialect, topic):
    assert zenoh.KeyExpr(dialect.heard(topic, MAP)).includes(zenoh.KeyExpr(dialect.said(topic, MAP)))
    token = dialect.endpoint_token(ZID, Endpoint(True, 1, "/r1", "fleetmap", topic, MAP, LATCHED))
    assert zenoh.KeyExpr(dialect.tokens).includes(zenoh.KeyExpr(token))


def test_domains_and_types_and_topics_hear_nothing_of_each_other():
    heard = zenoh.KeyExpr(RmwZenoh(0).heard("/map", MAP))
    for key in (RmwZenoh(1).said("/map", MAP), RmwZenoh(0).said("/r1/map", MAP), RmwZenoh(0).said("/map", MARKERS)):
        assert not heard.intersects(zenoh.KeyExpr(key))
    assert not zenoh.KeyExpr(RmwZenoh(1).tokens).intersects(
        zenoh.KeyExpr(RmwZenoh(11).node_token(ZID, "/", "fleetmap"))
    )


@pytest.mark.parametrize(("namespace", "node"), NODES)
@pytest.mark.parametrize("domain", [0, 232])
def test_a_node_shows_itself_as_others_would(sdk, namespace, node, domain):
    from zenoh_ros2_sdk.entity import NodeEntity
    from zenoh_ros2_sdk.keyexpr import node_liveliness_keyexpr

    entity = NodeEntity(domain_id=domain, session_id=ZID, node_id=0, node_name=node, namespace=namespace)
    assert RmwZenoh(domain).node_token(ZID, namespace, node) == node_liveliness_keyexpr(entity)


@pytest.mark.parametrize(("namespace", "node"), NODES)
@pytest.mark.parametrize("publishes", [True, False])
@pytest.mark.parametrize("humble", [True, False])
@pytest.mark.parametrize("qos", ALL_QOS, ids=str)
def test_an_endpoint_shows_itself_as_others_would(pamoja, sdk, namespace, node, publishes, humble, qos):
    from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
    from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr
    from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability

    profile = QosProfile(
        reliability=QosReliability.RELIABLE if qos.reliable else QosReliability.BEST_EFFORT,
        durability=QosDurability.TRANSIENT_LOCAL if qos.latched else QosDurability.VOLATILE,
        history_depth=qos.depth,
    )
    assert QosProfile.decode(rmw_zenoh.qos_text(qos)) == profile
    for topic, type_name in itertools.product(TOPICS, (MAP, TF)):
        entity = EndpointEntity(
            node=NodeEntity(domain_id=4, session_id=ZID, node_id=0, node_name=node, namespace=namespace),
            entity_id=9,
            kind=EntityKind.PUBLISHER if publishes else EntityKind.SUBSCRIPTION,
            name=topic,
            dds_type_name=pamoja.dds_type_name(type_name),
            type_hash=NO_HASH if humble else HASHES[type_name],
            qos=profile.encode(),
        )
        token = RmwZenoh(4, humble=humble).endpoint_token(
            ZID, Endpoint(publishes, 9, namespace, node, topic, type_name, qos)
        )
        assert token == endpoint_liveliness_keyexpr(entity)
        assert pamoja.percent_mangle(topic) in token.split("/")


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_attachments_are_33_bytes_and_read_by_others(sequence, stamp_ns, gid):
    attachment = pytest.importorskip("zenoh_ros2_sdk.attachment").Attachment
    data = RmwZenoh().attachment(sequence, stamp_ns, gid)
    assert len(data) == 33
    assert attachment.from_bytes(data) == attachment(sequence_id=sequence, timestamp_ns=stamp_ns, gid=gid)
    assert data == attachment(sequence_id=sequence, timestamp_ns=stamp_ns, gid=gid).to_bytes()
    assert RmwZenoh().fits_attachment(data)


@pytest.mark.parametrize(
    "data", [None, b"", bytes(33), bytes(16) + b"\x10" + bytes(15), bytes(16) + b"\x10" + bytes(17), bytes(24)]
)
def test_other_attachments_are_of_another_version(data):
    assert not RmwZenoh().fits_attachment(data)
    assert Ros2Dds().fits_attachment(data)
    assert Ros2Dds().attachment(1, 2, GID) is None


def test_hashes_of_another_definition_are_refused():
    dialect = RmwZenoh(0)
    for key in (dialect.said("/map", MAP), RmwZenoh(0, humble=True).said("/map", MAP)):
        assert dialect.refusal(key, MAP) is None
    assert dialect.refusal(dialect.said("/map", MARKERS), MAP) == "hash"
    assert Ros2Dds().refusal("map", MAP) is None


@given(TOPIC, st.sampled_from(sorted(HASHES)), st.sampled_from([RmwZenoh(0), RmwZenoh(9, humble=True), Ros2Dds()]))
def test_publishers_are_found_in_their_tokens_and_subscribers_are_none(topic, type_name, dialect):
    def token(publishes):
        return dialect.endpoint_token(ZID, Endpoint(publishes, 3, "/r1", "n", topic, type_name, LATCHED))

    assert dialect.offer(token(True)) == Offer(ZID, topic, type_name)
    assert dialect.offer(token(True) + "/more/of/it") == Offer(ZID, topic, type_name)
    assert dialect.offer(token(False)) is None
    assert dialect.offer(token(True).rpartition("/")[0]) is None
    assert dialect.offer(str(dialect.node_token(ZID, "/r1", "n"))) is None


GARBAGE = st.one_of(st.text(max_size=80), st.lists(st.text(max_size=5), max_size=16).map("/".join))


@given(GARBAGE, st.sampled_from([RmwZenoh(0), Ros2Dds()]))
def test_garbage_offers_nothing(text, dialect):
    assert dialect.offer(text) is None


@given(st.lists(st.text("%§:/x_é", max_size=6), max_size=12).map("/".join))
def test_tokens_that_begin_well_are_no_error_whatever_follows(rest):
    for token, dialect in (
        (f"@ros2_lv/0/{ZID}/0/1/MP/{rest}", RmwZenoh(0)),
        (f"@/{ZID}/@ros2_lv/MP/{rest}", Ros2Dds()),
    ):
        offer = dialect.offer(token)
        assert offer is None or offer.zid == ZID


@pytest.mark.parametrize("type_name", HASHES)
def test_names_of_types_come_back_from_dds(pamoja, type_name):
    assert rmw_zenoh.dds_type(type_name) == pamoja.dds_type_name(type_name)
    assert rmw_zenoh.ros_type(rmw_zenoh.dds_type(type_name)) == type_name


def test_keys_and_tokens_of_ros2dds_are_those_of_its_sources():
    dialect = Ros2Dds()
    assert dialect.said("/map", MAP) == "map"
    assert dialect.heard("/r1/map", MAP) == "r1/map"
    publisher = Endpoint(True, 1, "/", "fleetmap", "/map", MAP, LATCHED)
    assert dialect.endpoint_token(ZID, publisher) == f"@/{ZID}/@ros2_lv/MP/map/nav_msgs§msg§OccupancyGrid/:1:1:0,1"
    subscriber = Endpoint(False, 2, "/r1", "fleetmap", "/r1/tf", TF, Qos(reliable=False, depth=100))
    assert dialect.endpoint_token(ZID, subscriber) == f"@/{ZID}/@ros2_lv/MS/r1§tf/tf2_msgs§msg§TFMessage/:0:0:0,100"
    assert dialect.node_token(ZID, "/", "fleetmap") is None


def test_tokens_of_rmw_zenoh_are_those_of_its_design_page():
    token = RmwZenoh(0).endpoint_token(ZID, Endpoint(True, 1, "/", "fleetmap", "/map", MAP, LATCHED))
    assert token == (
        f"@ros2_lv/0/{ZID}/0/1/MP/%/%/fleetmap/%map/nav_msgs::msg::dds_::OccupancyGrid_/{HASHES[MAP]}/:1:,1:,:,:,,"
    )
    assert struct.unpack("<qqB16s", RmwZenoh().attachment(7, 8, GID)) == (7, 8, 16, GID)
