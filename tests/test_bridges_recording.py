"""Fleets into files that others open, and back."""

import asyncio
import base64
import json
import os
import subprocess
from collections import Counter
from contextlib import AsyncExitStack
from pathlib import Path

import numpy as np
import pytest
from bags import growing
from conftest import two_rooms
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

import fleetmap
from fleetmap.bridges import cdr
from fleetmap.bridges.bags import Bag
from fleetmap.bridges.mcap_file import McapFile
from fleetmap.bridges.player import is_recording, play_recording
from fleetmap.bridges.qos import STREAM
from fleetmap.bridges.recorder import RECORDS_TOPIC, Recorder
from fleetmap.cli import sim as sim_cli
from fleetmap.model.errors import ConfigError, MapFormatError
from fleetmap.model.pose import Pose2
from fleetmap.peer.memory_link import LoopClock, MemoryHub
from fleetmap.peer.options import JoinOptions
from fleetmap.peer.ports import free_port


async def record(path, *, levels=("0", "0")):
    """Two robots, one of them with two submaps, and what the recorder saw; returns the merged digest."""
    hub, recorders = MemoryHub(LoopClock()), 0
    async with (
        fleetmap.join("a", start=Pose2(0.3, 0.0, 0.1), level=levels[0], link=hub.link("a")) as a,
        fleetmap.join("b", start=Pose2(4.0, 2.0, 1.7), level=levels[1], link=hub.link("b")) as b,
        fleetmap.join("recorder", start=Pose2(), link=hub.link("recorder"), fold_interval_s=0.01) as peer,
    ):
        with McapFile(path) as file:
            recorder = Recorder(peer, None, file)
            running = asyncio.create_task(recorder.run())
            for grid in growing(5):
                await a.publish(grid)
                await a.set_pose(Pose2(1.0, 1.0, 0.0))
                await b.publish(grid)
                await peer.synced(at_least=2)
            await b.publish(two_rooms(), submap="cellar", anchor=Pose2(0.0, 10.0, 0.2))
            await b.set_start(Pose2(4.1, 2.0, 1.7))
            merged = await peer.synced(at_least=2)
            await asyncio.sleep(0.2)
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
            await recorder.finish()
            recorders += recorder.records
    assert recorders >= 11
    return merged.digest


def counts_of(path):
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return Counter(channel.topic for _, channel, _, _ in reader.iter_decoded_messages())


async def test_others_read_a_recording_with_equal_counts(tmp_path):
    path = tmp_path / "run.mcap"
    await record(path)
    by_mcap = counts_of(path)
    with AnyReader([path]) as reader:
        by_rosbags = Counter({c.topic: c.msgcount for c in reader.connections})
        grids = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages() if c.topic == "/map"]
        frames = {
            (t.header.frame_id, t.child_frame_id)
            for c, _, data in reader.messages()
            if c.topic == "/tf"
            for t in reader.deserialize(data, c.msgtype).transforms
        }
        assert {c.topic: c.digest for c in reader.connections if c.topic == "/map"}["/map"] in ("", cdr.HASHES[cdr.MAP])
    assert by_mcap == by_rosbags
    assert {"/map", "/fleet_walls", "/tf", RECORDS_TOPIC} <= by_mcap.keys()
    assert grids[-1].header.frame_id == "fleet"
    assert (np.asarray(grids[-1].data) == 100).any()
    assert {("fleet", "a/map"), ("fleet", "b/map"), ("a/map", "a/base_link")} <= frames


async def test_the_file_is_what_ros2_bag_plays(tmp_path):
    """All topics in one encoding, with the quality of service of latched maps, in compressed chunks."""
    path = tmp_path / "run.mcap"
    await record(path)
    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary, header = reader.get_summary(), reader.get_header()
    assert header.profile == "ros2"
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    (of_map,) = (c for c in summary.channels.values() if c.topic == "/map")
    assert "durability: 1" in of_map.metadata["offered_qos_profiles"]
    assert of_map.metadata["topic_type_hash"] == cdr.HASHES[cdr.MAP]


