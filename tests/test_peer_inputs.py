"""What a user hands to ``join`` and to a peer: what can't be is refused at the call, and says what was expected."""

from __future__ import annotations

import asyncio
import inspect
import re
import subprocess
import sys
import warnings

import numpy as np
import pytest
from conftest import two_rooms

import fleetmap
from fleetmap.model.errors import ConfigError, MapWarning, NoPath
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.peer.endpoints import check_endpoints
from fleetmap.peer.memory_link import LoopClock, MemoryHub
from fleetmap.vectorize import vectorize

CELLS = two_rooms().cells_yx
GRADED = np.select([CELLS == -1, CELLS == 0], [-1, 40], 60).astype(np.int8)

OPTIONS = [
    ({"fleet": 1}, "fleet=1"),
    ({"level": ""}, "level=''"),
    ({"start": (0, 0, 0)}, r"start=\(0, 0, 0\): expected Pose2; found tuple: write Pose2\("),
    ({"start": "origin"}, "found str"),
    ({"start": Pose2(1e305, 0.0, 0.0)}, "m from 0"),
    ({"connect": "tcp/10.0.0.2:7447"}, r'expected a list, as \["tcp/'),
    ({"connect": 7447}, "expected a list"),
    ({"listen": [7447]}, "expected tcp/HOST:PORT"),
    ({"listen": ["udp/10.0.0.2:7447"]}, "expected tcp/HOST:PORT.*lose state"),
    ({"listen": ["127.0.0.1:7447"]}, "the protocol is missing"),
    ({"connect": ["tcp/127.0.0.1"]}, "the port is missing"),
    ({"connect": ["tcp/127.0.0.1:99999"]}, "the port is '99999', not 1 to 65535"),
    ({"connect": ["tcp/127.0.0.1:0"]}, "the port is '0', not 1 to 65535"),
    ({"connect": ["tcp/10.0.0.2:+80"]}, "the port is"),
    ({"connect": ["tcp/:7447"]}, "the host is missing"),
    ({"connect": ["tcp/10.0.0.2 :7447"]}, "a space"),
    ({"connect": ["tcp/10.0.0.2:7447,tcp/10.0.0.3:7447"]}, "expected tcp/HOST:PORT"),
    ({"connect": ["tcp/10.0.0:7447"]}, "no address"),
    ({"connect": ["tcp/[fe80::1::2]:7447"]}, "no address"),
    ({"connect": ["tcp/-seed-:7447"]}, "no name of a host"),
    ({"profile": "wan"}, "expected one of lan, local"),
    ({"profile": ["lan"]}, "expected one of lan, local"),
    ({"config": ["mode"]}, "keys -> values"),
    ({"config": {1: 1}}, "keys -> values"),
    ({"config": {"mode": object()}}, "'mode' can't be written as JSON"),
    ({"budget_Bps": "x"}, "budget_Bps='x': expected a number above 0"),
    ({"budget_Bps": -1.0}, "expected a number above 0"),
    ({"max_rate_hz": True}, "max_rate_hz=True: expected a number above 0"),
    ({"max_rate_hz": np.nan}, "expected a number above 0"),
    ({"heartbeat_s": "x"}, "heartbeat_s='x': expected seconds, more than 0"),
    ({"heartbeat_s": 0}, "expected seconds, more than 0"),
    ({"heartbeat_s": np.nan}, "expected seconds, more than 0"),
    ({"fold_interval_s": "x"}, "fold_interval_s='x': expected seconds, 0 or more"),
    ({"fold_interval_s": -1}, "expected seconds, 0 or more"),
    ({"fold_interval_s": np.inf}, "expected seconds, 0 or more"),
    ({"baselines": "no"}, "expected bool; found str"),
]


@pytest.mark.parametrize(("options", "expected"), OPTIONS)
async def test_an_option_that_cannot_be_is_refused_when_joining(options, expected):
    hub = MemoryHub(LoopClock())
    with pytest.raises(ConfigError, match=expected):
        fleetmap.join("a", link=hub.link("a"), **options)


