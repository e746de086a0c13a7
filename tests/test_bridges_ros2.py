"""The bridge over real Zenoh, against an implementation of rmw_zenoh's wire that nobody here wrote."""

import asyncio
import os
import random
import socket
import struct
import time
from contextlib import asynccontextmanager
from functools import partial

import numpy as np
import pytest
import zenoh
import zenoh_ros2_sdk.discovery as discovery
from conftest import TIMEOUT_FACTOR, two_rooms
from ros_sdk import LATCHED, Sdk, ros_router, say_grid

import fleetmap
from fleetmap.bridges import cdr, grids, said
from fleetmap.bridges.dialect import Endpoint
from fleetmap.bridges.options import BridgeOptions
from fleetmap.bridges.qos import LATCHED as LATCHED_QOS
from fleetmap.bridges.rmw_zenoh import RmwZenoh
from fleetmap.bridges.ros2 import Bridge
from fleetmap.bridges.ros2dds import Ros2Dds
from fleetmap.bridges.zenoh_port import ZenohPort
from fleetmap.model.lattice import OCCUPIED
from fleetmap.model.pose import Pose2
from fleetmap.peer.join import make_peer
from fleetmap.peer.keys import zenoh_config
from fleetmap.peer.memory_link import LoopClock, MemoryHub
from fleetmap.peer.ports import free_port

WAIT_S = 10.0 * TIMEOUT_FACTOR


@pytest.fixture
def port():
    return free_port("127.0.0.1")


@pytest.fixture
def ros(port):
    with ros_router(f"tcp/127.0.0.1:{port}"):
        yield port


async def until(done, *, wait_s=WAIT_S):
    async with asyncio.timeout(wait_s):
        while not done():  # noqa: ASYNC110 - what is waited for is on the other side of a wire
            await asyncio.sleep(0.02)


def zenoh_port(port, dialect=None, **options):
    return ZenohPort(dialect or RmwZenoh(), endpoint=f"tcp/127.0.0.1:{port}", **options)


@asynccontextmanager
async def bridged(port, robot="r1", *, hub=None, dialect=None, wire=None, **options):
    """A bridge at work, its robot in a fleet of its own unless there is a hub."""
    hub = hub or MemoryHub(LoopClock())
    made = BridgeOptions(robot, **{"start": "0,0,0", "profile": "local", "fleet_map_rate_hz": 20.0, **options})
    join = made.join_options()
    peer = fleetmap.join(robot, start=join.start, link=hub.link(robot), fold_interval_s=0.02, baselines=False)
    async with peer:
        bridge = Bridge(peer, port if isinstance(port, ZenohPort) else zenoh_port(port, dialect, **(wire or {})), made)
        running = asyncio.create_task(bridge.run())
        try:
            yield bridge
            assert not running.done(), running
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


def occupied(message):
    return int((np.asarray(getattr(message, "data", message)) == 100).sum())


async def test_a_map_comes_in_and_the_fleet_map_is_there_for_who_comes_later(ros):
    grid = two_rooms()
    with Sdk(ros) as sdk:
        async with bridged(ros, start="3,0,1.5707963267948966") as bridge:
            publisher = sdk.publisher("/map", cdr.MAP)
            await until(lambda: bridge.offered == ["/map"])
            say_grid(publisher, grid)
            await until(lambda: bridge.saying.maps_out)
            began_s = time.monotonic()
            late = await asyncio.to_thread(sdk.heard, "/fleet_map", cdr.MAP, qos=LATCHED)
            lines = await asyncio.to_thread(sdk.heard, "/fleet_walls", cdr.MARKERS, qos=LATCHED)
            frames = sdk.heard("/tf", cdr.TF)
            await until(lambda: late and lines and frames)
            assert late[0][0] - began_s < 5.0
    message = late[0][1]
    assert message.header.frame_id == "fleet"
    # Turned by a quarter: the same walls, but for their corners.
    assert occupied(message) == pytest.approx((grid.states_yx() == OCCUPIED).sum(), rel=0.02)
    walls = {marker.ns: marker for marker in lines[0][1].markers}
    assert len(walls["walls"].points) == 2 * 16
    assert walls["walls"].header.frame_id == "fleet"
    shown = frames[0][1].transforms[0]
    assert (shown.header.frame_id, shown.child_frame_id) == ("fleet", "map")
    assert shown.transform.translation.x == pytest.approx(3.0)
    assert shown.transform.rotation.z == pytest.approx(np.sqrt(0.5))


