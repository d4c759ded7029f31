"""Sunlight on a world, with what lit ground scatters into shadows: computed once per (world, sun).

Indirect light is one bounce. From every point of a coarsened height grid the relief is scanned
along a few azimuths. A piece of ground that rises above all nearer ones, from angle a1 to a2 over
the point's own plane, is seen under the projected solid angle (sin^2 a2 - sin^2 a1) / 2 per radian
of azimuth. It sends its radiance, taken as diffuse, if the sun sees it. Light that is scattered
twice (a tenth as much, with a ground albedo of 0.1) and the direction dependence of the scattering
ground are left out.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import itertools
import logging
import os
import time

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.image.illumination import rock_shadow
from lunar_rover_sim.image.illumination.config import ReflectanceConfig, SunConfig
from lunar_rover_sim.image.illumination.hapke import hemispherical_albedo, parameter_set
from lunar_rover_sim.image.illumination.horizon import shadow_levels, SunGeometry

F32 = NDArray[np.float32]
# Cells of a level per cell of indirect light; half as many change the light in shadow by 1 %.
COARSE = 8
log = logging.getLogger(__name__)


class Sunlight:
    """The light of the sun on all levels and on the rocks.

    Attributes:
        rocks: Those of the world, and the far ones behind them.
        rock_share: Per level but the first, (n, n) uint8 share in the shadow of rocks; 255 is all.
        clearance: Per level (clearance_m, occluder_m), each (n, n) float32; see `horizon`. Empty
            after `forget_clearance`.
        scattered: Per level indirect irradiance and lit surroundings; as `indirect_light`.
    """

    def __init__(self, world: World, sun: SunConfig, reflectance: ReflectanceConfig,
                 direction: Array, indirect: bool = True, far: Rocks | None = None) -> None:
        """Compute all of it; far: rocks beyond the fine ground."""
        start = time.perf_counter()
        self.world = world
        self.sun = SunGeometry.towards(direction)
        levels = shadow_levels(world.levels, self.sun, world.origin_m)
        self.clearance = [level.clearance() for level in levels]
        self._levels = levels
        self.rocks = world.rocks.joined(far) if far is not None else world.rocks
        self.silhouettes = rock_shadow.silhouettes(self.rocks, world.rock_shapes, self.sun)
        rock_shadow.stamp(*self.clearance[0], world.ground, self.silhouettes, self.sun)
        self.rock_share = [rock_shadow.share(grid, self.silhouettes, self.sun,
                                             finer.half_extent_m)
                           for finer, grid in itertools.pairwise(world.levels)]
        self.scattered = [self._scattered(k, sun, reflectance, direction, indirect)
                          for k in range(len(levels))]
        log.info('sun visibility in %.2f s', time.perf_counter() - start)

    def _scattered(self, k: int, sun: SunConfig, reflectance: ReflectanceConfig, direction: Array,
                   indirect: bool) -> tuple[F32, F32]:
        """Return indirect irradiance and surroundings of one level, on a coarser grid."""
        grid = self.world.levels[k]
        n = -(-grid.n // COARSE)
        if not indirect or direction[2] <= 0.0 or sun.irradiance == 0.0:
            return np.zeros((n, n), np.float32), np.zeros((n, n), np.float32)
        clearance, occluder = self.clearance[k]
        side = COARSE * n

        def coarse(values: F32) -> F32:
            """Return means over cells that lie on the lattice of the site; its border goes on."""
            more = side - len(values)
            whole = cv2.copyMakeBorder(values, 0, more, 0, more, cv2.BORDER_REPLICATE)
            return np.asarray(cv2.resize(whole, (n, n), interpolation=cv2.INTER_AREA), np.float32)

        radius = np.radians(0.5 * sun.angular_diameter_deg)
        lit = clearance / occluder
        lit *= np.float32(0.5 / radius)
        lit += np.float32(0.5)
        np.clip(lit, 0.0, 1.0, out=lit)
        albedo = hemispherical_albedo(parameter_set(reflectance.ground)) \
            * reflectance.albedo_scale
        return indirect_light(coarse(grid.heights_m), COARSE * grid.cell_m, coarse(lit), direction,
                              albedo)

    def forget_clearance(self) -> None:
        """Drop what only the texels of the ground need."""
        self.clearance.clear()

    def light_of(self, points_m: ArrayLike) -> tuple[F32, F32]:
        """Return clearance and occluder distance of (m, 3) points, without rocks [m]."""
        points = np.asarray(points_m, float)
        clearance, occluder = self._levels[-1].clearance_of(points)
        for level in self._levels[-2::-1]:
            inside = np.flatnonzero(level.grid.contains(points[:, :2]))
            if len(inside):
                clearance[inside], occluder[inside] = level.clearance_of(points[inside])
        return clearance, occluder

    def angle_above_horizon(self, points_m: ArrayLike) -> Array:
        """Return how far the middle of the sun stands above the horizon of (m, 3) points [rad].

        Rocks are left out.
        """
        clearance, occluder = self.light_of(points_m)
        return np.arctan2(clearance, occluder).astype(float)

    def surroundings_at(self, xy_m: ArrayLike) -> F32:
        """Return the exitance of the ground around (..., 2) places, per normal irradiance."""
        xy = np.asarray(xy_m, float)
        result = np.zeros(xy.shape[:-1], np.float32)
        for grid, (_, values) in zip(self.world.levels[::-1], self.scattered[::-1]):
            # The middle of the first cell lies so many samples from the first one.
            index = ((xy + grid.half_extent_m) / grid.cell_m - 0.5 * (COARSE - 1)) / COARSE
            column, row = np.moveaxis(np.clip(np.rint(index), 0, len(values) - 1), -1, 0)
            result = np.where(grid.contains(xy), values[row.astype(int), column.astype(int)],
                              result)
        return result

    def rock_light(self) -> F32:
        """Return (m, 5) light on each rock, the far ones included.

        Clearance and occluder distance at its foot and at its top [m], limited by the relief or
        by another rock, whichever is higher; exitance of the ground around.
        """
        rocks = self.rocks
        light = np.zeros((len(rocks), 5), np.float32)
        for column, lift in ((0, -0.2), (2, 0.35)):
            points = rocks.position_m.copy()
            points[:, 2] += lift * rocks.diameter_m
            pair = rock_shadow.darken(*self.light_of(points), points, self.silhouettes)
            light[:, column], light[:, column + 1] = pair
        light[:, 4] = self.surroundings_at(rocks.position_m[:, :2])
        return light


_AZIMUTHS = 12
_STEPS = 20             # distances double every third step


def indirect_light(heights_m: F32, cell_m: float, lit: F32, direction: NDArray[np.float64],
                   albedo: float) -> tuple[F32, F32]:
    """Return (irradiance, surroundings), both (n, n) and per normal irradiance of the sun.

    The irradiance is what other ground sends to each point of the grid, the surroundings are the
    exitance of the ground around it, of which upright faces see one half.

    Args:
        heights_m: (n, n) heights of the grid [m].
        cell_m: Distance of its samples [m].
        lit: (n, n) share of the sun's disc that is seen.
        direction: (3,) unit vector to the sun.
        albedo: Diffuse albedo of the ground.
    """
    gradient = np.asarray(np.gradient(heights_m, np.float32(cell_m)), np.float32)
    gy, gx = gradient[0], gradient[1]
    facing = (direction[2] - gx * direction[0] - gy * direction[1]) / np.sqrt(1 + gx**2 + gy**2)
    exitance = (albedo * lit * np.maximum(facing, 0.0)).astype(np.float32)
    angles = 2.0 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    total = np.zeros_like(exitance)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # In a fixed order, so that the rounding of the sum is always the same.
        for part in pool.map(lambda angle: _along(heights_m, gx, gy, exitance, cell_m,
                                                  np.cos(angle), np.sin(angle)), angles):
            total += part
    irradiance = total * np.float32(2.0 / _AZIMUTHS)
    # A mean over about a metre with the weights of an upright face, which sees mostly near ground.
    surroundings = 0.5 * cv2.GaussianBlur(exitance, (0, 0), max(0.4 / cell_m, 0.6)) \
        + 0.5 * cv2.GaussianBlur(exitance, (0, 0), max(1.6 / cell_m, 1.2))
    return irradiance, surroundings


def _along(z: F32, gx: F32, gy: F32, exitance: F32, cell_m: float, c: float, s: float) -> F32:
    """Return sum of exitance (sin^2 a2 - sin^2 a1) / 2 along one azimuth."""
    n = z.shape[0]
    slope = (gx * c + gy * s).astype(np.float32)
    highest = np.zeros_like(z)          # sine squared of the highest angle, over the own plane
    total = np.zeros_like(z)
    previous = exitance.copy()
    last = (0, 0)
    for k in range(_STEPS):
        distance = 1.4 * 2.0**(k / 3.0)
        di, dj = int(round(distance * s)), int(round(distance * c))
        if (di, dj) == last or max(abs(di), abs(dj)) >= n // 2:
            continue
        last = (di, dj)
        to = (slice(max(0, -di), n - max(0, di)), slice(max(0, -dj), n - max(0, dj)))
        of = (slice(max(0, di), n - max(0, -di)), slice(max(0, dj), n - max(0, -dj)))
        reach = np.float32(np.hypot(di, dj) * cell_m)
        rise = np.maximum((z[of] - z[to]) / reach - slope[to], np.float32(0.0))
        rise *= rise
        sine2 = rise / (np.float32(1.0) + rise)
        gain = np.maximum(sine2 - highest[to], np.float32(0.0))
        highest[to] += gain
        # The ground between two samples is taken to be as bright as their mean.
        gain *= exitance[of] + previous[to]
        total[to] += gain
        previous[to] = exitance[of]
    return np.float32(0.25) * total
