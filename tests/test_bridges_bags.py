"""Bags of others are judged, and played as robots of a fleet."""

import asyncio
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from bags import BEGIN_NS, FORMS, STEP_NS, conversation, growing, write_bag
from conftest import two_rooms
from mcap.reader import make_reader
from rosbags.rosbag2 import StoragePlugin, Writer

import fleetmap
from fleetmap.bridges import bag_stats, cdr, grids
from fleetmap.bridges.bag_stats import Thresholds, judge
from fleetmap.bridges.bags import Bag, is_bag, map_topics
from fleetmap.bridges.player import play_map
from fleetmap.codecs.baselines import gzip_changed_rectangle, gzip_grid
from fleetmap.model.errors import ConfigError, MapFormatError, MapWarning
from fleetmap.model.pose import Pose2
from fleetmap.peer.memory_link import LoopClock, MemoryHub
from fleetmap.vectorize import Vectorizer

forms = pytest.mark.parametrize("form", FORMS)


def index_bytes(path: Path, topic: str) -> int:
    """What the bag itself says, read by other programs than ours."""
    if path.suffix == ".bag":
        from rosbags.rosbag1 import Reader

        with Reader(path) as reader:
            return sum(len(data) for connection, _, data in reader.messages() if connection.topic == topic)
    if list(path.glob("*.db3")):
        (file,) = path.glob("*.db3")
        with sqlite3.connect(file) as database:
            asked = "select sum(length(data)) from messages join topics on topic_id = topics.id where name = ?"
            return int(database.execute(asked, [topic]).fetchone()[0])
    (file,) = path.glob("*.mcap")
    with file.open("rb") as stream:
        return sum(len(message.data) for _, _, message in make_reader(stream).iter_messages(topics=[topic]))


@forms
def test_a_bag_is_judged_as_its_index_says_and_as_grids_cost(form, tmp_path):
    maps = growing()
    path = write_bag(tmp_path / "bag", form, list(conversation(maps)))
    cost = judge(path, topics=[])
    (topic,) = cost.topics
    assert (topic.name, topic.messages, topic.updates, topic.refused) == ("/map", 4, 4, 0)
    assert topic.size_bytes == index_bytes(path, "/map") + index_bytes(path, "/map_updates")
    assert topic.sizes["grid_gzip_full"] == sum(map(gzip_grid, maps))
    steps = zip([None, *maps[:-1]], maps, strict=True)
    assert topic.sizes["grid_gzip_updates"] == sum(gzip_changed_rectangle(a, b) for a, b in steps)
    assert 0 < topic.sizes["vector"] < topic.sizes["grid_gzip_updates"]
    assert topic.series[-1][1] == {"bag": topic.size_bytes, **topic.sizes}
    assert topic.series[-1][0] == pytest.approx(7 * STEP_NS / 1e9)
    vectorizer = Vectorizer()
    assert topic.about["edges"] == [len(vectorizer.update(grid)) for grid in maps][-1]
    assert cost.duration_s == pytest.approx(3.5, abs=0.01)


async def test_vectors_of_a_bag_cost_what_a_robot_sends(tmp_path):
    path = write_bag(tmp_path / "bag", "mcap", list(conversation(growing())))
    (topic,) = judge(path, topics=[]).topics
    async with fleetmap.join("r1", start=Pose2(), link=MemoryHub(LoopClock()).link("r1")) as peer:
        for grid in growing():
            await peer.publish(grid)
        stats = peer.stats()
    # The first record of a robot that joined also says its start and level.
    assert topic.sizes["vector"] == pytest.approx(stats.bytes_deltas, abs=60)
    assert topic.sizes["grid_gzip_updates"] == stats.baselines["grid_gzip_updates"]


