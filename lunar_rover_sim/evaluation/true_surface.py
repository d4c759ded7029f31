"""The true surface of a world, rocks included, by rays from above."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.frames import Array
from lunar_rover_sim.lidar.ray_arrays import HeightPyramid, RockHulls
from lunar_rover_sim.lidar.ray_caster import RayCaster
from lunar_rover_sim.navigation.elevation_map import Elevation
from lunar_rover_sim.world.model import World

_ABOVE_M = 1.0      # rays begin this far over the highest ground and rock
_DOWN = np.array([0.0, 0.0, -1.0])


class TrueSurface:
    """Heights and rocks of a world, seen from above."""

    def __init__(self, world: World) -> None:
        hulls = RockHulls(world.rocks, world.rock_shapes)
        self._caster = RayCaster([HeightPyramid(world.ground, hulls)], hulls)
        self._ground = world.ground
        rocks = world.rocks
        top = float(world.ground.heights_m.max())
        if len(rocks):
            top = max(top, float((rocks.position_m[:, 2] + rocks.diameter_m).max()))
        self._top_m = top + _ABOVE_M

    def heights(self, xy_m: ArrayLike) -> tuple[Array, Array]:
        """Return heights (...) [m] at (..., 2) places, and how far rocks rise over the ground.

        Heights are NaN outside the fine ground; rocks rise by 0 where there is none.
        """
        xy = np.asarray(xy_m, float)
        flat = xy.reshape(-1, 2)
        inside = np.flatnonzero(self._ground.contains(flat))
        height, rise = np.full(len(flat), np.nan), np.zeros(len(flat))
        if len(inside):
            origin = np.column_stack([flat[inside], np.full(len(inside), self._top_m)])
            hits = self._caster.cast(origin, np.tile(_DOWN, (len(inside), 1)), 1e4,
                                     from_one_place=False)
            height[inside] = self._top_m - hits.distance_m
            rock = hits.target >= 0
            rise[inside[rock]] = (height[inside[rock]]
                                  - self._ground.height_at(flat[inside[rock]]))
        return height.reshape(xy.shape[:-1]), np.maximum(rise, 0.0).reshape(xy.shape[:-1])

    def elevation(self, centre_m: ArrayLike, size_m: float, cell_m: float,
                  samples: int = 2) -> Elevation:
        """Return the true map of a square: means of so many samples along each side of a cell."""
        n = round(size_m / cell_m)
        origin = np.round(np.asarray(centre_m, float)[:2] / cell_m - 0.5 * n) * cell_m
        step = (np.arange(n * samples) + 0.5) * cell_m / samples
        x, y = np.meshgrid(origin[0] + step, origin[1] + step)
        height, _ = self.heights(np.stack([x, y], axis=-1))
        mean = height.reshape(n, samples, n, samples).mean(axis=(1, 3)).astype(np.float32)
        known = np.isfinite(mean)
        return Elevation(0, origin, cell_m, mean,
                         np.where(known, np.float32(1e-8), np.float32(np.nan)))
