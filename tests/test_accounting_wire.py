"""What a link carries beside payloads."""

from __future__ import annotations

import numpy as np
import pytest

from fleetmap.accounting import Count, Transport, grids_instead, wire_bytes
from fleetmap.accounting.wire import SEGMENT_BYTES, TCP_IP_BYTES, keep_alives, required_bandwidth_kbps
from fleetmap.peer.profiles import zenoh_settings


def counts(**sizes: list[int]) -> dict[str, Count]:
    found = {kind: Count() for kind in sizes}
    for kind, count in found.items():
        for size in sizes[kind]:
            count.add(size)
    return found


@pytest.mark.parametrize("profile", ["lan", "local"])
def test_the_estimator_knows_the_transport_that_peers_open(profile):
    settings = zenoh_settings(profile, listen=[], connect=[], config=None)
    assert settings["transport/link/tx/lease"] == 1000 * Transport().lease_s
    assert "timestamping/enabled" not in settings


@pytest.mark.parametrize(
    ("kind", "payload", "seen"),
    [("digest", 39, 78), ("delta", 39, 77)],
)
def test_a_message_is_framed_as_it_was_seen_on_a_link(kind, payload, seen):
    """Between two sessions of Zenoh 1.10, with what leads the batch."""
    found = wire_bytes(counts(**{kind: [payload]}), 0.0)
    assert found.payload + found.zenoh == seen
    assert (found.tcp_ip, found.acknowledgements, found.keep_alives) == (TCP_IP_BYTES, TCP_IP_BYTES, 0)


def test_questions_and_answers_are_framed_as_they_were_seen():
    asked = wire_bytes(counts(want=[0]), 0.0)
    assert (asked.zenoh, asked.acknowledgements) == (20 + 2, 0)
    answered = wire_bytes(counts(list=[18]), 0.0)
    assert answered.payload + answered.zenoh == 81 + 2 + 17
    assert (answered.tcp_ip, answered.acknowledgements) == (TCP_IP_BYTES, TCP_IP_BYTES)


def test_an_idle_link_of_a_lease_of_ten_seconds_carries_what_was_measured():
    assert wire_bytes({}, 1000.0, Transport(lease_s=10.0)).total / 1000 == pytest.approx(42.8)
    assert wire_bytes({}, 1000.0, Transport(lease_s=40.0)).total / 1000 == pytest.approx(10.7)
    assert wire_bytes({}, 0.0).total == 0


def test_a_large_message_pays_for_its_segments_and_one_acknowledgement_for_two():
    found = wire_bytes(counts(delta=[10 * SEGMENT_BYTES]), 0.0)
    assert found.tcp_ip == 11 * TCP_IP_BYTES
    assert found.acknowledgements == 6 * TCP_IP_BYTES


@pytest.mark.parametrize("regular", [0, 30, 200])
@pytest.mark.parametrize("others", [0, 20, 600])
def test_keep_alives_are_those_of_a_link_that_is_watched_message_by_message(regular, others):
    rng = np.random.default_rng(regular + others)
    time_s, every_s, seen = 400.0, 0.75, []
    for _ in range(60):
        at = np.concatenate([(np.arange(regular) + 1.0) * time_s / max(regular, 1), rng.uniform(0.0, time_s, others)])
        gaps = np.diff(np.sort(np.concatenate([at, [0.0, time_s]])))
        seen.append(np.floor(gaps / every_s + 1e-9).sum())
    found = keep_alives(time_s, regular=regular, others=others, every_s=every_s)
    assert found == pytest.approx(np.mean(seen), rel=0.02, abs=1.0)


def test_a_fleet_of_grids_says_all_that_is_no_map_just_as_well():
    sent = counts(delta=[40] * 9, digest=[23] * 50, want=[20], repair=[400], list=[50])
    instead = grids_instead(sent, counts(grid=[5000] * 9)["grid"])
    assert set(instead) == {"delta", "digest"}
    ours, theirs = wire_bytes(sent, 100.0), wire_bytes(instead, 100.0)
    more = theirs.total - ours.total
    assert theirs.payload == 9 * 5000 + 50 * 23
    assert more > 9 * (5000 - 40) - 1500
    # What both say brings the ratio down from that of the maps alone.
    assert theirs.total / ours.total < 5000 / 40 / 4
    assert wire_bytes(grids_instead(sent, sent["delta"]), 100.0).total < ours.total


def test_the_papers_required_bandwidth_is_size_by_time():
    assert required_bandwidth_kbps(39_200, 10.0) == pytest.approx(31.36)
    assert required_bandwidth_kbps(1, 0.0) is None