def test_many_messages_are_judged_by_two_processes_with_the_same_outcome(tmp_path, monkeypatch):
    path, told = write_bag(tmp_path / "bag", "mcap", list(conversation(growing()))), []
    here = judge(path, topics=[])
    monkeypatch.setattr(bag_stats, "FEW", 0)
    apart = judge(path, topics=[], on_progress=lambda done, total: told.append((done, total)))
    (a,), (b,) = here.topics, apart.topics
    assert (a.size_bytes, a.sizes, a.series) == (b.size_bytes, b.sizes, b.series)
    assert told[-1] == (16, 16)


def test_topics_are_judged_apart_and_can_be_chosen(tmp_path):
    own, others = conversation(growing(4)), conversation(growing(6), topic="/r2/map")
    path = write_bag(tmp_path / "bag", "db3", sorted([*own, *others], key=lambda said: said[2]))
    assert [(t.name, t.messages + t.updates) for t in judge(path, topics=[]).topics] == [("/map", 4), ("/r2/map", 6)]
    assert [t.name for t in judge(path, topics=["/r2/map"]).topics] == ["/r2/map"]
    with pytest.raises(ConfigError, match=r"topic='/x': no topic of grids in .*/map \(nav_msgs/msg/OccupancyGrid\)"):
        judge(path, topics=["/x"])


def test_graded_maps_have_thresholds(tmp_path):
    cells = np.where(two_rooms().cells_yx == 100, 60, two_rooms().cells_yx)
    message = grids.map_message(fleetmap.OccupancyGrid(cells, 0.05), frame_id="map", stamp_ns=BEGIN_NS)
    path = write_bag(tmp_path / "bag", "mcap", [("/map", cdr.MAP, BEGIN_NS, message)])
    with pytest.warns(MapWarning, match="/map: of 6656 known cells"):
        (as_usual,) = judge(path, topics=[]).topics
    (as_meant,) = judge(path, topics=[], thresholds=Thresholds(occupied_above=54.0)).topics
    assert not as_usual.vector_map.obstacle.any()
    assert as_meant.vector_map.obstacle.any()


def test_a_message_that_is_no_map_is_counted_and_the_rest_is_judged(tmp_path):
    talk = list(conversation(growing(4), updates=False))
    talk[2][3].info.width = 7  # of the second map
    path = write_bag(tmp_path / "bag", "mcap", talk)
    (topic,) = judge(path, topics=[]).topics
    assert (topic.messages, topic.refused) == (4, 1)
    assert "expected width x height = 7 x 80" in topic.reason
    assert topic.size_bytes == index_bytes(path, "/map")


def odd_origin(k, talk):
    talk[k][3].info.origin.position.x = 1e9
    return talk


def test_a_map_beyond_all_bounds_is_counted_and_the_rest_is_judged_and_played(tmp_path):
    path = write_bag(tmp_path / "bag", "mcap", odd_origin(2, list(conversation(growing(4), updates=False))))
    (topic,) = judge(path, topics=[]).topics
    assert (topic.messages, topic.refused) == (4, 1)
    assert "at most 17592186 m from 0" in topic.reason

    async def play():
        async with fleetmap.join("r1", start=Pose2(), link=MemoryHub(LoopClock()).link("r1")) as robot:
            with Bag(path) as bag:
                return await play_map(bag, robot, topic="/map", rate=None)

    played = asyncio.run(play())
    assert (played.maps, played.published, played.refused) == (4, 3, 1)


def test_a_topic_with_connections_of_two_types_keeps_its_maps(tmp_path):
    text = ("/map", cdr.TEXT, BEGIN_NS + 5, cdr.make(cdr.TEXT, data="no map"))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {t: writer.add_connection("/map", t, typestore=cdr.typestore()) for t in (cdr.MAP, cdr.TEXT)}
        for _, type_name, now_ns, message in [*conversation(growing(3), updates=False), text]:
            if type_name in connections:
                writer.write(connections[type_name], now_ns, cdr.encode(message, type_name))
    (topic,) = judge(tmp_path / "bag", topics=[]).topics
    assert (topic.messages, topic.refused) == (3, 0)


