"""Strangers without any key, among honest peers in processes of their own: what they say harms nobody for long."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest
from attacks import SAID, Fleet, Stranger
from thirteen import ATTACKS, GROWTH_BYTES, RECOVERY_S, RIGHT_S, Outcome, trial

FACTOR = float(os.environ.get("FLEETMAP_TEST_TIMEOUT_FACTOR", "1"))
TIMEOUT_S = 20.0 * FACTOR
LIES = 200
ATTACK_S = 2.0
SLOWER, SLOWEST_S = 10.0, 1.0
"""How much slower honest words may get, coarsely; a second is never too much. benchmarks/attacks.py shows the ratio."""
SLOW = (4, 8, 9, 12, 13)
"""Where all gets slower as long as it lasts, up to some seconds: no goal, but what is so today."""
PATIENCE = 8.0 if "PYTEST_XDIST_WORKER" in os.environ else 4.0
"""So many times the usual bounds are allowed then; more where another test works beside, on the other core."""


class Fleets:
    """One fleet for all attacks; another one after it was harmed for good."""

    def __init__(self) -> None:
        self.fleet: Fleet | None = None

    def get(self) -> Fleet:
        if self.fleet is None:
            self.fleet = Fleet(late=("e", "f", "g"), timeout_s=TIMEOUT_S).__enter__()
        return self.fleet

    def close(self) -> None:
        if self.fleet is not None:
            self.fleet.close()
        self.fleet = None


@pytest.fixture(scope="module")
def fleets() -> Iterator[Fleets]:
    found = Fleets()
    yield found
    found.close()


def check(outcome: Outcome, factor: float) -> None:
    """What the honest robots are owed."""
    assert outcome.faults == []
    assert outcome.lies == []
    assert outcome.right_s <= RIGHT_S * factor
    assert outcome.recovered_s <= RECOVERY_S * factor
    # Where all gets slower, more of it waits in the queues of the transport.
    assert outcome.growth_bytes <= GROWTH_BYTES * min(factor / FACTOR, 2.0)
    assert max(outcome.under_s) <= max(SLOWEST_S * factor, SLOWER * max(outcome.quiet_s)) * factor


@pytest.mark.parametrize("number", ATTACKS, ids=lambda number: f"{number}-{ATTACKS[number].say.__name__}")
def test_honest_maps_stay_right_and_the_fleet_is_whole_after(number: int, fleets: Fleets) -> None:
    attack, factor = ATTACKS[number], FACTOR * (PATIENCE if number in SLOW else 1.0)
    try:
        outcome = trial(fleets.get(), attack, seconds=ATTACK_S, rng=np.random.default_rng(number), factor=factor)
        check(outcome, factor)
    except BaseException:
        fleets.close()
        raise


def test_random_bytes_of_strangers_are_counted_and_change_no_map() -> None:
    rng = np.random.default_rng(1)
    with Fleet(("a", "b"), rooms=10, timeout_s=TIMEOUT_S) as fleet:
        before = fleet.digests()
        with Stranger(connect=list(fleet.endpoints.values()), timeout_s=TIMEOUT_S) as stranger:
            for i in range(LIES):
                name = ("a", "stranger", f"stranger{i}")[i % 3]
                stranger.put(f"fleetmap/{fleet.fleet}/{name}/{SAID[i % len(SAID)]}", rng.bytes(40))
            for robot in fleet.running:
                # Another robot's lies are dropped; those under the own name are not even looked at.
                fleet.until(lambda robot=robot: fleet.dropped(robot) >= LIES // 2)
        assert fleet.digests() == before
        assert len(set(before.values())) == 1
        assert fleet.wrong() == []
        assert len(fleet.latencies_s(4)) == 4
        assert fleet.wrong() == []
        assert len(set(fleet.synced(at_least=1).values())) == 1
        assert fleet.digests() != before
        fleet.kill("b")
        fleet.until(lambda: fleet.ask("a", "alive")["alive"] == [])
        assert fleet.wrong() == []
