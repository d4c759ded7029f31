"""What the sun sees of a world: computed once per (world, sun)."""

from __future__ import annotations

import logging
import time

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.illumination import rock_shadow
from lunar_rover_sim.illumination.config import ReflectanceConfig, SunConfig
from lunar_rover_sim.illumination.hapke import hemispherical_albedo, parameter_set
from lunar_rover_sim.illumination.horizon import shadow_levels, SunGeometry
from lunar_rover_sim.illumination.indirect_light import indirect_light
from lunar_rover_sim.world.model import World

F32 = NDArray[np.float32]
# Cells of a level per cell of indirect light; half as many change the light in shadow by 1 %.
_COARSE = 8
log = logging.getLogger(__name__)


class Sunlight:
    """The light of the sun on all levels and on the rocks.

    clearance: per level (clearance_m, occluder_m), each (n, n) float32; see `horizon`
    scattered: per level indirect irradiance and lit surroundings; see `indirect_light`
    """

    def __init__(self, world: World, sun: SunConfig, reflectance: ReflectanceConfig,
                 direction: Array, indirect: bool = True) -> None:
        start = time.perf_counter()
        self.world = world
        self.sun = SunGeometry.towards(direction)
        levels = shadow_levels(world.levels, self.sun)
        self.clearance = [level.clearance() for level in levels]
        self.ground = levels[0]
        self.silhouettes = rock_shadow.silhouettes(world.rocks, world.rock_shapes, self.sun)
        rock_shadow.stamp(*self.clearance[0], world.ground, self.silhouettes, self.sun)
        self.scattered = [self._scattered(k, sun, reflectance, direction, indirect)
                          for k in range(len(levels))]
        log.info('sun visibility in %.2f s', time.perf_counter() - start)

    def _scattered(self, k: int, sun: SunConfig, reflectance: ReflectanceConfig, direction: Array,
                   indirect: bool) -> tuple[F32, F32]:
        """Return indirect irradiance and surroundings of one level, on a coarser grid."""
        grid = self.world.levels[k]
        n = -(-grid.n // _COARSE)
        if not indirect or direction[2] <= 0.0 or sun.irradiance == 0.0:
            return np.zeros((n, n), np.float32), np.zeros((n, n), np.float32)
        clearance, occluder = self.clearance[k]
        radius = np.radians(0.5 * sun.angular_diameter_deg)
        lit = clearance / occluder
        lit *= np.float32(0.5 / radius)
        lit += np.float32(0.5)
        np.clip(lit, 0.0, 1.0, out=lit)
        size = (n, n)
        albedo = hemispherical_albedo(parameter_set(reflectance.ground)) \
            * reflectance.albedo_scale
        heights = np.asarray(cv2.resize(grid.heights_m, size, interpolation=cv2.INTER_AREA),
                             np.float32)
        share = np.asarray(cv2.resize(lit, size, interpolation=cv2.INTER_AREA), np.float32)
        return indirect_light(heights, grid.cell_m * grid.n / n, share, direction, albedo)

    def light_of(self, points_m: ArrayLike) -> tuple[F32, F32]:
        """Return clearance and occluder distance of (..., 3) points, without rocks [m]."""
        return self.ground.clearance_of(points_m)

    def surroundings_at(self, xy_m: ArrayLike) -> float:
        """Return the exitance of the ground around a place, per normal irradiance of the sun."""
        grid, values = self.world.ground, self.scattered[0][1]
        index = (np.asarray(xy_m) / grid.half_extent_m * 0.5 + 0.5) * (len(values) - 1)
        column, row = np.clip(np.rint(index), 0, len(values) - 1).astype(int)
        return float(values[row, column])

    def rock_light(self) -> F32:
        """Return (m, 4) clearance and occluder distance at foot and top of each rock [m].

        The light is limited by the relief or by another rock, whichever is higher.
        """
        rocks = self.world.rocks
        light = np.zeros((len(rocks), 4), np.float32)
        for column, lift in ((0, -0.2), (2, 0.35)):
            points = rocks.position_m.copy()
            points[:, 2] += lift * rocks.diameter_m
            pair = rock_shadow.darken(*self.ground.clearance_of(points), points,
                                      self.silhouettes)
            light[:, column], light[:, column + 1] = pair
        return light
