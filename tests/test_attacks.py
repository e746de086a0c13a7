"""The tools of the attacks themselves: honest robots in processes of their own, and a stranger among them."""

from __future__ import annotations

import os

import numpy as np
from attacks import SAID, Fleet, Stranger

TIMEOUT_S = 20.0 * float(os.environ.get("FLEETMAP_TEST_TIMEOUT_FACTOR", "1"))
LIES = 200


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
