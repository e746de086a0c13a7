from __future__ import annotations

import json
import threading

from fleetmap.accounting import Ledger
from fleetmap.accounting.ledger import MAX_KEYS, MAX_SERIES


def test_every_byte_is_counted_once_by_kind_and_robot() -> None:
    ledger = Ledger()
    ledger.sent("delta", 100)
    ledger.sent("delta", 50)
    ledger.sent("digest", 16)
    ledger.received("b", "delta", 70)
    ledger.dropped("b", "delta", 70, reason="duplicate")
    stats = ledger.stats()
    assert (stats.bytes_vector, stats.bytes_deltas) == (166, 150)
    assert stats.received["b", "delta"].messages == 1
    assert stats.dropped["b", "delta/duplicate"].size_bytes == 70


def test_a_snapshot_of_the_counts_does_not_change() -> None:
    ledger = Ledger()
    ledger.sent("delta", 1)
    before = ledger.stats()
    ledger.sent("delta", 1)
    assert before.bytes_vector == 1


def test_baselines_add_up_beside_the_series() -> None:
    ledger = Ledger()
    for t_s in (1.0, 2.0):
        ledger.sent("delta", 10)
        ledger.published(t_s, {"grid_gzip_full": 1000, "grid_gzip_updates": 100})
    out = json.loads(json.dumps(ledger.stats().to_json()))
    assert (out["bytes_vector"], out["bytes_grid_gzip_full"], out["bytes_grid_gzip_updates"]) == (20, 2000, 200)
    assert out["series"][0] == [1.0, {"vector": 10, "deltas": 10, "grid_gzip_full": 1000, "grid_gzip_updates": 100}]


def test_counts_and_series_are_bounded() -> None:
    ledger = Ledger()
    for i in range(MAX_KEYS + 10):
        ledger.received(f"r{i}", "delta", 1)
    for i in range(MAX_SERIES + 10):
        ledger.published(float(i), {})
    stats = ledger.stats()
    assert len(stats.received) == MAX_KEYS + 1
    assert sum(c.messages for c in stats.received.values()) == MAX_KEYS + 10
    assert len(stats.series) <= MAX_SERIES
    assert stats.series[-1][0] == MAX_SERIES + 9


def test_threads_lose_no_count() -> None:
    ledger = Ledger()
    threads = [threading.Thread(target=lambda: [ledger.sent("delta", 1) for _ in range(2000)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert ledger.stats().bytes_vector == 8000