async def test_others_list_its_topics_with_type_hash_and_qos(ros):
    async with bridged(ros, wire={"namespace": "/r1"}) as bridge:
        await until(lambda: bridge.port._session is not None)

        with Sdk(ros):
            listed = dict(await asyncio.to_thread(discovery.get_topic_names_and_types, 0, router_port=ros))
            about = await asyncio.to_thread(
                partial(discovery.get_topic_info, "/r1/fleet_map", 0, router_port=ros, verbose=True)
            )
    assert listed == {
        "/r1/fleet_map": [cdr.MAP],
        "/r1/fleet_walls": [cdr.MARKERS],
        "/r1/fleet_robots": [cdr.POSES],
        "/r1/fleet_robots_names": [cdr.MARKERS],
        "/r1/map": [cdr.MAP],
        "/r1/map_updates": [cdr.MAP_UPDATE],
        "/diagnostics": [cdr.DIAGNOSTICS],
        "/tf": [cdr.TF],
        "/tf_static": [cdr.TF],
    }
    (shown,) = about.publishers
    assert (shown.node_name, shown.node_namespace) == ("fleetmap", "/r1")
    assert (shown.topic_type, shown.type_hash, shown.qos) == (cdr.MAP, cdr.HASHES[cdr.MAP], LATCHED)


async def test_updates_change_the_last_map(ros):
    before, after = two_rooms(), two_rooms().cells_yx.copy()
    after[40:44, 80:84] = 100
    after = fleetmap.OccupancyGrid(after, before.resolution_m, before.origin)
    with Sdk(ros) as sdk:
        async with bridged(ros) as bridge:
            maps, updates = sdk.publisher("/map", cdr.MAP), sdk.publisher("/map_updates", cdr.MAP_UPDATE)
            await until(lambda: bridge.offered == ["/map"])
            say_grid(maps, before)
            await until(lambda: bridge.maps_published == 1)
            message = grids.update_message(before, after, frame_id="map", stamp_ns=1)
            parts = ("header", "x", "y", "width", "height", "data")
            updates.publish(**{name: getattr(message, name) for name in parts})
            await until(lambda: bridge.maps_published == 2)
            await until(lambda: like(bridge.peer.merged, after))
            assert not like(bridge.peer.merged, before)


def like(merged, grid, ms=99.95):
    """Whether they are one map, but for the corners of walls that no free cell touches."""
    found = fleetmap.compare(merged.to_grid(0.05), grid) if len(merged) else None
    return found is not None and ms < found.MS


async def test_a_publisher_of_our_own_latches_for_our_subscriber_and_a_router_that_comes_late_or_twice_is_found(port):
    """Both ends are ours: the bridge waits for the router, and outlives it."""
    grid = two_rooms()
    source = zenoh_port(port, node="mapper")
    say = source.advertise("map", cdr.MAP, LATCHED_QOS)
    say(cdr.encode(grids.map_message(grid, frame_id="map", stamp_ns=1), cdr.MAP))  # before there is any session
    async with bridged(port) as bridge:
        await until(lambda: bridge.port.problems())
        assert "start `ros2 run rmw_zenoh_cpp rmw_zenohd` there" in next(iter(bridge.port.problems().values()))
        with ros_router(f"tcp/127.0.0.1:{port}"):
            await source.open()
            await until(lambda: bridge.maps_published == 1)
            assert bridge.port.problems() == {}
        await until(lambda: bridge.port.problems())
        with ros_router(f"tcp/127.0.0.1:{port}"):
            await until(lambda: not bridge.port.problems() and not source.problems())
            larger = fleetmap.OccupancyGrid(np.pad(grid.cells_yx, 5, constant_values=0), 0.05, grid.origin)
            say(cdr.encode(grids.map_message(larger, frame_id="map", stamp_ns=2), cdr.MAP))
            await until(lambda: bridge.maps_published == 2)
        await source.close()


