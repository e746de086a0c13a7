"""Two other ways to find where one occupancy grid lies in another: what ``align.py`` measures ours beside.

- ``features``: what multirobot_map_merge of m-explore does: AKAZE or ORB features of the grids as images, matched
  and fitted by OpenCV's stitching module. Written anew, none of its code (BSD) is here; only the pairwise step,
  without the bundle adjustment over all maps, which for two of them fits the same matches again.
- ``correlative``: an exhaustive correlative matcher in the manner of Olson 2009 and of Cartographer's loop closures:
  all rotations, all translations by FFT in coarse cells, the best of them again in fine ones.

    python benchmarks/align_rivals.py [--each 10] [--first 0] [--kind same]

tries them on generated pairs (``buildings.py``); ``features`` is skipped without OpenCV (pip install fleetmap[bench]).
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from buildings import make_pair
from numpy.typing import NDArray
from scipy import fft, ndimage

from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import OCCUPIED, UNKNOWN
from fleetmap.model.pose import Pose2

CONFIDENCE = 1.0
"""``estimation_confidence`` of multirobot_map_merge, as it comes."""
FILE_GREYS = np.array([254, 0, 205], np.uint8)
"""Of free, occupied and unknown, as map_server saves them."""

COARSE_M = 0.2
YAW_STEP_RAD, FINE_YAW_STEP_RAD = math.radians(1.0), math.radians(0.25)
SIGMA_M, COARSE_SIGMA_M = 0.1, 0.2
"""Of the likelihood about a wall. Coarse cells and yaws are off by half a step themselves: there it is wider."""
FROM_EACH = 20
"""So many translations of each rotation may be refined ..."""
REFINED = 20
"""... and so many poses of them all are, each at least as far from the better ones as: """
APART_M, APART_RAD = 0.5, math.radians(2.5)
NEAR_M, NEAR_RAD = 0.25, math.radians(1.0)
"""How far from its coarse place a pose is refined."""
LEAST_SCORE = 0.62
"""Cartographer's constraint_builder asks for 0.55 nearby and 0.6 anywhere."""
LEAST_SHARE = 0.15
"""Of b's walls, where a knows what is there."""

Floats = NDArray[np.float64]
Plane = NDArray[np.float32]
"""(height, width)."""


@dataclass(frozen=True, slots=True)
class Found:
    """An answer.

    Parameters
    ----------
    accepted : whether the method itself takes it for true
    T_a_b : p_a = T_a_b p_b of its best hypothesis, whether accepted or not; None if there is none
    confidence : the figure that it was accepted by
    scale : lengths in a per length in b, as found; ``T_a_b`` is the rigid transform nearest to what was found
    """

    accepted: bool
    T_a_b: Pose2 | None
    confidence: float
    scale: float = 1.0


NOTHING = Found(False, None, 0.0)


def features(
    a: OccupancyGrid, b: OccupancyGrid, *, confidence: float = CONFIDENCE, kind: str = "akaze", greys: str = "message"
) -> Found:
    """By features of the grids as images, in one thread.

    Parameters
    ----------
    a, b : the grids; b is sampled again if its cells are of another size
    confidence : accepted from here on
    kind : ``akaze`` or ``orb``
    greys : ``message``: the bytes of the ROS message (free 0, occupied 100, unknown 255), as multirobot_map_merge has
        it; ``file``: those of map_server's file, among which walls stand out more
    """
    import cv2

    cv2.setNumThreads(1)
    cv2.setRNGSeed(0)  # the matcher's hash tables are random: its confidence differs by a fifth from run to run
    finder = {"akaze": cv2.AKAZE_create, "orb": cv2.ORB_create}[kind]()
    b = resampled(b, a.resolution_m)
    # Row 0 is the lowest in both images: they are mirrored alike, and x, y of a pixel are those of its cell.
    images = [FILE_GREYS[g.states_yx()] if greys == "file" else g.cells_yx.view(np.uint8) for g in (a, b)]
    seen = [cv2.detail.computeImageFeatures2(finder, image) for image in images]
    # All pairs, image by image; unlike apply, apply2 accepts images without features.
    match = cv2.detail_AffineBestOf2NearestMatcher(full_affine=False).apply2(seen)[2]
    if match.H is None or not len(match.H):
        return NOTHING
    linear, shift = match.H[:2, :2], match.H[:2, 2]
    points = seen[1].getKeypoints()
    inliers = [points[m.queryIdx].pt for m, good in zip(match.getMatches(), match.getInliers(), strict=True) if good]
    # Without its scale, a similarity still maps the middle of what it was fitted to onto the same place.
    middle_b = np.mean(inliers, axis=0)
    middle_a = linear @ middle_b + shift
    yaw_rad = math.atan2(linear[1, 0], linear[0, 0])
    # OpenCV counts pixels from the centre of the first one.
    T_a_b = placed(a, b, yaw_rad, (middle_a + 0.5) * a.resolution_m, (middle_b + 0.5) * a.resolution_m)
    scale = math.hypot(linear[0, 0], linear[1, 0])
    return Found(match.confidence >= confidence, T_a_b, float(match.confidence), scale)


