"""Where on a map from orbit the rover's relief lies: the likelihood of each place, on a grid.

The residuals of the heights have a covariance: errors of the map, which hang together over some
pixels, of the cells, and of the odometry, whose height drifts. The height of the rover is not
known; it is estimated with the place (generalised least squares; Rao, Linear Statistical
Inference, 2nd ed., 1973, 4a.3). The heading is known.

One of many places is always the best, on a wrong map too. How good the best of a wrong area is,
the areas around tell: the least squares in them follow a law of extremes.
"""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import chi2

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
from lunar_rover_sim.judge.slam.graph.relief import Cells

_LEAST_CELLS = 8
_STEP_PX = 0.5              # of the first grid, in pixels of the map
_FINE, _FINE_PX = 8, 0.125  # points of the second grid on each side, and their distance
_TILE = 512                 # places that are compared at a time
# What a map says of its errors is smooth. Besides, ground between its pixels is off by this share
# of a pixel.
_ALONE = 0.015
# Relief of a few pixels, such as small craters, is missing on a map or has another shape: that
# moves the likeliest place by so many pixels, in x and in y, all over a stretch of way.
_MISSING_PX = 0.3
_DRIFT_M = 0.01             # error of the height by odometry, for each root of a metre of way
_TILT_RAD = 1.5e-3          # of rover and map together
_UNKNOWN_M = 100.0          # standard deviation of the height of the rover
_QUANTILE = 0.999
_BESIDE_PX = 3.0            # places farther from the best than this are others
_RING, _LEAST_AREAS, _INSIDE = 2, 5, 0.4    # of areas around; share of one that is on the map
_EULER = 0.5772156649       # mean of the Gumbel distribution
LEAST_SIDE = 3.0 * math.sqrt(math.pi)   # of a map, in radii of doubt: nine areas