async def test_the_bridge_is_a_router_itself_where_no_ros_is_installed(port):
    endpoint = f"tcp/127.0.0.1:{port}"
    async with bridged(port, wire={"listen": endpoint}) as bridge:
        await until(lambda: bridge.port._session is not None)
        with Sdk(port) as sdk:
            publisher = sdk.publisher("/map", cdr.MAP)
            await until(lambda: bridge.offered == ["/map"])
            say_grid(publisher, two_rooms())
            await until(lambda: bridge.saying.maps_out)
    taken = free_port("127.0.0.1")
    with ros_router(f"tcp/127.0.0.1:{taken}"), pytest.raises(fleetmap.LinkError, match=f"127.0.0.1:{taken}"):
        await zenoh_port(taken, listen=f"tcp/127.0.0.1:{taken}").open()


async def test_zenoh_bridge_ros2dds_is_spoken_to_by_names_alone(ros):
    """What that bridge does on its side: a plain put on the topic's name, and a subscriber of the name."""
    session = zenoh.open(zenoh_config({"mode": "client", "connect/endpoints": [f"tcp/127.0.0.1:{ros}"]}))
    try:
        came = []
        subscriber = session.declare_subscriber("r1/fleet_map", lambda sample: came.append(sample.payload.to_bytes()))
        zid = str(session.info.zid())
        offered = Ros2Dds().endpoint_token(zid, Endpoint(True, 1, "/", "x", "/r1/map", cdr.MAP, LATCHED_QOS))
        token = session.liveliness().declare_token(offered)
        async with bridged(ros, dialect=Ros2Dds(), wire={"namespace": "/r1"}) as bridge:
            await until(lambda: bridge.offered == ["/r1/map"])
            session.put("r1/map", cdr.encode(grids.map_message(two_rooms(), frame_id="map", stamp_ns=1), cdr.MAP))
            await until(lambda: came)
            shown = [str(reply.ok.key_expr) for reply in session.liveliness().get("@/*/@ros2_lv/MP/**")]
        assert occupied(cdr.decode(came[0], cdr.MAP, topic="x")) == occupied(two_rooms().cells_yx) - 4
        assert any(key.endswith("MP/r1§fleet_map/nav_msgs§msg§OccupancyGrid/:1:1:0,1") for key in shown)
        token.undeclare()
        subscriber.undeclare()
    finally:
        session.close()


async def test_the_pose_is_looked_up_and_teammates_are_shown(ros):
    hub = MemoryHub(LoopClock())
    port = zenoh_port(ros, node="mate")
    mates, named = [], []
    port.subscribe("fleet_robots", cdr.POSES, LATCHED_QOS, mates.append)
    port.subscribe("fleet_robots_names", cdr.MARKERS, LATCHED_QOS, named.append)
    moving = port.advertise("/tf", cdr.TF, LATCHED_QOS)
    static = port.advertise("/tf_static", cdr.TF, LATCHED_QOS)
    maps = port.advertise("map", cdr.MAP, LATCHED_QOS)
    await port.open()
    async with (
        fleetmap.join("r2", start=Pose2(10.0, 0.0, 0.0), link=hub.link("r2")) as mate,
        bridged(ros, hub=hub, map_frame="", base_frame="base_link") as bridge,
    ):
        await until(lambda: bridge.port._session is not None)
        maps(cdr.encode(grids.map_message(two_rooms(), frame_id="map", stamp_ns=1), cdr.MAP))
        static(frame("map", "odom", Pose2(1.0, 2.0, np.pi / 2), 0))
        moving(frame("odom", "base_link", Pose2(3.0, 0.0, 0.0), time.time_ns()))
        await until(lambda: any(m.robot == "r1" and m.pose for m in mate.teammates(frame="fleet")))
        (seen,) = (m for m in mate.teammates(frame="fleet") if m.robot == "r1")
        await mate.set_pose(Pose2(1.0, 1.0, 0.0))
        await until(lambda: any(cdr.decode(data, cdr.POSES, topic="x").poses for data in mates) and len(named[-1]) > 8)
        assert not [p for p in bridge.problems() if p.kind == "pose"]
    await port.close()
    assert (seen.pose.x_m, seen.pose.y_m) == pytest.approx((1.0, 5.0), abs=0.002)
    (marker,) = cdr.decode(named[-1], cdr.MARKERS, topic="x").markers
    assert (marker.text, marker.pose.position.x) == ("r2", 11.0)


