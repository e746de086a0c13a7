"""Which lives are kept, and what schedules of reboots and lies leave of what robots have said."""

from __future__ import annotations

import numpy as np
import pytest
from exchange import chain, room, rooms
from liars import run_liars
from schedules import run_many_reboots, run_reboots

from fleetmap.codecs.facts import Facts, name_lives, supersede
from fleetmap.engine.lives import NAMED_KEPT, all_named, kept_lives
from fleetmap.engine.stream import Stream


def stream(
    run: int, edges: int, *, names: set[int] = frozenset(), supersedes: dict[int, tuple[int, int]] | None = None
):
    its_chain = chain("r", run, revisions=8)
    facts = Facts().after(name_lives(Facts(), names)).after(supersede(supersedes or {}))
    return Stream("r", its_chain.life, 1, facts, {"0": rooms(edges // 4)}, its_chain.link(1))


def history(rng: np.random.Generator, lives: int) -> list[Stream]:
    """A robot that rebooted so often; each life has heard of any of the former ones, and names them."""
    streams: list[Stream] = []
    for run in range(lives):
        heard = [s for s in streams if rng.random() < 0.7]
        named = all_named(stream(run, 4), heard)
        streams.append(stream(run, 4 * int(rng.integers(1, 40)), names=named))
    return streams


def meet_in_any_order(rng: np.random.Generator, streams: list[Stream]) -> set[int]:
    """What one peer keeps that hears of them one by one, in any order, some again."""
    held: dict[int, Stream] = {}
    order = [streams[int(i)] for i in rng.permutation(len(streams))]
    for s in [*order, *order]:
        held[s.life] = s
        kept = kept_lives(held.values())
        held = {life: one for life, one in held.items() if life in kept}
    return set(held)


@pytest.mark.parametrize("seed", range(40))
def test_the_lives_that_are_kept_do_not_depend_on_the_order_in_which_they_came(seed: int) -> None:
    rng = np.random.default_rng(seed)
    streams = history(rng, int(rng.integers(1, 31)))
    kept = kept_lives(streams)
    for _ in range(5):
        assert meet_in_any_order(rng, streams) == kept
    largest = max(streams, key=lambda s: (s.edges, s.life))
    assert largest.life in kept
    assert len(kept - {s.life for s in streams if not any(s.life in o.names for o in streams)}) <= NAMED_KEPT


def test_a_life_that_nobody_names_is_kept_however_small() -> None:
    streams = [stream(0, 4), *(stream(run, 80) for run in range(1, 9))]
    assert kept_lives(streams) == {s.life for s in streams}


def test_two_that_name_each_other_live_at_the_same_time() -> None:
    a, b = chain("r", 1, revisions=8).life, chain("r", 2, revisions=8).life
    larger = [stream(run, 400) for run in range(3, 8)]
    names = {s.life for s in larger}
    kept = kept_lives([stream(1, 4, names={b, *names}), stream(2, 4, names={a, *names}), *larger])
    assert {a, b} <= kept
    assert len(kept) == 2 + NAMED_KEPT


def test_a_life_that_was_superseded_is_back_with_its_next_word() -> None:
    former = stream(1, 40)
    heir = stream(2, 4, supersedes={former.life: former.state})
    assert kept_lives([former, heir]) == {heir.life}
    its_chain = chain("r", 1, revisions=8)
    goes_on = Stream("r", former.life, 2, former.facts, {"0": room(5)}, its_chain.link(2))
    assert kept_lives([goes_on, heir]) == {former.life, heir.life}


@pytest.mark.parametrize("seed", range(12))
def test_no_reboot_loses_what_a_living_peer_has_merged(seed: int) -> None:
    assert run_reboots(seed) == []


@pytest.mark.parametrize("seed", range(3))
def test_after_many_reboots_all_keep_the_same_lives_and_the_largest(seed: int) -> None:
    assert run_many_reboots(seed, reboots=5 + 5 * seed) == []


@pytest.mark.parametrize("seed", range(4))
def test_neither_a_byzantine_author_nor_a_lying_mirror_replaces_what_an_honest_robot_has_said(seed: int) -> None:
    assert run_liars(seed) == []
