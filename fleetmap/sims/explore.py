"""Which frontier to go to: MinPos over the poses and goals that the robots share, and a memory of failures."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.pose import Pose2
from fleetmap.sims.frontiers import Frontier, find_frontiers
from fleetmap.sims.view import View

SAME_PLACE_M = 1.5
"""Goals nearer to each other than this are one goal."""

HELP = 3.0
"""A frontier is left to a teammate who, by way of its present goal, is this much nearer: far robots come to
help where there is much to do, and not for the last corner that another one is about to see."""

LOYALTY = 0.7
"""A frontier at the present goal counts as this much nearer: robots don't dither between two."""

BLACKLIST_M = 0.7
BLACKLIST_S = 60.0
"""A goal that led to nothing is left out for this long, twice as long after each further failure."""

COST_OF_CELL = 10.0
"""What a cell of open ground costs in a view."""

LEAST_COST = 20
"""Frontiers nearer than two cells are where the robot stands; being there has shown nothing."""


@dataclass(frozen=True, slots=True)
class Teammate:
    """What another robot shares: where it is and where it goes (metres, fleet frame)."""

    name: str
    xy: tuple[float, float]
    goal_xy: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Choice:
    """Where to go: the place of the frontier and the way to it (metres, fleet frame)."""

    frontier_xy: tuple[float, float]
    path_xy: NDArray[np.float64]


@dataclass
class Explorer:
    """Chooses goals for one robot.

    Parameters
    ----------
    name : the robot's; on equal terms the lower name goes first
    """

    name: str
    waiting: bool = False
    """Whether the last choice found frontiers, but all of them taken by teammates who are nearer."""
    _mates: dict[str, Teammate] = field(default_factory=dict)  # as they were at the last choice
    _failures: list[tuple[float, float, float, int]] = field(default_factory=list)  # x, y, until_s, count

    def choose(
        self,
        view: View,
        xy: tuple[float, float],
        *,
        teammates: list[Teammate],
        now_s: float,
        present_xy: tuple[float, float] | None = None,
    ) -> Choice | None:
        """The next goal, or None when there is nothing left to do for this robot.

        MinPos: of the frontiers, take the one for which the fewest teammates are nearer, then the nearest.
        One that a nearer teammate is on its way to, or will soon be at, is that teammate's.
        """
        self._learn(teammates, now_s=now_s)
        costs = view.costs_from(xy)
        frontiers = [f for f in find_frontiers(view, costs) if f.cost >= LEAST_COST]
        places = view.centres_xy(np.array([f.middle_yx for f in frontiers], np.int64).reshape(-1, 2))
        goals = np.array([f.goal_yx for f in frontiers], np.int64).reshape(-1, 2)
        rivals = [(mate, *self._way_of(mate, view, goals)) for mate in teammates] if frontiers else []
        ranked: list[tuple[int, float, Frontier, tuple[float, float]]] = []
        self.waiting = False
        for k, (frontier, (x, y)) in enumerate(zip(frontiers, places.tolist(), strict=True)):
            if self.blacklisted((x, y), now_s=now_s):
                continue
            nearer, taken = 0, False
            for mate, direct, by_goal in rivals:
                if (int(direct[k]), mate.name) < (frontier.cost, self.name):
                    nearer += 1
                    taken |= mate.goal_xy is not None and math.dist(mate.goal_xy, (x, y)) < SAME_PLACE_M
                taken |= HELP * by_goal[k] < frontier.cost
            if taken:
                self.waiting = True
                continue
            stays = present_xy is not None and math.dist(present_xy, (x, y)) < SAME_PLACE_M
            ranked.append((nearer, frontier.cost * (LOYALTY if stays else 1.0), frontier, (x, y)))
        if not ranked:
            return None
        _, _, chosen, place = min(ranked, key=lambda r: r[:2])
        self.waiting = False
        return Choice(place, view.path_to(costs, chosen.goal_yx))

    @staticmethod
    def _way_of(
        mate: Teammate, view: View, goals_yx: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """A teammate's costs to all goals: (n,) on the direct way, and (n,) by way of where it goes now."""
        if mate.goal_xy is None:
            return view.rough_costs_from(mate.xy, goals_yx), np.full(len(goals_yx), np.inf)
        there = np.array(view.cell(mate.goal_xy))
        costs = view.rough_costs_from(mate.xy, np.vstack([goals_yx, there]))
        # From its goal on, the straight line will do.
        return costs[:-1], costs[-1] + COST_OF_CELL * np.hypot(*(goals_yx - there).T)

    def _learn(self, teammates: list[Teammate], *, now_s: float) -> None:
        """A teammate that was at its goal and has another one now has seen that place: no need to go there, too."""
        for mate in teammates:
            before = self._mates.get(mate.name)
            if before is not None and before.goal_xy is not None and mate.goal_xy != before.goal_xy:
                was_there = min(math.dist(before.goal_xy, before.xy), math.dist(before.goal_xy, mate.xy)) < SAME_PLACE_M
                if was_there and not self.blacklisted(before.goal_xy, now_s=now_s):
                    self.failed(before.goal_xy, now_s=now_s)
        self._mates = {mate.name: mate for mate in teammates}

    def failed(self, xy: tuple[float, float], *, now_s: float) -> None:
        """Going to ``xy`` (fleet frame) led to nothing: leave that place out for a while."""
        count = 1
        for old in self._failures:
            if math.dist(old[:2], xy) < BLACKLIST_M:
                count = max(count, old[3] + 1)
        self._failures.append((*xy, now_s + BLACKLIST_S * 2 ** (count - 1), count))

    def moved(self, T_new_old: Pose2) -> None:
        """The fleet's frame is another one from now on."""
        places = [T_new_old.apply(old[:2]).tolist() for old in self._failures]
        self._failures = [(x, y, *old[2:]) for (x, y), old in zip(places, self._failures, strict=True)]
        self._mates = {}

    def blacklisted(self, xy: tuple[float, float], *, now_s: float) -> bool:
        """Whether a place is left out now."""
        return any(now_s < old[2] and math.dist(old[:2], xy) < BLACKLIST_M for old in self._failures)