@pytest.mark.parametrize(("options", "expected"), OPTIONS)
async def test_the_sync_facade_refuses_the_same_options(options, expected):
    hub = MemoryHub(LoopClock())
    with pytest.raises(ConfigError, match=expected):
        fleetmap.sync.join("a", link=hub.link("a"), **options)


def test_endpoints_of_every_kind_that_zenoh_takes_are_taken():
    good = [
        "tcp/seed-1.local:7447",
        "tls/10.0.0.2:7447",
        "tcp/[::1]:7447",
        "tcp/[fe80::1%eth0]:65535",
        "tcp/a:1#iface=b",
    ]
    assert check_endpoints("connect", good) == good
    assert check_endpoints("listen", ["tcp/0.0.0.0:0"]) == ["tcp/0.0.0.0:0"]


def test_both_faces_take_the_same_options_and_show_each_of_them():
    asyncio_face, sync_face = inspect.signature(fleetmap.join), inspect.signature(fleetmap.sync.join)
    assert asyncio_face.parameters == sync_face.parameters
    assert asyncio_face.parameters["heartbeat_s"].default is None
    assert [face.return_annotation for face in (asyncio_face, sync_face)] == ["Peer", "SyncPeer"]
    for join in (fleetmap.join, fleetmap.sync.join):
        with pytest.raises(TypeError, match="'flet'"):
            join("a", flet="site-4")
        with pytest.raises(ConfigError, match="robot=''"):
            join(robot="")


def test_each_option_is_explained():
    explained = re.findall(r"^([\w, ]+) :", inspect.getdoc(fleetmap.JoinOptions), re.MULTILINE)
    names = [name for line in explained for name in line.split(", ")]
    assert set(inspect.signature(fleetmap.join).parameters) == set(names) - {"ConfigError"}


@pytest.mark.parametrize(
    ("config", "named"),
    [
        ({"foo/bar": 1}, "'foo/bar': 1"),
        ({"scouting/multicast/enabeld": True}, "scouting/multicast/enabeld"),
        ({"scouting/delay": "soon"}, "scouting/delay"),
        ({"mode": "nonsense"}, "'mode'"),
    ],
)
def test_a_setting_that_zenoh_does_not_take_is_named_when_joining(config, named):
    for join in (fleetmap.join, fleetmap.sync.join):
        with pytest.raises(ConfigError, match=f"config=.*{named}.*no such setting") as caught:
            join("a", profile="local", config=config)
        assert ".rs:" not in str(caught.value)
    with pytest.raises(ConfigError, match="link"):
        fleetmap.join("a", link="memory")


CALLS = [
    (lambda p: p.publish(CELLS), "resolution_m=None: expected metres a cell beside an array"),
    (lambda p: p.publish(None), "source='NoneType': expected a fleetmap.OccupancyGrid, a message like"),
    (lambda p: p.publish(CELLS, resolution_m=0.05, origin=(0, 0, 0)), "origin=.*expected Pose2"),
    (lambda p: p.publish(two_rooms(), resolution_m=0.05), "resolution_m=.*goes with an array only"),
    (lambda p: p.publish(vectorize(two_rooms()), resolution_m=0.05), "resolution_m=0.05: is for grids"),
    (lambda p: p.publish(MergedMap(np.zeros((0, 8), np.int32))), "merged map is never published"),
    (lambda p: p.publish(two_rooms(), submap=3), "submap=3"),
    (lambda p: p.publish(two_rooms(), anchor=(0, 0, 0)), "anchor=.*expected Pose2"),
    (lambda p: p.publish(two_rooms(), free_below="x"), "0 < free_below <= occupied_above < 100"),
    (lambda p: p.publish(two_rooms(), free_below=80), "0 < free_below <= occupied_above < 100"),
    (lambda p: p.publish(vectorize(two_rooms()), free_below=10), "is for grids"),
    (lambda p: p.set_pose((1, 2, 0)), r"pose=\(1, 2, 0\): expected Pose2; found tuple: write Pose2\("),
    (lambda p: p.set_pose(None), "expected Pose2; found NoneType"),
    (lambda p: p.set_goal((1, 2, 3)), r"goal_xy=\(1, 2, 3\): expected two finite numbers"),
    (lambda p: p.set_goal((1, np.nan)), "expected two finite numbers"),
    (lambda p: p.set_goal("12"), "expected two finite numbers"),
    (lambda p: p.set_goal(("1", "2")), "expected two finite numbers"),
    (lambda p: p.set_goal(1.0), "expected two finite numbers"),
    (lambda p: p.set_goal(Pose2()), "expected two finite numbers"),
    (lambda p: p.set_goal(np.zeros((2, 2))), "expected two finite numbers"),
    (lambda p: p.set_start((1, 2, 0)), "start=.*expected Pose2"),
    (lambda p: p.forget(3), "robot=3"),
    (lambda p: p.synced("x"), "timeout_s='x': expected seconds"),
    (lambda p: p.synced(at_least=1.5), "whole number"),
]