def resampled(grid: OccupancyGrid, resolution_m: float) -> OccupancyGrid:
    """The same map in cells of another size, each of the state at its centre."""
    if grid.resolution_m == resolution_m:
        return grid
    ratio = resolution_m / grid.resolution_m
    rows, columns = (
        np.minimum((np.arange(math.ceil(count / ratio)) + 0.5) * ratio, count - 1).astype(np.int64)
        for count in grid.cells_yx.shape
    )
    return OccupancyGrid(grid.cells_yx[np.ix_(rows, columns)], resolution_m, grid.origin)


def placed(a: OccupancyGrid, b: OccupancyGrid, yaw_rad: float, point_a: Floats, point_b: Floats) -> Pose2:
    """T_a_b that turns by yaw and maps one point onto the other, each in metres from its grid's lower left corner."""
    x, y = point_a - Pose2(yaw_rad=yaw_rad).apply(point_b)
    return a.origin @ Pose2(float(x), float(y), yaw_rad) @ b.origin.inverse()


def correlative(a: OccupancyGrid, b: OccupancyGrid, *, least_score: float = LEAST_SCORE) -> Found:
    """By all rotations and translations: the one that fits best of those that put enough of b's walls where a knows.

    Notes
    -----
    The score is the mean likelihood of these walls; of two poses that fits better for which the sum of what exceeds
    ``least_score`` is greater. The mean alone prefers any short piece of straight wall to the truth (5 of 10 pairs of
    kind ``same`` right, against 10), the sum of likelihoods what is cluttered (8 of 10).
    """
    walls_yx = np.argwhere(b.states_yx() == OCCUPIED)
    if not len(walls_yx) or not (a.states_yx() == OCCUPIED).any():
        return NOTHING
    points = (walls_yx[:, ::-1] + 0.5) * b.resolution_m
    middle_b = points.mean(axis=0)
    points -= middle_b
    fine = Fine(a, points, least_score)
    refined = [fine.refine(pose) for pose in coarse_poses(a, points, least_score)]
    enough = [fit for fit in refined if fit.share >= LEAST_SHARE]
    if not enough:
        return NOTHING
    best = max(enough, key=lambda fit: fit.excess)
    middle_a = np.array([best.pose.x_m, best.pose.y_m])
    return Found(best.score >= least_score, placed(a, b, best.pose.yaw_rad, middle_a, middle_b), best.score)


