"""Where on a map from orbit the rover's relief lies: the likelihood of each place, on a grid.

The relief is that of the corners of keyframes, which are there anyway: some hundred of each, up to
some metres ahead. Its cells are as large as a pixel of the map.

The residuals of the heights have a covariance: errors of the map, which hang together over some
pixels, of the cells, and of the odometry, whose height drifts. The height of the rover is not
known; it is estimated with the place (generalised least squares; Rao, Linear Statistical
Inference, 2nd ed., 1973, 4a.3). The heading is known.

Some craters are missing on a map: residuals that are far off count by their logarithm (Black and
Anandan, Computer Vision and Image Understanding 63, 1996).

One of many places is always the best, on a wrong map too. How well wrong places fit, all of the
map around tells: the lowest of its minima follow a law of extremes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.ndimage import minimum_filter
from scipy.stats import chi2

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap

_FARTHEST_M = 8.0       # from the camera: the height of what lies farther says little
_LEAST_POINTS = 6       # of a cell
# Standard deviation of a height by stereo, and the share of the spread within a cell by which the
# mean of the seen part of it is off that of the whole.
_STEREO_M, _SEEN_PART = 0.02, 1.5
_LEAST_M = 0.05         # spread of places that tells a slope


class _Patch(NamedTuple):
    key: int
    way_m: float
    points_m: Array     # (n, 3) in base


@dataclasses.dataclass(frozen=True)
class Cells:
    """Heights of cells, in the frame of the graph's map.

    Attributes:
        xy_m: (n, 2) mean places of what was seen in them.
        z_m: (n,) mean heights.
        sigma_m: (n,) their standard deviations.
        way_m: (n,) from where on the way they were seen.
        key: Of the keyframe in the middle of the way.
        middle_m: Its place on the way.
    """

    xy_m: Array
    z_m: Array
    sigma_m: Array
    way_m: Array
    key: int
    middle_m: float

    def __len__(self) -> int:
        return len(self.z_m)


class Relief:
    """What was seen from the last keyframes, as points in their axes: it moves with the graph.

    Attributes:
        way_m: Way so far.
    """

    def __init__(self, most_m: float) -> None:
        """Begin.

        Args:
            most_m: Way of which it remembers what was seen.
        """
        self._most_m = most_m
        self._patches: deque[_Patch] = deque()
        self._before: Array | None = None
        self.way_m = 0.0

    @property
    def seen_m(self) -> float:
        """The way of which it remembers what was seen."""
        return self.way_m - self._patches[0].way_m if self._patches else 0.0

    def add(self, key: int, T_map_base: Array, points_m: Array, T_base_left: Array) -> None:
        """Take the points (n, 3) of a keyframe, in its left camera."""
        place = T_map_base[:2, 3]
        if self._before is not None:
            self.way_m += float(math.dist(place, self._before))
        self._before = place.copy()
        near = points_m[points_m[:, 2] < _FARTHEST_M]
        self._patches.append(_Patch(key, self.way_m, near @ T_base_left[:3, :3].T
                                    + T_base_left[:3, 3]))
        while self._patches[0].way_m < self.way_m - self._most_m:
            self._patches.popleft()

    def forget(self) -> None:
        """Begin a new stretch of the way."""
        self._patches.clear()

    def cells(self, poses: Mapping[int, Array], size_m: float) -> Cells | None:
        """Return the cells of the remembered way; None where nothing was seen.

        Args:
            poses: T_map_base (4, 4) of the keyframes.
            size_m: Side of a cell.
        """
        patches = [patch for patch in self._patches if patch.key in poses and len(patch.points_m)]
        if not patches:
            return None
        points = np.vstack([patch.points_m @ poses[patch.key][:3, :3].T + poses[patch.key][:3, 3]
                            for patch in patches])
        way = np.repeat([patch.way_m for patch in patches], [len(p.points_m) for p in patches])
        _, cell, count = np.unique(np.floor(points[:, :2] / size_m).astype(int), axis=0,
                                   return_inverse=True, return_counts=True)
        cell = cell.ravel()

        def mean(values: Array) -> Array:
            return np.asarray(np.bincount(cell, values) / count)

        x, y, z, s = (mean(values) for values in (*points.T, way))
        # What is left of the spread beside a plane: the mean of a plane is at the mean place.
        u, v, w = (points - np.column_stack([x, y, z])[cell]).T
        uu, vv, uv, uw, vw = (mean(a * b) for a, b in ((u, u), (v, v), (u, v), (u, w), (v, w)))
        uu, vv = uu + _LEAST_M**2, vv + _LEAST_M**2
        plane = (vv * uw**2 - 2.0 * uv * uw * vw + uu * vw**2) / (uu * vv - uv**2)
        spread = np.sqrt(np.maximum(mean(w * w) - plane, 0.0))
        good = count >= _LEAST_POINTS
        middle_m = 0.5 * (patches[0].way_m + patches[-1].way_m)
        middle = min(patches, key=lambda patch: abs(patch.way_m - middle_m))
        return Cells(np.column_stack([x, y])[good], z[good],
                     np.hypot(_STEREO_M, _SEEN_PART * spread)[good], s[good], middle.key,
                     middle.way_m)


_LEAST_CELLS = 8
_STEP_PX = 0.5              # of the first grid
_FINE, _FINE_PX = 8, 0.125  # points of the second grid on each side, and their distance
_ROWS = 32                  # of the first grid that are compared at a time
_ROBUST = 2.0               # standard deviations from which a residual counts by its logarithm
# Relief of a few pixels, such as small craters, is missing on a map or has another shape: that
# moves the likeliest place by so many pixels, in x and in y, all over a stretch of way.
_MISSING_PX = 0.3
_DRIFT_M = 0.015            # error of the height by odometry, for each root of a metre of way
_TILT_RAD = 1.5e-3          # of rover and map together
_UNKNOWN_M = 100.0          # standard deviation of the height of the rover
_QUANTILE = 0.999
_BESIDE_PX = 3.0            # places farther from the best than this are others
# Of the minima of wrong places, this share is low, and at least so many.
_LOW, _LEAST_LOW = 0.1, 20
_AROUND = 3.5               # half of the side of what tells of wrong places, in radii of doubt
LEAST_SIDE = 3.0 * math.sqrt(math.pi)   # of a map, in radii of doubt: nine areas as large


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
    """

    shift_m: Array
    covariance: Array
    scale: float
    fits: bool
    others: float
    square: float

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
    shifts, square = likelihood.on_grid(middle_m, reach_m)
    near = (np.linalg.norm(shifts - middle_m, axis=-1) <= reach_m) & np.isfinite(square)
    if not near.any():
        return None
    shifts, square = shifts[near], square[near]
    best = shifts[np.argmin(square)]
    axis = _FINE_PX * pixel * np.arange(-_FINE, _FINE + 1)
    fine = best + np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
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
    here = float(weight.sum()) * _FINE_PX**2
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
    return Match(mean, covariance, scale, fits, others / (others + here),
                 float(square.min()))