def frame(parent, child, pose, stamp_ns):
    return cdr.encode(said.transform(pose, parent=parent, child=child, stamp_ns=stamp_ns), cdr.TF)


async def test_a_burst_of_maps_coalesces_and_the_last_one_counts(ros):
    port = zenoh_port(ros, node="mapper")
    say = port.advertise("map", cdr.MAP, LATCHED_QOS)
    await port.open()
    cells = two_rooms().cells_yx.copy()
    async with bridged(ros, map_rate_hz=5.0) as bridge:
        await until(lambda: bridge.offered == ["/map"])
        for k in range(100):
            cells[20 + k % 40, 20 + k // 4] = 100
            grid = fleetmap.OccupancyGrid(cells, 0.05, two_rooms().origin)
            say(cdr.encode(grids.map_message(grid, frame_id="map", stamp_ns=k), cdr.MAP))
        # Each published map is followed by the pause of the rate: a few of the hundred are taken in.
        await until(lambda: like(bridge.peer.merged, grid, ms=99.0))
        assert bridge.maps_published <= 10
    await port.close()


MUTATIONS = int(os.environ.get("FLEETMAP_BRIDGE_MUTATIONS", "1000"))


async def test_garbage_is_counted_and_nothing_else_happens(ros):
    session = zenoh.open(zenoh_config({"mode": "client", "connect/endpoints": [f"tcp/127.0.0.1:{ros}"]}))
    dialect, rng = RmwZenoh(), random.Random(1)
    samples = {
        ("/map", cdr.MAP): cdr.encode(grids.map_message(two_rooms(), frame_id="map", stamp_ns=1), cdr.MAP),
        ("/tf", cdr.TF): frame("map", "base_link", Pose2(1.0, 2.0, 0.3), 5),
    }
    attachment = dialect.attachment(1, 1, bytes(16))

    def put(key, data):
        # What the sender drops proves nothing.
        session.put(key, data, attachment=attachment, congestion_control=zenoh.CongestionControl.BLOCK)

    try:
        async with bridged(ros) as bridge:
            await until(lambda: bridge.port._session is not None)
            (map_key, good) = dialect.said("/map", cdr.MAP), samples["/map", cdr.MAP]
            put(map_key, good)
            await until(lambda: bridge.maps_published == 1)
            for number in range(MUTATIONS):
                (topic, type_name), data = rng.choice(list(samples.items()))
                put(dialect.said(topic, type_name), mutated(data, rng))
                if number % 100 == 0:
                    put("0/map/nav_msgs::msg::dds_::OccupancyGrid_/RIHS01_00", good)
                    await asyncio.sleep(0)
            larger = fleetmap.OccupancyGrid(np.full((200, 200), 0, np.int8), 0.05)
            message = grids.map_message(larger, frame_id="map", stamp_ns=9)
            put(map_key, cdr.encode(message, cdr.MAP))
            await until(lambda: bridge.peer.merged.bounds_m()[2] == 10.0, wait_s=3 * WAIT_S)
            refused = bridge.hearing.refusals
            assert refused > MUTATIONS / 20
            assert len(bridge.hearing.refused) < 20
            assert bridge.port.odd["/map", "hash"] >= MUTATIONS // 100
            assert any("is another nav_msgs/msg/OccupancyGrid than here" in p.text for p in bridge.problems())
    finally:
        session.close()


async def test_a_map_of_an_older_rmw_zenoh_is_taken_and_its_deafness_is_said(ros):
    session = zenoh.open(zenoh_config({"mode": "client", "connect/endpoints": [f"tcp/127.0.0.1:{ros}"]}))
    try:
        async with bridged(ros) as bridge:
            await until(lambda: bridge.port._session is not None)
            data = cdr.encode(grids.map_message(two_rooms(), frame_id="map", stamp_ns=1), cdr.MAP)
            session.put(RmwZenoh().said("/map", cdr.MAP), data, attachment=bytes(40))
            await until(lambda: bridge.maps_published == 1)
            assert [p.text for p in bridge.problems() if p.kind == "ros"] == [
                "/map comes from an rmw_zenoh before 0.2.5 (Jazzy) or 0.1.2 (Humble), which hears nothing from here"
            ]
    finally:
        session.close()


def mutated(data, rng):
    data = bytearray(data)
    kind = rng.randrange(4)
    if kind == 0:
        return bytes(data[: rng.randrange(len(data))])
    if kind == 1:
        struct.pack_into(
            "<I", data, 4 * rng.randrange(2, min(30, len(data) // 4 - 1)), rng.choice((2**32 - 1, 2**31, 2**20))
        )
        return bytes(data)
    if kind == 2:
        return rng.randbytes(rng.randrange(200))
    for _ in range(8):
        data[rng.randrange(min(len(data), 120))] = rng.randrange(256)
    return bytes(data)


async def test_a_teammate_kilometres_away_costs_the_drawn_map_and_nothing_else(ros):
    hub = MemoryHub(LoopClock())
    port, walls = zenoh_port(ros, node="mapper"), []
    maps = port.advertise("map", cdr.MAP, LATCHED_QOS)
    port.subscribe("fleet_walls", cdr.MARKERS, LATCHED_QOS, walls.append)
    await port.open()
    async with bridged(ros, hub=hub) as bridge:
        maps(cdr.encode(grids.map_message(two_rooms(), frame_id="map", stamp_ns=1), cdr.MAP))
        await until(lambda: bridge.saying.maps_out == 1 and walls)
        async with fleetmap.join("far", start=Pose2(2500.0, 2500.0, 0.0), link=hub.link("far")) as far:
            await far.publish(two_rooms())
            await until(lambda: any(p.kind == "fleet map" for p in bridge.problems()))
            await until(lambda: len(walls) == 2)
            (problem,) = (p for p in bridge.problems() if p.kind == "fleet map")
            assert "A larger resolution_m takes fewer cells" in problem.text
            await bridge.peer.forget("far")
        await until(lambda: not any(p.kind == "fleet map" for p in bridge.problems()))
    await port.close()


async def test_a_router_that_accepts_and_says_nothing_keeps_nobody():
    with socket.create_server(("127.0.0.1", 0)) as mute:
        port = zenoh_port(mute.getsockname()[1])
        say = port.advertise("map", cdr.MAP, LATCHED_QOS)
        opening = asyncio.create_task(port.open())
        await asyncio.sleep(0.5)
        began_s = time.monotonic()
        say(b"")
        await port.close()
        assert time.monotonic() - began_s < 1.0
        opening.cancel()
        await asyncio.gather(opening, return_exceptions=True)


async def test_what_is_missing_is_said_in_words(ros):
    port = zenoh_port(ros, node="mapper")
    port.advertise("/robot7/map", cdr.MAP, LATCHED_QOS)
    await port.open()
    async with bridged(ros, start="") as bridge:
        await until(lambda: bridge.offered)
        bridge._began_s -= 60.0
        texts = {problem.kind: problem.text for problem in bridge.problems()}
        assert texts["map"].startswith("no map on /map yet; maps are offered on /robot7/map:")
        assert "--start 0,0,0" in texts["start"]
    await port.close()


async def test_a_mapper_that_has_no_map_yet_is_told_from_none(ros):
    port = zenoh_port(ros, node="mapper")
    port.advertise("map", cdr.MAP, LATCHED_QOS)
    await port.open()
    async with bridged(ros) as bridge:
        await until(lambda: bridge.offered)
        bridge._began_s -= 60.0
        (problem,) = (p for p in bridge.problems() if p.kind == "map")
        assert problem.text == "no map on /map yet, though it is offered there: has the mapper said its first one?"
    await port.close()


async def test_simulated_time_is_that_of_clock(ros):
    port, clock = zenoh_port(ros, node="sim"), []
    say = port.advertise("/clock", cdr.CLOCK, LATCHED_QOS)
    port.subscribe("/tf", cdr.TF, LATCHED_QOS, clock.append)
    maps = port.advertise("map", cdr.MAP, LATCHED_QOS)
    await port.open()
    async with bridged(ros, wire={"use_sim_time": True}) as bridge:
        maps(cdr.encode(grids.map_message(two_rooms(), frame_id="map", stamp_ns=1), cdr.MAP))
        await until(lambda: "/clock" in bridge.port.problems())
        await until(lambda: bridge.hearing.maps_in)
        assert not clock
        say(cdr.encode(cdr.make(cdr.CLOCK, clock=cdr.time_of(5_000_000_007)), cdr.CLOCK))
        await until(lambda: clock)
    await port.close()
    (stamped,) = cdr.decode(clock[0], cdr.TF, topic="x").transforms
    assert (stamped.header.stamp.sec, stamped.header.stamp.nanosec) == (5, 7)


async def test_two_robots_see_one_map_through_two_bridges(ros):
    """Namespaces of their own, a quarter turn between their map frames, the fleet over real Zenoh."""
    whole = two_rooms()
    left, right = whole.cells_yx.copy(), whole.cells_yx.copy()
    left[:, 61:], right[:, :61] = -1, -1
    fleet_port = free_port("127.0.0.1")
    grids_of = {"r1": left, "r2": np.rot90(right, -1)}
    # The right part lies turned in its own frame, with its lower left corner at 0.
    frames = {"r1": (0.0, 0.0, 0.0), "r2": (-1.0, 6.0, -np.pi / 2)}
    peers, bridges, running = [], [], []
    port = zenoh_port(ros, node="mappers")
    say = {robot: port.advertise(f"/{robot}/map", cdr.MAP, LATCHED_QOS) for robot in grids_of}
    await port.open()
    try:
        for robot, start in frames.items():
            options = BridgeOptions(
                robot,
                start=start,
                profile="local",
                fleet="two",
                listen=[f"tcp/127.0.0.1:{fleet_port}"] if robot == "r1" else [],
                connect=[] if robot == "r1" else [f"tcp/127.0.0.1:{fleet_port}"],
            )
            peer = await make_peer(options.join_options())
            peers.append(peer)
            bridges.append(Bridge(peer, zenoh_port(ros, namespace=f"/{robot}"), options))
            running.append(asyncio.create_task(bridges[-1].run()))
        for robot, cells in grids_of.items():
            origin = whole.origin if robot == "r1" else Pose2(0.0, 0.0, 0.0)
            grid = fleetmap.OccupancyGrid(np.ascontiguousarray(cells), 0.05, origin)
            say[robot](cdr.encode(grids.map_message(grid, frame_id=f"{robot}/map", stamp_ns=1), cdr.MAP))
        await until(lambda: len({b.peer.merged.digest for b in bridges}) == 1 and len(bridges[0].peer.revisions) == 2)
        merged = bridges[0].peer.merged.to_grid(0.05)
        expected = fleetmap.OccupancyGrid(whole.cells_yx, 0.05, whole.origin)
        found = fleetmap.compare(merged, expected)
        assert found.OPDF > 99
        assert found.MS > 97
    finally:
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)
        for peer in peers:
            await peer.close()
        await port.close()
