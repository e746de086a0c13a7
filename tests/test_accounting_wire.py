"""What a link carries beside payloads."""

from __future__ import annotations

import pytest

from fleetmap.accounting.wire import (
    SEGMENT_BYTES,
    TCP_IP_BYTES,
    ZENOH_BYTES,
    estimate_wire_bytes,
    required_bandwidth_kbps,
)


def test_each_message_pays_its_headers_and_a_large_one_those_of_its_segments():
    assert estimate_wire_bytes(0, 0) == 0
    assert estimate_wire_bytes(1, 60) == 60 + ZENOH_BYTES + TCP_IP_BYTES
    assert estimate_wire_bytes(10, 600) == 10 * estimate_wire_bytes(1, 60)
    large = 3 * SEGMENT_BYTES
    assert estimate_wire_bytes(1, large) == large + ZENOH_BYTES + 4 * TCP_IP_BYTES


def test_the_papers_required_bandwidth_is_size_by_time():
    assert required_bandwidth_kbps(39_200, 10.0) == pytest.approx(31.36)
    assert required_bandwidth_kbps(1, 0.0) is None