async def test_what_a_peer_cannot_take_is_refused_at_the_call_and_the_peer_goes_on():
    hub = MemoryHub(LoopClock())
    async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as peer:
        for call, expected in CALLS:
            with pytest.raises(ConfigError, match=expected) as caught:
                await call(peer)
            assert len(str(caught.value)) < 250
        for start_xy in ((0, 0, 0), "00", None, (0, np.inf)):
            with pytest.raises(ConfigError, match="start_xy"):
                peer.plan(start_xy, (1, 1), radius_m=0.1)
        with pytest.raises(ConfigError, match="expected robot or fleet"):
            peer.plan((0, 0), (1, 1), radius_m=0.1, frame="map")
        assert peer.stats().series == ()
        assert await peer.publish(two_rooms())
        await peer.set_goal(np.array([1.0, 2.0]))
        await peer.refresh()
        with pytest.raises(ConfigError, match="radius_m"):
            peer.plan((0, 0), (1, 1), radius_m="x")


async def test_the_sync_facade_refuses_the_same_calls():
    hub = MemoryHub(LoopClock())

    def work():
        with fleetmap.sync.join("a", start=Pose2(), link=hub.link("a")) as peer:
            for call, expected in CALLS:
                with pytest.raises(ConfigError, match=expected):
                    call(peer)
            with pytest.raises(ConfigError, match="timeout_s"):
                next(peer.changes("x"))
            assert peer.publish(OccupancyGrid(GRADED, 0.05), free_below=50, occupied_above=54)
            return peer.refresh().to_bytes()

    first = await asyncio.to_thread(work)
    async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as peer:
        await peer.publish(OccupancyGrid(CELLS, 0.05))
        assert (await peer.refresh()).to_bytes() == first


async def test_a_peer_that_is_not_connected_says_how_to_connect_it():
    hub = MemoryHub(LoopClock())
    peer = fleetmap.join("a", link=hub.link("a"))
    for call in (
        peer.publish(two_rooms()),
        peer.set_pose(Pose2()),
        peer.refresh(),
        peer.synced(),
        anext(peer.changes()),
    ):
        with pytest.raises(fleetmap.LinkError, match=r"not connected yet: `async with fleetmap\.join"):
            await call


async def test_a_plan_before_anything_was_merged_says_what_to_do():
    hub = MemoryHub(LoopClock())
    async with fleetmap.join("a", start=Pose2(), link=hub.link("a"), fold_interval_s=3600.0) as peer:
        peer._folder.folded = False  # whether the first fold has run by now is a matter of time
        with pytest.raises(fleetmap.NoPath, match=r"nothing has been merged yet: call refresh\(\)") as caught:
            peer.plan((0, 0), (1, 1), radius_m=0.1)
        assert caught.value.status == "outside"
        await peer.refresh()
        with pytest.raises(fleetmap.NoPath, match="no robot has shared one") as caught:
            peer.plan((0, 0), (1, 1), radius_m=0.1)
        assert caught.value.status == "outside"
        await peer.publish(two_rooms())
        await peer.refresh()
        assert peer.plan((-0.2, 3.0), (0.5, 4.0), radius_m=0.1).length_m == pytest.approx(np.hypot(0.7, 1.0))


