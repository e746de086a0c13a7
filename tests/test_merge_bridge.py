"""Second sights that close a hole in a thin wall stay."""

import numpy as np
import pytest
from rooms import KINDS, is_shut, make_room

from fleetmap.merge import bridge, fold, select


def pieces(*rows):
    """Pieces (y0, x0, y1, x1, stays), lower ends first: ends, cells of 10 steps, which stay, which would go."""
    table = np.array(sorted((*min(r[:2], r[2:4]), *max(r[:2], r[2:4]), r[4]) for r in rows))
    stays = table[:, 4] == 1
    return table[:, :4], np.full(len(table), 10), stays, ~stays


WEDGES = [(-4, 0, 0, 200, 1), (4, 0, 0, 200, 1), (0, 240, -4, 400, 1), (0, 240, 4, 400, 1)]
"""Two wedges along x whose tips are four cells apart."""


def bridged(*rows):
    ends, cell, stays, gone = pieces(*rows)
    return ends[bridge.bridges(ends, cell, stays, gone)].tolist()


def test_from_tip_to_tip_one_way_stays_and_the_shorter_one():
    lower = [(0, 200, -3, 220, 0), (-3, 220, 0, 240, 0)]
    upper = [(0, 200, 8, 220, 0), (8, 220, 0, 240, 0)]
    assert bridged(*WEDGES, *lower, *upper) == [[-3, 220, 0, 200], [-3, 220, 0, 240]]


def test_what_leads_back_to_the_same_wall_goes():
    """The end of a wall, as somebody else saw it a little farther away."""
    rows = [(0, 0, 0, 200, 1), (0, 200, 10, 200, 1), (10, 200, 10, 0, 1)]
    cap = [(0, 200, 0, 215, 0), (0, 215, 10, 215, 0), (10, 215, 10, 200, 0)]
    assert bridged(*rows, *cap) == []


def test_beyond_twice_the_reach_of_a_second_sight_nothing_is_a_hole():
    far = [(y0, x0 + (x0 > 200) * 100, y1, x1 + (x1 > 200) * 100, s) for y0, x0, y1, x1, s in WEDGES]
    assert bridged(*far, (0, 200, 0, 340, 0)) == []


@pytest.mark.parametrize("seed", [121, 316, 350, 508])
def test_rooms_of_thin_walls_that_several_robots_see_stay_closed(seed, monkeypatch):
    room = make_room(np.random.default_rng(seed), KINDS[seed % 3])
    sources = room.sources(("share", "full")[seed // 3 % 2])
    assert all(is_shut(fold(sources).to_grid(r), room.outline) for r in (0.025, 0.05, 0.1))
    # Without the bridges there is a way out.
    monkeypatch.setattr(select, "bridges", lambda ends, *_: np.zeros(len(ends), bool))
    assert not all(is_shut(fold(sources).to_grid(r), room.outline) for r in (0.025, 0.05, 0.1))