def coarse_poses(a: OccupancyGrid, points: Floats, least_score: float) -> list[Pose2]:
    """The best poses of the points in coarse cells, from a's lower left corner, the best first."""
    factor = max(1, round(COARSE_M / a.resolution_m))
    cell_m = factor * a.resolution_m
    likely, known = likelihood(a, COARSE_SIGMA_M)
    excess = blocks(likely, factor) - np.float32(least_score) * blocks(known, factor)
    reach = math.ceil(np.hypot(*np.ptp(points, axis=0)) / cell_m) + 2
    shape = tuple(fft.next_fast_len(n + reach, real=True) for n in excess.shape)
    spectrum = fft.rfft2(excess, shape)
    rows = []
    for yaw_rad in np.arange(0.0, 2 * math.pi, YAW_STEP_RAD):
        cells = np.floor(Pose2(yaw_rad=yaw_rad).apply(points) / cell_m).astype(np.int64)
        low = cells.min(axis=0)
        column, row = (cells - low).T
        counts = np.bincount(row * shape[1] + column, minlength=shape[0] * shape[1]).reshape(shape)
        sums = fft.irfft2(spectrum * np.conj(fft.rfft2(counts.astype(np.float32))), shape).ravel()
        best = np.argpartition(-sums, FROM_EACH)[:FROM_EACH]
        shift = np.stack([best % shape[1], best // shape[1]], axis=-1)
        # Farther than a is wide, a shift is one the other way.
        shift -= np.where(shift >= excess.shape[::-1], shape[::-1], 0)
        rows.append(np.column_stack([(shift - low) * cell_m, np.full(FROM_EACH, yaw_rad), sums[best]]))
    found = np.concatenate(rows)
    return apart(found[np.argsort(-found[:, 3], kind="stable")])


def likelihood(grid: OccupancyGrid, sigma_m: float) -> tuple[Plane, Plane]:
    """How likely a wall is in each cell, 0 where nothing is known; and 1 where something is known."""
    states = grid.states_yx()
    known = (states != UNKNOWN).astype(np.float32)
    away_m = ndimage.distance_transform_edt(states != OCCUPIED) * grid.resolution_m
    return np.exp(-0.5 * (away_m / sigma_m) ** 2).astype(np.float32) * known, known


def blocks(plane: Plane, factor: int) -> Plane:
    """The largest value of each block of cells, which stands for the block as in Cartographer's bounds."""
    height, width = (-(-count // factor) for count in plane.shape)
    padded = np.pad(plane, [(0, height * factor - plane.shape[0]), (0, width * factor - plane.shape[1])])
    largest: Plane = padded.reshape(height, factor, width, factor).max(axis=(1, 3))
    return largest


def apart(rows: Floats) -> list[Pose2]:
    """The first poses of the rows (x, y, yaw, sum) that are not near to one before."""
    kept: list[Floats] = []
    for row in rows:
        off = np.array(kept).reshape(-1, 4) - row
        turned = np.abs((off[:, 2] + math.pi) % (2 * math.pi) - math.pi)
        if not ((np.hypot(off[:, 0], off[:, 1]) < APART_M) & (turned < APART_RAD)).any():
            kept.append(row)
            if len(kept) == REFINED:
                break
    return [Pose2(*row[:3]) for row in kept]


class Fit(NamedTuple):
    """How the points fit at a pose: the sum that poses are compared by, the mean likelihood, and of what share."""

    pose: Pose2
    excess: float
    score: float
    share: float


class Fine:
    """The points in fine cells, near a coarse pose."""

    def __init__(self, a: OccupancyGrid, points: Floats, least_score: float) -> None:
        self._points, self._cell_m, self._least_score = points, a.resolution_m, least_score
        self._near = math.ceil(NEAR_M / a.resolution_m)
        # So wide that a point outside of the grid stays in the margin, however it is shifted.
        self._margin = 2 * self._near + 1
        likely, known = (np.pad(plane, self._margin) for plane in likelihood(a, SIGMA_M))
        self._size_xy, self._stride = (a.width, a.height), likely.shape[1]
        self._known, self._excess = known.ravel(), (likely - np.float32(least_score) * known).ravel()

    def refine(self, pose: Pose2) -> Fit:
        """The best fit near a pose."""
        each = range(-self._near, self._near + 1)
        best = Fit(pose, -math.inf, 0.0, 0.0)
        for turn in np.arange(-NEAR_RAD, NEAR_RAD + FINE_YAW_STEP_RAD / 2, FINE_YAW_STEP_RAD):
            turned = Pose2(pose.x_m, pose.y_m, pose.yaw_rad + turn)
            cells = np.floor(turned.apply(self._points) / self._cell_m)
            limits = -self._near - 1, np.array(self._size_xy) + self._near
            where = (np.clip(cells, *limits).astype(np.int64) + self._margin) @ [1, self._stride]
            # Shift by shift: what is looked up for all of them at once doesn't stay in the cache.
            sums = [(float(self._excess[where + y * self._stride + x].sum()), x, y) for y in each for x in each]
            excess, x, y = max(sums)
            if excess > best.excess:
                known = float(self._known[where + y * self._stride + x].sum())
                place = Pose2(pose.x_m + x * self._cell_m, pose.y_m + y * self._cell_m, turned.yaw_rad)
                score = self._least_score + excess / max(known, 1.0)
                best = Fit(place, excess, score, known / len(self._points))
        return best


def main() -> None:
    """Try them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--each", type=int, default=10, help="pairs")
    parser.add_argument("--first", type=int, default=0, help="seed of the first one")
    parser.add_argument("--kind", default="same", help="of buildings.py")
    parser.add_argument("--tiny", action="store_true", help="see that it runs")
    options = parser.parse_args()
    ways: dict[str, Callable[[OccupancyGrid, OccupancyGrid], Found]] = {"correlative": correlative}
    if importlib.util.find_spec("cv2"):
        ways |= {"akaze": features, "orb": lambda a, b: features(a, b, kind="orb")}
    else:
        print("features: skipped, no OpenCV: pip install fleetmap[bench]")
    for seed in range(options.first, options.first + (1 if options.tiny else options.each)):
        pair = make_pair(options.kind, seed)
        for name, find in ways.items():
            began_s = time.process_time()
            found = find(pair.a, pair.b)
            took_s = time.process_time() - began_s
            off_m = math.nan
            if found.T_a_b and pair.T_a_b and len(pair.shared_xy):
                off_m = np.hypot(*(found.T_a_b.apply(pair.shared_xy) - pair.T_a_b.apply(pair.shared_xy)).T).max()
            outcome = "accepted" if found.accepted else "refused"
            print(
                f"{pair.kind} {seed:3}  overlap {pair.overlap:4.0%}  {name:12} {outcome:9} off {off_m:7.3f} m  "
                f"confidence {found.confidence:.3f}  scale {found.scale:.3f}  {took_s:6.2f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