async def test_a_caller_may_use_its_buffer_again_as_soon_as_it_has_made_a_grid_of_it():
    hub = MemoryHub(LoopClock())
    expected = []
    for buffer in (None, CELLS.copy()):  # a new array for each grid, and one for all
        async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as peer:
            digests = []
            for width in (60, 90, 120):
                cells = np.where(np.arange(CELLS.shape[1]) < width, CELLS, -1).astype(np.int8)
                if buffer is not None:
                    buffer[:] = cells
                    cells = buffer
                publishing = asyncio.ensure_future(peer.publish(OccupancyGrid(cells, 0.05)))
                await asyncio.sleep(0)
                cells[:] = 100
                assert await publishing
                digests.append((await peer.refresh()).digest)
            expected.append((digests, peer.stats().baselines))
    assert expected[0] == expected[1]
    assert expected[0][1]["grid_gzip_updates"] > 0


async def test_a_submap_that_its_thresholds_empty_is_warned_of_once():
    hub = MemoryHub(LoopClock())
    grid = OccupancyGrid(GRADED, 0.05)
    async with fleetmap.join("a", start=Pose2(), link=hub.link("a")) as peer:
        for submap in ("0", "1"):
            with pytest.warns(MapWarning, match="free_below"):
                assert await peer.publish(grid, submap=submap)
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                assert not await peer.publish(grid, submap=submap)
                await peer.publish(OccupancyGrid(GRADED, 0.1), submap=submap)  # starts anew
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert await peer.publish(grid, submap="2", free_below=50, occupied_above=54)
        merged = await peer.refresh()
        assert merged.obstacle.any()


def test_the_rooms_that_the_readme_names_are_there_without_an_import():
    code = "import fleetmap; print(fleetmap.sync.join.__module__, fleetmap.vectorize.verify.__module__)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["fleetmap.sync", "fleetmap.vectorize.verify"]


async def test_a_path_on_a_map_that_is_not_merged_yet_says_what_to_do():
    states = np.full((60, 60), 100, np.int8)
    states[5:-5, 5:-5] = 0
    link = MemoryHub(LoopClock()).link("a")
    async with fleetmap.join("a", start=Pose2(), link=link, fold_interval_s=1e3) as peer:
        changes = peer.changes()
        next_change = asyncio.ensure_future(anext(changes))
        await peer.publish(OccupancyGrid(np.where(states == 0, -1, states), 0.05))
        await next_change  # now it rests for the interval
        await changes.aclose()
        await peer.publish(OccupancyGrid(states, 0.05))
        with pytest.raises(NoPath, match=r"call refresh\(\), and plan again"):
            peer.plan((0.5, 0.5), (2.0, 2.0), radius_m=0.1)
        await peer.refresh()
        assert peer.plan((0.5, 0.5), (2.0, 2.0), radius_m=0.1).length_m > 2
        with pytest.raises(NoPath) as refused:
            peer.plan((0.5, 0.5), (9.0, 9.0), radius_m=0.1)
        assert "refresh" not in str(refused.value)


async def test_a_map_that_turns_graded_later_is_warned_of_too():
    mask = np.zeros((40, 40), np.uint8)
    mask[10:30, 20] = 1
    async with fleetmap.join("a", link=MemoryHub(LoopClock()).link("a")) as peer:
        await peer.publish(OccupancyGrid(mask.astype(bool), 0.05))
        with pytest.warns(MapWarning, match="a mask of walls is an array of bools"):
            await peer.publish(OccupancyGrid(mask, 0.05))
        await peer.publish(OccupancyGrid(mask, 0.05))  # once: another warning would be an error
