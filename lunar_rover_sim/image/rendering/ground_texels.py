"""The texels of the ground under a sun, level by level: numbers that need no GL."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.ground.world.albedo import far_albedo, RECIPE
from lunar_rover_sim.ground.world.fine_relief import disc_share
from lunar_rover_sim.ground.world.kept_arrays import kept
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.illumination.sunlight import Sunlight

F32 = NDArray[np.float32]


class LevelTexels(NamedTuple):
    """Texels of a level, (n, n, 4) each, of `ground` and `matter` in `grid_rows`."""

    ground: NDArray[np.float16]
    matter: NDArray[np.uint8]


class GroundTexels:
    """Makes the texels of a world; it keeps what does not depend on the sun."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._albedos = {0: _albedo_texels(world.albedo)}

    def under(self, sunlight: Sunlight, k: int, sun_radius_rad: float) -> LevelTexels:
        """Return the texels of level k."""
        grid = self._world.levels[k]
        matter = _matter_texels(self._albedo(k), *sunlight.scattered[k])
        matter[..., 3] = (sunlight.rock_share[k - 1] if k > 0 else
                          _visibility(*sunlight.clearance[k], sun_radius_rad))
        return LevelTexels(
            _ground_texels(grid.heights_m, grid.cell_m, *sunlight.clearance[k]), matter)

    def _albedo(self, k: int) -> NDArray[np.uint8]:
        """Return the texels of the albedo factor of a level."""
        if k not in self._albedos:
            world, grid = self._world, self._world.levels[k]
            recipe = [RECIPE, world.hash, k, grid.n, grid.cell_m]

            def texels() -> NDArray[np.uint8]:
                return _albedo_texels(far_albedo(world, k))
            self._albedos[k] = (kept('far_albedo', recipe, texels)
                                if world.hash else texels())
        return self._albedos[k]


def _ground_texels(heights_m: F32, cell_m: float, clearance_m: F32,
                   occluder_m: F32) -> NDArray[np.float16]:
    """Return (n, n, 4) texels of `ground` in `grid_rows.light_of_grid`."""
    n = heights_m.shape[0]
    data = np.empty((n, n, 4), np.float16)
    slope = np.empty((n, n), np.float32)
    slope[:, 1:-1] = (heights_m[:, 2:] - heights_m[:, :-2]) * np.float32(0.5 / cell_m)
    slope[:, 0], slope[:, -1] = slope[:, 1], slope[:, -2]
    data[..., 0] = slope
    slope[1:-1] = (heights_m[2:] - heights_m[:-2]) * np.float32(0.5 / cell_m)
    slope[0], slope[-1] = slope[1], slope[-2]
    data[..., 1] = slope
    data[..., 2], data[..., 3] = clearance_m, occluder_m
    return data


def _visibility(clearance_m: F32, occluder_m: F32, radius_rad: float) -> NDArray[np.uint8]:
    """Return (n, n) the share of the sun that is seen, in steps of 1 / 255."""
    share = disc_share(clearance_m / (occluder_m * np.float32(radius_rad)))
    return np.rint(255.0 * share).astype(np.uint8)


def _albedo_texels(albedo: F32) -> NDArray[np.uint8]:
    """Return the first channel of `matter` in `grid_rows.light_of_grid`."""
    return np.clip(np.rint(albedo * np.float32(127.5)), 0, 255).astype(np.uint8)


def _matter_texels(albedo: NDArray[np.uint8], irradiance: F32,
                   surroundings: F32) -> NDArray[np.uint8]:
    """Return (n, n, 4) texels of `matter` in `grid_rows`, without their last channel."""
    n = albedo.shape[0]
    data = np.zeros((n, n, 4), np.uint8)
    data[..., 0] = albedo
    for channel, value in ((1, np.sqrt(4.0 * irradiance)), (2, np.sqrt(4.0 * surroundings))):
        value = cv2.resize(value, (n, n), interpolation=cv2.INTER_LINEAR)
        data[..., channel] = np.clip(np.rint(value * 255.0), 0, 255)
    return data
