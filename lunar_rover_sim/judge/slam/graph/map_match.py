"""Where on a map from orbit the rover's relief lies: the likelihood of each place, on a grid.

Heights are compared with those of the map, and slopes with the brightness of its photo, if it has
one. Cells of the relief are as large as a pixel.

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

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.ndimage import minimum_filter
from scipy.stats import chi2

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.mapped_ground import on_axes
from lunar_rover_sim.ground.world.orbital_map import bilinear, OrbitalMap
from lunar_rover_sim.judge.slam.graph.photo import Photo
from lunar_rover_sim.judge.slam.graph.relief import Cells, Facets

LEAST_CELLS = 8
_STEP_PX = 0.5              # of the first grid
_FINE, _FINE_PX = 8, 0.125  # points of the second grid on each side, and their distance
_ROWS = 32                  # of the first grid that are compared at a time
_ROBUST = 2.0               # standard deviations from which a residual counts by its logarithm
# Relief of a few pixels, such as small craters, is missing on a map or has another shape: that
# moves the likeliest place by so many pixels, in x and in y, all over a stretch of way. Those of a
# photo are the finer ones.
_MISSING_PX = 0.3
_DRIFT_M = 0.015            # error of the height by odometry, for each root of a metre of way
_TILT_RAD = 1.5e-3          # of rover and map together
_UNKNOWN = 100.0            # standard deviation of the height of the rover [m], and of the light
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


def match(likelihood: Likelihood, middle_m: Array, reach_m: float) -> Match | None:
    """Return where cells lie on a map; None where that cannot be told at all.

    Args:
        middle_m: (2,) middle of the shifts that are looked at.
        reach_m: Radius of them; all are alike before.
    """
    pixel = likelihood.pixel_m
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
    dof = likelihood.count - 3
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
    covariance += np.diag([*2 * [_FINE_PX**2 / 12.0 * pixel**2
                                 + (_MISSING_PX * likelihood.finest_m)**2],
                           spread * likelihood.height_variance_m2])
    # A place at the rim of the fine grid is no peak: all that was looked at is as likely.
    if np.abs(mean[:2] - best).max() > 0.75 * _FINE * _FINE_PX * pixel:
        covariance[:2, :2] += (_FINE * _FINE_PX * pixel)**2 * np.eye(2)
    fits = low <= float(chi2.ppf(_QUANTILE, dof))
    return Match(mean, covariance, scale, fits, others / (others + here),
                 float(square.min()))


def chance(likelihood: Likelihood, middle_m: Array, reach_m: float, found: Match) -> float:
    """Return how likely a place fits as well, if the rover is not where it was looked for.

    The logarithms of the lowest minima around are taken to have an exponential tail (Hill, Annals
    of Statistics 3, 1975): that of chi^2 is a power.

    Args:
        middle_m, reach_m: As for `match`.
        found: What it found there.

    Returns:
        1 where the map has too few places to tell.
    """
    shifts, square = likelihood.on_grid(middle_m, _AROUND * reach_m)
    known = np.isfinite(square)
    is_wrong = (np.linalg.norm(shifts - found.shift_m[:2], axis=-1)
                > _BESIDE_PX * likelihood.pixel_m)
    size = 2 * round(_BESIDE_PX / _STEP_PX / 2.0) + 1
    filled = np.where(known, square, np.inf)
    lowest = known & is_wrong & (minimum_filter(filled, size) == filled)
    minima = np.sort(square[lowest])
    count = max(_LEAST_LOW, int(_LOW * len(minima)))
    if len(minima) < 2 * count:
        return 1.0
    limit = minima[count]
    power = count / float(np.log(limit / minima[:count]).sum())
    share = math.pi * (reach_m / (_STEP_PX * likelihood.pixel_m))**2 / int(known.sum())
    expected = count * share * math.exp(min(power * math.log(found.square / limit), 10.0))
    return -math.expm1(-expected)


class Likelihood:
    """The squares of the residuals, each over its variance, of cells that are shifted on a map.

    Args:
        facets: With the photo on which they are compared; None: heights alone.
    """

    def __init__(self, orbital: OrbitalMap, cells: Cells, photo: Photo | None = None,
                 facets: Facets | None = None) -> None:
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
        self.pixel_m, self._step_m = orbital.pixel_m, _STEP_PX * orbital.pixel_m
        self._layers = [_Layer(orbital.heights_m, orbital.first_m, orbital.pixel_m, xy,
                               cells.z_m, C)]
        if photo is not None and facets is not None and len(facets) >= LEAST_CELLS:
            self._layers.append(_Layer(photo.values, photo.first_m, photo.pixel_m, facets.xy_m,
                                       *photo.expected(facets)))

    @property
    def height_variance_m2(self) -> float:
        """Variance of the height of the rover."""
        return self._layers[0].offset_variance

    @property
    def finest_m(self) -> float:
        """Side of the smallest pixels that are compared."""
        return min(layer.pixel_m for layer in self._layers)

    @property
    def count(self) -> int:
        """Number of residuals."""
        return sum(len(layer) for layer in self._layers)

    def at(self, shifts_m: Array) -> tuple[Array, Array]:
        """Return chi^2 (n,) and the best shift of the heights (n,) [m] at (n, 2) shifts.

        Both are NaN where a cell lies beyond the map.
        """
        square, height = self._layers[0].at(shifts_m)
        for layer in self._layers[1:]:
            square = square + layer.at(shifts_m)[0]
        return square, height

    def on_grid(self, middle_m: Array, reach_m: float) -> tuple[Array, Array]:
        """Return shifts (rows, columns, 2) and chi^2 (rows, columns), half pixels apart.

        Args:
            middle_m, reach_m: Middle and half of the side of their square; it ends where a cell
                lies beyond the middles of the outer pixels.
        """
        reach = math.ceil(reach_m / self._step_m)
        low, high = np.full(2, -reach), np.full(2, reach)
        for layer in self._layers:
            least, most = layer.bounds(middle_m, self._step_m)
            low, high = np.maximum(low, least), np.minimum(high, most)
        columns, rows = np.maximum(high - low + 1, 0)
        shifts = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + low
        shifts = middle_m + self._step_m * shifts
        square = np.zeros((rows, columns))
        if square.size:
            for layer in self._layers:
                layer.add_on_grid(square, shifts[0, 0], self._step_m)
        return shifts, square


class _Layer:
    """Values that cells should have on a raster, but for an offset that all of them have."""

    def __init__(self, raster: NDArray[np.float32], first_m: tuple[float, float],
                 pixel_m: float, xy_m: Array, values: Array, covariance: Array) -> None:
        self._raster, self._first_m, self.pixel_m = raster, first_m, pixel_m
        self._xy_m, self._values = xy_m, values
        self._W = solve_triangular(cholesky(covariance, lower=True), np.eye(len(xy_m)),
                                   lower=True)
        self._ones = self._W @ np.ones(len(xy_m))
        self.offset_variance = 1.0 / float(self._ones @ self._ones + _UNKNOWN**-2)

    def __len__(self) -> int:
        return len(self._values)

    def at(self, shifts_m: Array) -> tuple[Array, Array]:
        """Return chi^2 (n,) and the offset (n,) at (n, 2) shifts; NaN beyond the raster."""
        return self._of(bilinear(self._raster, self._first_m, self.pixel_m,
                                 shifts_m[:, None] + self._xy_m[None]))

    def bounds(self, middle_m: Array, step_m: float) -> tuple[Array, Array]:
        """Return the least and most steps (2,) from a shift at which all cells lie on it."""
        place = self._xy_m + middle_m - self._first_m
        last_m = self.pixel_m * (np.array(self._raster.shape[::-1]) - 1.0)
        return (np.ceil(-place.min(axis=0) / step_m).astype(int),
                np.floor((last_m - place.max(axis=0)) / step_m).astype(int))

    def add_on_grid(self, square: Array, shift_m: Array, step_m: float) -> None:
        """Add chi^2 to (rows, columns) of shifts, a step apart, from a first one (2,) on."""
        rows, columns = square.shape
        # Steps from the first pixel: those of a whole pixel, or of half of one, are exact.
        place = (self._xy_m + shift_m - self._first_m) / step_m
        cells = np.floor(place).astype(int)
        low, high = cells.min(axis=0), cells.max(axis=0) + [columns + 1, rows + 1]
        lattice = on_axes(self._raster, (0.0, 0.0), self.pixel_m,
                          *(step_m * np.arange(*ends) for ends in zip(low, high)))
        part, cells = place - cells, cells - low
        for top in range(0, rows, _ROWS):
            there = np.empty((min(_ROWS, rows - top), columns, len(place)))
            for cell, ((column, row), (u, v)) in enumerate(zip(cells, part)):
                some = lattice[row + top:row + top + len(there) + 1, column:column + columns + 1]
                some = (1.0 - u) * some[:, :-1] + u * some[:, 1:]
                there[..., cell] = (1.0 - v) * some[:-1] + v * some[1:]
            square[top:top + len(there)] += self._of(there)[0]

    def _of(self, there: Array) -> tuple[Array, Array]:
        """Return chi^2 and the offset for (..., n) values of the raster."""
        residual = (there - self._values) @ self._W.T
        offset = residual @ self._ones * self.offset_variance
        left = residual - offset[..., None] * self._ones
        return _ROBUST**2 * np.log1p((left / _ROBUST)**2).sum(axis=-1), offset