@dataclasses.dataclass(frozen=True)
class Match:
    """The likeliest shift from the graph's map to the site.

    Attributes:
        shift_m: (3,) to be added to places and heights.
        covariance: (3, 3) of it, the errors of the map that are the same everywhere left out.
        scale: Mean square of the residuals, over that assumed.
        fits: Whether chi^2 believes that the rover is there.
        others: Share of the probability of other places.
        square: The least chi^2 on the first grid.
        cells: How many heights were compared.
    """

    shift_m: Array
    covariance: Array
    scale: float
    fits: bool
    others: float
    square: float
    cells: int

    @property
    def sigma_m(self) -> float:
        """Largest horizontal standard deviation."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))


def match(orbital: OrbitalMap, cells: Cells, middle_m: Array, reach_m: float) -> Match | None:
    """Return where the cells lie on a map; None where that cannot be told at all.

    Args:
        middle_m: (2,) middle of the shifts that are looked at.
        reach_m: Radius of them; all are alike before.
    """
    if len(cells) < _LEAST_CELLS:
        return None
    likelihood = Likelihood(orbital, cells)
    pixel = orbital.pixel_m
    shifts = disc(middle_m, reach_m, _STEP_PX * pixel)
    square, _ = likelihood.at(shifts)
    if not np.isfinite(square).any():
        return None
    best = shifts[np.nanargmin(square)]
    fine = best + disc(np.zeros(2), np.inf, _FINE_PX * pixel, _FINE)
    fine_square, heights = likelihood.at(fine)
    if not np.isfinite(fine_square).any():
        return None
    low = float(np.nanmin(fine_square))
    dof = len(cells) - 3
    scale = low / dof
    spread = max(1.0, scale)

    def probability(squares: Array) -> Array:
        return np.asarray(np.nan_to_num(np.exp(-0.5 * (squares - low) / spread)))

    coarse = probability(square)
    beside = np.linalg.norm(shifts - best, axis=1) > _BESIDE_PX * pixel
    weight = probability(fine_square)
    near = float(weight.sum()) * _FINE_PX**2
    others = float(coarse[beside].sum()) * _STEP_PX**2
    weight /= weight.sum()
    places = np.column_stack([fine, np.nan_to_num(heights)])
    mean = weight @ places
    off = places - mean
    covariance = (weight[:, None] * off).T @ off
    covariance += np.diag([*2 * [(_FINE_PX**2 / 12.0 + _MISSING_PX**2) * pixel**2],
                           spread * likelihood.height_variance_m2])
    # A place at the rim of the fine grid is no peak: all that was looked at is as likely.
    if np.abs(mean[:2] - best).max() > 0.75 * _FINE * _FINE_PX * pixel:
        covariance[:2, :2] += (_FINE * _FINE_PX * pixel)**2 * np.eye(2)
    fits = low <= float(chi2.ppf(_QUANTILE, dof))
    return Match(mean, covariance, scale, fits, others / (others + near),
                 float(np.nanmin(square)), len(cells))


def chance(orbital: OrbitalMap, cells: Cells, middle_m: Array, reach_m: float,
           square: float) -> float:
    """Return how likely the best place of an area fits as well, if the rover is not in it.

    The logarithms of the least chi^2 of areas that are as large, around the one that was searched,
    are taken to have a Gumbel distribution, fitted by its moments (Gumbel, Statistics of Extremes,
    1958): the lower tail of chi^2 is a power.

    Args:
        middle_m, reach_m: As for `match`.
        square: The least chi^2 that `match` found there.

    Returns:
        1 where the map has too few areas to tell.
    """
    likelihood, step_m = Likelihood(orbital, cells), _STEP_PX * orbital.pixel_m
    side_m = math.sqrt(math.pi) * reach_m
    area = disc(np.zeros(2), np.inf, step_m, int(0.5 * side_m / step_m))
    west, south, east, north = orbital.bounds_m
    low, high = cells.xy_m.min(axis=0), cells.xy_m.max(axis=0)
    best = []
    for place in itertools.product(range(-_RING, _RING + 1), repeat=2):
        shifts = middle_m + side_m * np.array(place) + area
        shifts = shifts[((shifts + low > (west, south)) & (shifts + high < (east, north))).all(
            axis=1)]
        if any(place) and len(shifts) >= _INSIDE * len(area):
            squares, _ = likelihood.at(shifts)
            if np.isfinite(squares).any():
                best.append(math.log(np.nanmin(squares)))
    if len(best) < _LEAST_AREAS:
        return 1.0
    beta = float(np.std(best, ddof=1)) * math.sqrt(6.0) / math.pi
    mode = float(np.mean(best)) + _EULER * beta
    return -math.expm1(-math.exp(min((math.log(square) - mode) / beta, 10.0)))


def disc(middle_m: Array, reach_m: float, step_m: float, count: int | None = None) -> Array:
    """Return (n, 2) points of a grid within a radius, or `count` of them to each side."""
    if count is None:
        count = int(np.ceil(reach_m / step_m))
    axis = step_m * np.arange(-count, count + 1)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return np.asarray(middle_m + grid[np.linalg.norm(grid, axis=1) <= reach_m])


class Likelihood:
    """The squares of the residuals, each over its variance, of cells that are shifted on a map."""

    def __init__(self, orbital: OrbitalMap, cells: Cells) -> None:
        self._orbital, self._cells = orbital, cells
        xy, config, pixel_m = cells.xy_m, orbital.config, orbital.pixel_m
        apart = np.linalg.norm(xy[:, None] - xy[None], axis=2)
        alike = (np.exp(-(apart / config.correlation_m)**2) if config.correlation_m
                 else np.eye(len(xy)))
        way = cells.way_m - cells.middle_m
        same = np.sign(way)[:, None] == np.sign(way)[None]
        drift = np.where(same, np.minimum(np.abs(way)[:, None], np.abs(way)[None]), 0.0)
        local = xy - xy.mean(axis=0)
        C = (config.height_stddev_m**2 * alike + (_ALONE * pixel_m)**2 * np.eye(len(xy))
             + np.diag(cells.sigma_m**2) + _DRIFT_M**2 * drift + _TILT_RAD**2 * local @ local.T)
        self._W = solve_triangular(cholesky(C, lower=True), np.eye(len(xy)), lower=True)
        ones = self._W @ np.ones(len(xy))
        self.height_variance_m2 = 1.0 / float(ones @ ones + _UNKNOWN_M**-2)
        self._ones = ones

    def at(self, shifts_m: Array) -> tuple[Array, Array]:
        """Return chi^2 (n,) and the best shift of the heights (n,) [m] at (n, 2) shifts.

        Both are NaN where a cell lies beyond the map.
        """
        square, height = np.full(len(shifts_m), np.nan), np.full(len(shifts_m), np.nan)
        for first in range(0, len(shifts_m), _TILE):
            some = slice(first, first + _TILE)
            there = self._orbital.height_at(shifts_m[some, None] + self._cells.xy_m[None])
            residual = (there - self._cells.z_m) @ self._W.T
            height[some] = residual @ self._ones * self.height_variance_m2
            left = residual - height[some, None] * self._ones
            square[some] = np.einsum('ij,ij->i', left, left)
        return square, height
