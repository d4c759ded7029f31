"""Drawing craters into heights, oldest first."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world import streams
from lunar_rover_sim.ground.world.config import CraterConfig
from lunar_rover_sim.ground.world.craters import Craters, profile_table, RADII, REACH
from lunar_rover_sim.ground.world.grid import on_lattice, part_of
from lunar_rover_sim.ground.world.spline import Area

COARSER = 4             # the lattice on which planes are fitted, in cells of the heights
# A crater erases the relief up to the first radius and leaves it unchanged from the second on.
_ERASED, _UNTOUCHED = 0.85, 1.45
_FITTED = 1.2           # radii, of the square to which a plane is fitted
# Below this diameter [cells] the ground under a crater is smooth anyway.
FLATTENED_CELLS = 10.0   # diameter
_PLANE_STEP_M = 2.0**-20  # lattice of the plane's height, and of its rise over a radius
# Two to four lobes with random phases shape the outline; their power falls with the order.
_LOBES = (0.75, 0.5, 0.43)


def plane_margin_m(largest_m: Any) -> Any:
    """Return how far beyond an area craters and ground decide its planes.

    The plane of a crater is fitted where those of the next larger band lie, and so on: 0.85
    diameters from the middle to a corner, `REACH` radii of the larger one, each band twice the
    other.
    """
    return 2.0 * (0.85 + 0.5 * REACH) * largest_m


def stamp(ground: Area, craters: Craters, config: CraterConfig, coarse: Area) -> None:
    """Draw craters into heights [m], in place, in order of time.

    Within its rim a crater erases the previous relief: the ground is drawn towards its best-fit
    plane, which keeps the large-scale slope, and the profile for its age is added. The older the
    crater, the less of the relief it erases, since new relief has formed. The plane is that of the
    ground with all craters of twice the size or more.

    Args:
        ground: To draw into, float32.
        craters: In the frame of the site.
        config: Of their profiles.
        coarse: The ground before craters on a lattice `COARSER` times as wide, with a margin, see
            `plane_margin_m`; it is changed.
    """
    low = np.array(ground.first) * ground.cell_m
    high = low + (np.array(ground.values.shape[::-1]) - 1) * ground.cell_m
    beyond = np.maximum(low - craters.position_m, craters.position_m - high).max(axis=1,
                                                                                 initial=-np.inf)
    # Those that decide planes within it.
    craters = craters.select(beyond <= plane_margin_m(2.0 * craters.diameter_m))
    craters = craters.select(np.lexsort((craters.key, -craters.time)))
    planes = np.full((len(craters), 3), np.nan)
    large = craters.diameter_m > FLATTENED_CELLS * ground.cell_m
    _, band = np.frexp(craters.diameter_m)      # the power of two above it
    bands = np.unique(band[large])[::-1]
    for number in bands:
        here = np.flatnonzero((band == number) & large)
        for i in here.tolist():
            planes[i] = _plane(coarse, craters, i)
        if number > bands[-1]:
            _stamp(coarse, craters, here, config, planes)
    _stamp(ground, craters, np.arange(len(craters)), config, planes)


def _plane(coarse: Area, craters: Craters, i: int) -> Array:
    """Return the least-squares plane of the ground around a crater: its middle, and rises."""
    radius = 0.5 * craters.diameter_m[i] / coarse.cell_m
    x0, y0 = craters.position_m[i] / coarse.cell_m
    part = part_of(x0, y0, _FITTED * radius, coarse.first, coarse.values.shape)
    if part is None or min(s.stop - s.start for s in part) < 2:
        return np.full(3, np.nan)
    rows, columns = part
    # A copy, so that no layout of memory decides in which order it is summed.
    core = np.array(coarse.values[rows, columns], np.float64)
    x = (np.arange(columns.start, columns.stop) + coarse.first[0] - x0) / radius
    y = (np.arange(rows.start, rows.stop) + coarse.first[1] - y0) / radius
    mx, my = 0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1])
    from_mx, from_my = x - mx, y - my
    by_column, by_row = core.sum(axis=0), core.sum(axis=1)
    sx = (by_column * from_mx).sum() / ((from_mx * from_mx).sum() * len(y))
    sy = (by_row * from_my).sum() / ((from_my * from_my).sum() * len(x))
    return on_lattice([by_column.sum() / core.size - sx * mx - sy * my, sx, sy], _PLANE_STEP_M)


def _stamp(ground: Area, craters: Craters, chosen: NDArray[np.int64], config: CraterConfig,
           planes: Array) -> None:
    """Draw the chosen craters, one after the other."""
    drawn = streams.normals(craters.key[chosen], 'outline', 2 * len(_LOBES))
    lobes = drawn * np.tile(config.irregularity * np.array(_LOBES), 2)
    table = profile_table(config)
    _draw(ground.values, *ground.first, ground.cell_m, craters.position_m[chosen],
          craters.diameter_m[chosen], craters.age[chosen], lobes.astype(np.float32),
          planes[chosen], table.ages, table.heights)


_F = np.float32
_ONE, _TWO, _THREE = _F(1.0), _F(2.0), _F(3.0)
_BEGINS, _FADES = _F(_UNTOUCHED), _F(_UNTOUCHED - _ERASED)
_FLAT_REACH = _F(1.8)       # radii, in x and in y
_LEAST_RHO, _MOST_LOBED = _F(1e-3), _F(0.3)
_PER_RADIUS, _LAST = _F(1.0 / RADII[1]), _F(len(RADII) - 2)


@compiled
def _draw(heights: np.ndarray, first_x: int, first_y: int, cell_m: float, position_m: np.ndarray,
          diameter_m: np.ndarray, age: np.ndarray, lobes: np.ndarray, planes: np.ndarray,
          ages: np.ndarray, profiles: np.ndarray) -> None:
    """Draw craters into (rows, columns) float32 heights; in single precision.

    Args:
        first_x, first_y: Column and row of heights[0, 0] on the lattice of the site.
        lobes: (m, 6) float32, cosines and then sines of two to four lobes.
        planes: (m, 3), NaN for craters that do not flatten.
        ages, profiles: Of the profile table.
    """
    rows, columns = heights.shape
    profile = np.empty(profiles.shape[1], np.float32)
    for i in range(len(diameter_m)):
        radius = 0.5 * diameter_m[i] / cell_m       # in cells
        x0, y0, reach = position_m[i, 0] / cell_m, position_m[i, 1] / cell_m, REACH * radius
        left, right = max(math.ceil(x0 - reach), first_x), min(math.floor(x0 + reach) + 1,
                                                               first_x + columns)
        low, high = max(math.ceil(y0 - reach), first_y), min(math.floor(y0 + reach) + 1,
                                                             first_y + rows)
        if left >= right or low >= high:
            continue
        k = min(max(np.searchsorted(ages, age[i]) - 1, 0), len(ages) - 2)
        part = (age[i] - ages[k]) / (ages[k + 1] - ages[k])
        for r in range(len(profile)):
            profile[r] = ((1.0 - part) * profiles[k, r] + part * profiles[k + 1, r]
                          ) * diameter_m[i]
        flattens = np.isfinite(planes[i, 0])
        middle, sx, sy = _F(planes[i, 0]), _F(planes[i, 1]), _F(planes[i, 2])
        amount, scale = _F(1.0 - 0.7 * age[i]), _F(radius)
        c2_part, c3_part, c4_part = lobes[i, 0], lobes[i, 1], lobes[i, 2]
        s2_part, s3_part, s4_part = lobes[i, 3], lobes[i, 4], lobes[i, 5]
        for row in range(low, high):
            # Places count from the crater, so that all windows round alike.
            dy = _F(row - y0) / scale
            line = heights[row - first_y]
            near_y = flattens and abs(dy) < _FLAT_REACH
            for column in range(left, right):
                dx = _F(column - x0) / scale
                rho = np.sqrt(dx * dx + dy * dy)
                inverse = _ONE / max(rho, _LEAST_RHO)
                c, s = dx * inverse, dy * inverse
                c2, s2 = c * c - s * s, _TWO * c * s
                lobed = c2_part * c2 + s2_part * s2
                lobed += c3_part * (c2 * c - s2 * s) + s3_part * (s2 * c + c2 * s)
                lobed += c4_part * (c2 * c2 - s2 * s2) + s4_part * (_TWO * c2 * s2)
                rho *= max(min(lobed, _MOST_LOBED), -_MOST_LOBED) + _ONE
                z = line[column - first_x]
                if near_y and abs(dx) < _FLAT_REACH and rho < _BEGINS:
                    t = min((_BEGINS - rho) / _FADES, _ONE)
                    flat = (middle + sx * dx) + sy * dy
                    z += amount * t * t * (_THREE - _TWO * t) * (flat - z)
                at = min(rho * _PER_RADIUS, _LAST)
                below = np.int32(at)
                z += profile[below] + (at - _F(below)) * (profile[below + 1] - profile[below])
                line[column - first_x] = z