async def played_digest(path):
    """Play a recording in a fleet over Zenoh in which somebody else listens; returns what that one has in the end."""
    endpoint = f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
    async with (
        fleetmap.join("watcher", fleet="again", start=Pose2(), profile="local", listen=[endpoint]) as watcher,
        AsyncExitStack() as stack,
    ):
        options = JoinOptions("x", fleet="again", profile="local", connect=[endpoint])
        with Bag(path) as bag:
            assert is_recording(bag)
            peers = await play_recording(bag, options, stack, rate=None)
        merged = await watcher.synced(at_least=len(peers))
        digests = {(await peer.synced()).digest for peer in peers}
        return merged.digest, sorted(peer.robot for peer in peers), digests


async def test_a_recording_is_played_to_the_same_merged_map(tmp_path):
    path = tmp_path / "run.mcap"
    digest = await record(path)
    again, robots, own = await played_digest(path)
    assert robots == ["a", "b"]
    assert again == digest
    assert own == {digest}


async def test_a_record_that_is_damaged_or_missing_is_named(tmp_path):
    path, wrong = tmp_path / "run.mcap", tmp_path / "wrong.mcap"
    await record(path)
    with Bag(path) as bag:
        texts = [bag.decode(topic, data).data for topic, _, data in bag.messages([RECORDS_TOPIC])]
    first, *rest = texts
    document = json.loads(first)
    flipped = bytearray(base64.b64decode(document["message"]))
    flipped[-3] ^= 1
    damaged = json.dumps({**document, "message": base64.b64encode(flipped).decode()})
    for say in ([damaged], rest, ["no JSON"], ["[" * 100_000], ["{}"], [json.dumps({**document, "life": "x"})]):
        with McapFile(wrong) as file:
            file.add_topic(RECORDS_TOPIC, cdr.TEXT, STREAM)
            for k, text in enumerate(say):
                file.write(RECORDS_TOPIC, k, cdr.encode(cdr.make(cdr.TEXT, data=text), cdr.TEXT))
        hub = MemoryHub(LoopClock())
        async with AsyncExitStack() as stack:
            with Bag(wrong) as bag, pytest.raises(MapFormatError, match=f"{wrong}: {RECORDS_TOPIC}"):
                await play_recording(bag, JoinOptions("x", link=hub.link("x")), stack, rate=None)


def test_names_that_can_not_be_recorded_into_are_refused_first(tmp_path):
    for name, expected in [("run.bag", "ends in .mcap"), ("missing/run.mcap", "no such folder")]:
        with pytest.raises(ConfigError, match=expected):
            McapFile(tmp_path / name)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
async def test_a_full_disk_costs_the_recording_and_not_what_is_beside_it(tmp_path):
    out, unrecorded, place = tmp_path / "run.mcap", [], f"tcp/127.0.0.1:{free_port('127.0.0.1')}"
    out.symlink_to("/dev/full")
    async with fleetmap.join("a", start=Pose2(), fleet="full", profile="local", listen=[place]) as a:
        await a.publish(two_rooms())
        async with sim_cli._recording(out, unrecorded)("full", place):
            await a.publish(growing(1)[0])
    assert [str(error) for error in unrecorded] == [f"[Errno 28] No space left on device: '{out}'"]


@pytest.mark.skipif("FLEETMAP_RERUN" not in os.environ, reason="FLEETMAP_RERUN is not set: no rerun")
async def test_rerun_shows_map_and_transforms(tmp_path):
    path, converted = tmp_path / "run.mcap", tmp_path / "run.rrd"
    await record(path)
    rerun = Path(os.environ["FLEETMAP_RERUN"])
    environment = {**os.environ, "HOME": str(tmp_path)}

    def run(*arguments):
        command = [rerun, *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=60, check=True, env=environment).stdout

    await asyncio.to_thread(run, "mcap", "convert", path, "-o", converted)
    shown = await asyncio.to_thread(run, "rrd", "print", converted)
    assert "/map - data columns: [CoordinateFrame:frame GridMap:cell_size" in shown
    assert "/tf - data columns: [Transform3D:child_frame Transform3D:parent_frame" in shown