def chance(orbital: OrbitalMap, cells: Cells, middle_m: Array, reach_m: float,
           found: Match) -> float:
    """Return how likely a place fits as well, if the rover is not where it was looked for.

    The logarithms of the lowest minima around are taken to have an exponential tail (Hill, Annals
    of Statistics 3, 1975): that of chi^2 is a power.

    Args:
        middle_m, reach_m: As for `match`.
        found: What it found there.

    Returns:
        1 where the map has too few places to tell.
    """
    shifts, square = Likelihood(orbital, cells).on_grid(middle_m, _AROUND * reach_m)
    known = np.isfinite(square)
    is_wrong = (np.linalg.norm(shifts - found.shift_m[:2], axis=-1)
                > _BESIDE_PX * orbital.pixel_m)
    size = 2 * round(_BESIDE_PX / _STEP_PX / 2.0) + 1
    filled = np.where(known, square, np.inf)
    lowest = known & is_wrong & (minimum_filter(filled, size) == filled)
    minima = np.sort(square[lowest])
    count = max(_LEAST_LOW, int(_LOW * len(minima)))
    if len(minima) < 2 * count:
        return 1.0
    limit = minima[count]
    power = count / float(np.log(limit / minima[:count]).sum())
    share = math.pi * (reach_m / (_STEP_PX * orbital.pixel_m))**2 / int(known.sum())
    expected = count * share * math.exp(min(power * math.log(found.square / limit), 10.0))
    return -math.expm1(-expected)


