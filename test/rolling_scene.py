"""Rolling ground with rocks, and the rover on it, for tests of the renderer."""

import camera_scene as scene
import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.model import World


def rolling_world() -> World:
    """Return rolling ground with a few rocks."""
    heights = scene.hills()
    rng = np.random.default_rng(5)
    xy = rng.uniform(-5.0, 5.0, (40, 2))
    xy = xy[np.abs(xy).max(axis=1) > 0.8]
    flat = scene.plane(heights=heights)
    z = flat.ground.height_at(xy) + 0.05
    return scene.plane(heights=heights, stones=scene.rocks(np.column_stack([xy, z]), 0.2),
                       shape=scene.block('block', (0.5, 0.45, 0.4)))


def pose_on(world: World, x: float, y: float, yaw_deg: float = 0.0) -> Array:
    """Return T_world_base (4, 4) of a rover that stands on the ground."""
    z = float(world.height_at((x, y))) + 0.1
    return scene.pose(x, y, z, yaw_deg)
