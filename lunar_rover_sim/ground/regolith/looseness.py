"""Loose soil of a world: rims and ejecta of fresh craters, and slopes.

That the soil is looser there is a choice, and so is by how much: the most is what the preset
`highland_loose` is beside `highland`. Ejecta thin out as (r / R)^-3 beyond the
rim (McGetchin et al. 1973), and a crater counts as fresh up to half of its lifetime.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.regolith.law import Heights
from lunar_rover_sim.ground.regolith.soil import PRESETS
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.grid import HeightGrid, part_of
from lunar_rover_sim.ground.world.model import World

CELL_M = 0.1
FRESH = 0.5                   # age of a crater, in lifetimes, from which on it no longer counts
LEAST_DIAMETER_M = 0.5
REACH = 4.0                   # radii: 1.6 % of the rim's looseness is left there
AT_CENTRE = 0.3               # looseness at the centre of a crater over that of its rim
SLOPES = math.tan(math.radians(10.0)), math.tan(math.radians(30.0))   # not loose, and loosest
SLOPE_OVER_M = 0.5
_LOOSE, _FIRM = PRESETS['highland_loose'], PRESETS['highland']
# What full looseness leaves of bearing and friction.
BEARING_RATIO = _LOOSE.zeta_npm3 / _FIRM.zeta_npm3
FRICTION_RATIO = _LOOSE.friction / _FIRM.friction


@dataclasses.dataclass(frozen=True)
class SoilMap:
    """How much looser than its preset the soil is, place by place; beyond the map it is not.

    `law.looseness_factors` turns it into factors on bearing and friction.

    Attributes:
        looseness: From 0, the soil of the preset, to 1.
        variation: 0 for a uniform soil, 1 for its full looseness.
    """

    looseness: HeightGrid
    variation: float

    @functools.cached_property
    def varied(self) -> Heights:
        """Looseness times its variation, as `law.looseness_factors` takes it."""
        grid = self.looseness
        return Heights.of(dataclasses.replace(
            grid, heights_m=(grid.heights_m * self.variation).astype(np.float32)))


def soil_map(world: World, variation: float) -> SoilMap:
    """Return the map of a world; variation: 0 for a uniform soil, 1 for its full looseness."""
    ground = world.ground
    n = 2 * math.ceil(ground.half_extent_m / CELL_M) + 1
    grid = HeightGrid(np.zeros((n, n), np.float32), CELL_M, ground.middle_m)
    firm = 1.0 - _crater_looseness(world.craters, grid)
    firm *= 1.0 - _slope_looseness(ground, grid)
    return SoilMap(dataclasses.replace(grid, heights_m=(1.0 - firm).astype(np.float32)), variation)


def _crater_looseness(craters: Craters, grid: HeightGrid) -> Array:
    """Return the (n, n) looseness by craters: the greatest where several overlap."""
    first_x, first_y = map(round, grid.first)
    field = np.zeros((grid.n, grid.n))
    for i in np.flatnonzero((craters.age < FRESH) & (craters.diameter_m >= LEAST_DIAMETER_M)):
        radius = 0.5 * craters.diameter_m[i] / CELL_M
        x, y = craters.position_m[i] / CELL_M
        window = part_of(x, y, REACH * radius, (first_x, first_y), field.shape)
        if window is None:
            continue
        # Places on the lattice of the site, so that all windows have the same bits.
        rows, columns = (np.arange(part.start, part.stop) for part in window)
        rho = np.hypot((columns + first_x - x) / radius, ((rows + first_y - y) / radius)[:, None])
        inside = AT_CENTRE + (1.0 - AT_CENTRE) * rho ** 2
        loose = np.where(rho < 1.0, inside, np.where(rho < REACH, np.maximum(rho, 1.0) ** -3, 0.0))
        field[window] = np.maximum(field[window], (1.0 - craters.age[i] / FRESH) * loose)
    return field


def _slope_looseness(ground: HeightGrid, grid: HeightGrid) -> Array:
    """Return the (n, n) looseness by slopes over half a metre, cut short at the border."""
    x, y = np.meshgrid(*((np.arange(grid.n) + first) * CELL_M for first in grid.first))
    reach = 0.5 * SLOPE_OVER_M

    low, high = (np.array(ground.middle_m) + side * ground.half_extent_m for side in (-1.0, 1.0))

    def height(dx: float, dy: float) -> Array:
        return ground.height_at(np.clip(np.stack([x + dx, y + dy], axis=-1), low, high))

    slope = np.hypot(height(reach, 0.0) - height(-reach, 0.0),
                     height(0.0, reach) - height(0.0, -reach)) / SLOPE_OVER_M
    part: Array = np.clip((slope - SLOPES[0]) / (SLOPES[1] - SLOPES[0]), 0.0, 1.0)
    return part