class Likelihood:
    """The squares of the residuals, each over its variance, of cells that are shifted on a map."""

    def __init__(self, orbital: OrbitalMap, cells: Cells) -> None:
        self._orbital, self._cells = orbital, cells
        xy, config = cells.xy_m, orbital.config
        apart = np.linalg.norm(xy[:, None] - xy[None], axis=2)
        alike = (np.exp(-(apart / config.correlation_m)**2) if config.correlation_m
                 else np.eye(len(xy)))
        way = cells.way_m - cells.middle_m
        same = np.sign(way)[:, None] == np.sign(way)[None]
        drift = np.where(same, np.minimum(np.abs(way)[:, None], np.abs(way)[None]), 0.0)
        local = xy - xy.mean(axis=0)
        C = (config.height_stddev_m**2 * alike + np.diag(cells.sigma_m**2)
             + _DRIFT_M**2 * drift + _TILT_RAD**2 * local @ local.T)
        self._W = solve_triangular(cholesky(C, lower=True), np.eye(len(xy)), lower=True)
        ones = self._W @ np.ones(len(xy))
        self.height_variance_m2 = 1.0 / float(ones @ ones + _UNKNOWN_M**-2)
        self._ones = ones

    def at(self, shifts_m: Array) -> tuple[Array, Array]:
        """Return chi^2 (n,) and the best shift of the heights (n,) [m] at (n, 2) shifts.

        Both are NaN where a cell lies beyond the map.
        """
        return self._of(self._orbital.height_at(shifts_m[:, None] + self._cells.xy_m[None]))

    def on_grid(self, middle_m: Array, reach_m: float) -> tuple[Array, Array]:
        """Return shifts (rows, columns, 2) and chi^2 (rows, columns), half pixels apart.

        Args:
            middle_m, reach_m: Middle and half of the side of their square; it ends where a cell
                lies beyond the middles of the outer pixels.
        """
        xy, pixel_m = self._cells.xy_m + middle_m, self._orbital.pixel_m
        first_m, step_m = np.array(self._orbital.first_m), _STEP_PX * pixel_m
        low = np.maximum((xy.min(axis=0) - reach_m - first_m) // pixel_m, 0.0).astype(int)
        high = np.maximum((xy.max(axis=0) + reach_m - first_m) // pixel_m + 3.0, 0.0).astype(int)
        lattice = _on_half_pixels(self._orbital.heights_m[low[1]:high[1], low[0]:high[0]])
        place = (xy - first_m - pixel_m * low) / step_m
        reach = math.ceil(reach_m / step_m)
        low = np.maximum(-reach, np.ceil(-place.min(axis=0))).astype(int)
        most = np.array(lattice.shape[::-1]) - 2 - np.floor(place.max(axis=0)).astype(int)
        columns, rows = np.maximum(np.minimum(reach, most) - low + 1, 0)
        shifts = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + low
        first = np.floor(place + low).astype(int)
        part = place + low - first
        square = np.empty((rows, columns))
        for top in range(0, rows, _ROWS):
            there = np.empty((min(_ROWS, rows - top), columns, len(place)))
            for cell, ((column, row), (u, v)) in enumerate(zip(first, part)):
                some = lattice[row + top:row + top + len(there) + 1, column:column + columns + 1]
                some = (1.0 - u) * some[:, :-1] + u * some[:, 1:]
                there[..., cell] = (1.0 - v) * some[:-1] + v * some[1:]
            square[top:top + len(there)] = self._of(there)[0]
        return middle_m + step_m * shifts, square

    def _of(self, heights_m: Array) -> tuple[Array, Array]:
        """Return chi^2 and the best shift of the heights for (..., n) heights of the map."""
        residual = (heights_m - self._cells.z_m) @ self._W.T
        height = residual @ self._ones * self.height_variance_m2
        left = residual - height[..., None] * self._ones
        return _ROBUST**2 * np.log1p((left / _ROBUST)**2).sum(axis=-1), height


def _on_half_pixels(heights_m: NDArray[np.float32]) -> Array:
    """Return heights, and those of the bilinear surface half way between."""
    rows, columns = heights_m.shape
    fine = np.empty((max(2 * rows - 1, 0), max(2 * columns - 1, 0)))
    fine[::2, ::2] = heights_m
    fine[1::2, ::2] = 0.5 * (fine[2::2, ::2] + fine[:-2:2, ::2])
    fine[:, 1::2] = 0.5 * (fine[:, 2::2] + fine[:, :-2:2])
    return fine
