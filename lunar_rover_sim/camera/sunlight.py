"""What the sun sees of a world: computed once per (world, sun)."""

from __future__ import annotations

import logging
import time

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.config import RenderConfig
from lunar_rover_sim.camera.horizon import shadow_levels, SunGeometry
from lunar_rover_sim.camera import rock_shadow
from lunar_rover_sim.frames import Array
from lunar_rover_sim.world.model import World

F32 = NDArray[np.float32]
log = logging.getLogger(__name__)


class Sunlight:
    """Shadow boundaries of all levels and of the rocks.

    clearance: per level (clearance_m, occluder_m), each (n, n) float32; see `horizon`
    """

    def __init__(self, world: World, config: RenderConfig, direction: Array) -> None:
        start = time.perf_counter()
        self.world = world
        self.sun = SunGeometry(float(np.arctan2(direction[1], direction[0])),
                               float(np.arcsin(np.clip(direction[2], -1.0, 1.0))))
        levels = shadow_levels(world.levels, self.sun)
        self.clearance = [level.clearance() for level in levels]
        self.ground = levels[0]
        self.silhouettes = rock_shadow.silhouettes(world.rocks, world.rock_shapes, self.sun)
        rock_shadow.stamp(*self.clearance[0], world.ground, self.silhouettes, self.sun)
        log.info('sun visibility in %.2f s', time.perf_counter() - start)

    def rock_light(self) -> F32:
        """Return (m, 4) clearance and occluder distance [m] at foot and top of each rock."""
        rocks = self.world.rocks
        light = np.zeros((len(rocks), 4), np.float32)
        for column, lift in ((0, -0.35), (2, 0.35)):
            points = rocks.position_m.copy()
            points[:, 2] += lift * rocks.diameter_m
            clearance, occluder = self.ground.clearance_of(points)
            light[:, column], light[:, column + 1] = clearance, occluder
        return light
