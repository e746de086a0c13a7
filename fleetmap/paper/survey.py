"""One terrain surveyed: the grid that a SLAM would have made of it, and the truth that it is scored against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE, OCCUPIED, UNKNOWN
from fleetmap.paper.drift import pose_errors
from fleetmap.paper.sensor import REACH_M, Sensor
from fleetmap.paper.terrains import Terrain
from fleetmap.paper.tour import Tour, plan_tour
from fleetmap.sims.worlds import World

OFFSET_XY = (0.4, 0.3)
"""Where the world's lattice lies on the mapper's, in cells: no SLAM knows the walls' own raster. Under half a cell, so
that the truth on the mapper's lattice (what each cell's centre lies in) has the same cells as the world."""

MIN_PASSES, LEAST_RATIO = 2, 0.1
"""A cell is known when more beams than this passed it, and occupied when more than this share of them ended in it:
Karto's MinPassThrough and OccupancyThreshold, by default."""

TRUTH_BEAMS = 2880
"""Exact beams by which it is found what was in sight: 2.6 cm from each other at full reach."""

SKIN_CELLS = 2.0
"""How deep behind free space the truth is occupied. What is deeper no sensor can know, so it is unknown."""


@dataclass(frozen=True, slots=True)
class Survey:
    """What a terrain gave.

    Parameters
    ----------
    grid, truth : on one lattice, the extent of the terrain
    tour : where the robot drove
    seen : share of the terrain's open cells that were in sight from somewhere
    """

    grid: OccupancyGrid
    truth: OccupancyGrid
    tour: Tour
    seen: float


def survey_terrain(terrain: Terrain) -> Survey:
    """Drive the tour, scan, count as Karto does, and look around without noise for the truth."""
    from fleetmap.paper.survey_kernels import count_beams, look_around

    world = terrain.make()
    cell_m = world.resolution_m
    rng = np.random.default_rng((terrain.seed, terrain.size_m, 1))
    tour = plan_tour(world)
    errors = pose_errors(tour, cell_m, rng)
    sensor = Sensor(world, rng)

    passes, hits = (np.zeros(world.solid.shape, np.int32) for _ in range(2))
    in_sight = np.zeros(world.solid.shape, bool)
    for (x, y), heading, (off_x_m, off_y_m, off_rad) in zip(tour.places_xy, tour.headings_rad, errors, strict=True):
        ranges = sensor.scan(x, y, heading) / cell_m
        believed_x, believed_y = x + OFFSET_XY[0] + off_x_m / cell_m, y + OFFSET_XY[1] + off_y_m / cell_m
        count_beams(passes, hits, believed_x, believed_y, heading + off_rad, ranges, REACH_M / cell_m)
        look_around(world.solid, in_sight, x, y, TRUTH_BEAMS, REACH_M / cell_m)

    return Survey(
        grid=OccupancyGrid.from_states(decide(passes, hits), cell_m),
        truth=OccupancyGrid.from_states(true_states(world, in_sight), cell_m),
        tour=tour,
        seen=float(in_sight.sum() / (~world.solid).sum()),
    )


def decide(passes: NDArray[np.int32], hits: NDArray[np.int32]) -> NDArray[np.uint8]:
    """(height, width) states from the counts of beams."""
    states = np.full(passes.shape, UNKNOWN, np.uint8)
    known = passes > MIN_PASSES
    states[known] = FREE
    states[known & (hits > LEAST_RATIO * passes)] = OCCUPIED
    return states


def true_states(world: World, in_sight: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """(height, width) states: free what was in sight, occupied the skin of walls behind it, the rest unknown."""
    from scipy import ndimage

    states = np.full(world.solid.shape, UNKNOWN, np.uint8)
    states[in_sight] = FREE
    states[world.solid & (ndimage.distance_transform_edt(~in_sight) <= SKIN_CELLS)] = OCCUPIED
    return states
