"""A robot's bytes beside those of grids, and a fleet's."""

from __future__ import annotations

import pytest

from fleetmap.accounting import BASELINES, Count, Ledger, compare, together, with_heartbeats


def ledger(publishes: int) -> Ledger:
    counted = Ledger()
    for k in range(publishes):
        counted.sent("delta", 40)
        counted.sent("digest", 33)
        counted.published(float(k), {"grid_gzip_full": 5000, "grid_gzip_updates": 1500, "grid_exact_updates": 80})
    counted.sent("digest", 13)
    counted.watched(300)
    return counted


def test_a_fleet_is_the_sum_of_its_robots():
    parts = []
    for publishes in (3, 7):
        stats = ledger(publishes).stats()
        parts.append(compare(stats.sent, stats.grids, 10.0 * publishes))
    fleet = together(parts)
    assert fleet.vector == 10 * 73 + 2 * 13
    assert fleet.time_s == 100.0
    assert fleet.wire.total == sum(part.wire.total for part in parts)
    for name in BASELINES:
        assert fleet.wire_grids[name] == sum(part.wire_grids[name] for part in parts)
        assert fleet.ratio(name) == pytest.approx(fleet.grids[name] / fleet.vector)
    assert together([]).ratio is not None
    assert together([]).wire.total == 0


def test_the_better_the_grid_is_packed_the_nearer_it_comes_and_never_by_what_both_say():
    stats = ledger(20).stats()
    found = compare(stats.sent, stats.grids, 100.0)
    ratios = [found.wire_ratio(name) for name in BASELINES]
    assert ratios == sorted(ratios, reverse=True)
    same = compare(stats.sent, {"grid": stats.sent["delta"]}, 100.0)
    assert same.wire_ratio("grid") == 1.0


def test_what_a_watcher_asks_for_is_not_what_the_robot_sent():
    stats = ledger(1).stats()
    assert stats.watched == Count(1, 300, 1)
    assert stats.bytes_vector == 40 + 33 + 13
    assert "watched" not in stats.sent


def test_an_update_that_changes_nothing_is_no_message():
    counted = Ledger()
    for size in (80, 0, 0, 2000):
        counted.published(0.0, {"grid_exact_updates": size})
    assert counted.stats().grids["grid_exact_updates"] == Count(2, 2080, 3)
    assert counted.stats().baselines == {"grid_exact_updates": 2080}


def test_hearts_beat_in_simulated_time():
    sent = {"digest": Count(3, 39, 3), "delta": Count(1, 50, 1)}
    assert with_heartbeats(sent, 200.0, 2.0) == {"digest": Count(100, 1300, 100), "delta": Count(1, 50, 1)}
    assert with_heartbeats({"delta": Count(1, 50, 1)}, 200.0, 2.0) == {"delta": Count(1, 50, 1)}