async def test_a_stamp_of_zero_is_no_pause(tmp_path):
    first, *rest = conversation(growing(3), updates=False)
    path = write_bag(tmp_path / "bag", "mcap", [(first[0], first[1], 0, first[3]), *rest])
    async with fleetmap.join("r1", start=Pose2(), link=MemoryHub(LoopClock()).link("r1")) as robot:
        with Bag(path) as bag:
            async with asyncio.timeout(20):
                played = await play_map(bag, robot, topic="/map", rate=4.0)
    assert played.published == 3


def test_what_is_no_bag_is_refused_with_a_word(tmp_path):
    text = tmp_path / "text.mcap"
    text.write_text("no bag at all")
    other = write_bag(tmp_path / "other", "mcap", [said for said in conversation(growing(2)) if said[0] == "/tf"])
    for path, expected in [
        (text, "no bag that can be read"),
        (tmp_path / "missing.mcap", "missing: expected a bag"),
        (other, r"no nav_msgs/msg/OccupancyGrid in it; there is /tf \(tf2_msgs/msg/TFMessage\)"),
    ]:
        with pytest.raises(MapFormatError, match=expected) as caught:
            judge(path, topics=[])
        assert str(path) in str(caught.value)


@pytest.mark.parametrize("form", ["mcap", "db3"])
def test_a_bag_that_was_cut_is_refused_or_judged_as_far_as_it_goes(form, tmp_path):
    path = write_bag(tmp_path / "bag", form, list(conversation(growing())))
    (file,) = path.glob(f"*.{form}")
    for share in (0.3, 0.7, 0.95):
        cut = tmp_path / f"cut{share}"
        shutil.copytree(path, cut)
        data = file.read_bytes()
        (cut / file.name).write_bytes(data[: int(share * len(data))])
        try:
            judge(cut, topics=[])
        except MapFormatError as error:
            assert str(cut) in str(error)


def test_bags_are_known_by_their_names(tmp_path):
    path = write_bag(tmp_path / "bag", "mcap", list(conversation(growing(2))))
    assert is_bag(path)
    assert is_bag(path / "bag.mcap")
    assert is_bag(Path("x.bag"))
    assert not is_bag(tmp_path)
    assert not is_bag(Path("map.yaml"))


@forms
async def test_a_bag_is_played_as_a_robot(form, tmp_path):
    path = write_bag(tmp_path / "bag", form, list(conversation(growing())))
    hub = MemoryHub(LoopClock())
    async with (
        fleetmap.join("r2", start=Pose2(), link=hub.link("r2")) as other,
        fleetmap.join("r1", start=Pose2(1.0, 0.0, 0.0), link=hub.link("r1")) as robot,
    ):
        with Bag(path) as bag:
            (topic,) = map_topics(bag)
            played = await play_map(bag, robot, topic=topic, rate=None)
        assert (played.maps, played.published, played.refused) == (8, 8, 0)
        merged = await other.synced(at_least=1)
        found = fleetmap.compare(
            merged.to_grid(0.05), fleetmap.OccupancyGrid(two_rooms().cells_yx, 0.05, Pose2(0, 2, 0))
        )
        assert found.MS > 99.9
        async with asyncio.timeout(10):
            while not other.teammates(frame="fleet"):  # noqa: ASYNC110 - a pose goes with the next heartbeat
                await asyncio.sleep(0.05)
        assert other.teammates(frame="fleet")[0].pose.y_m == pytest.approx(1.0)


async def test_a_bag_is_played_in_its_own_time_or_faster(tmp_path):
    path = write_bag(tmp_path / "bag", "mcap", list(conversation(growing(3))))
    async with fleetmap.join("r1", start=Pose2(), link=MemoryHub(LoopClock()).link("r1")) as robot:
        took_s = {}
        for rate in (2.0, 8.0):
            loop = asyncio.get_running_loop()
            began_s = loop.time()
            with Bag(path) as bag:
                await play_map(bag, robot, topic="/map", rate=rate)
            took_s[rate] = loop.time() - began_s
    # The last message is one second after the first one.
    assert took_s[2.0] >= 0.5
    assert 0.125 <= took_s[8.0] < took_s[2.0]
