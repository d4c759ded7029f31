"""All that depends on the sun and needs no GL, made in any thread: the light of a world."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array, sun_direction
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.illumination.rock_shadow import sun_axes
from lunar_rover_sim.image.illumination.sunlight import Sunlight
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.ground_texels import GroundTexels
from lunar_rover_sim.image.rendering.relief_brightness import relief_brightness
from lunar_rover_sim.image.rendering.relief_tiles import start_tiles
from lunar_rover_sim.image.rendering.surface import Surface, surface_texels


@dataclasses.dataclass(frozen=True, eq=False)
class WorldLight:
    """The light of a sun on a world.

    Attributes:
        sun: Whose light it is.
        sunlight: What it sees.
        sun_axes: As `rock_shadow.sun_axes`.
        rock_light: As `Sunlight.rock_light`.
        surface: Texels of the ground and of the relief below the grid.
        earth: The light of the Earth on the same world; None if it is not drawn.
    """

    sun: SunConfig
    sunlight: Sunlight
    sun_axes: Array
    rock_light: NDArray[np.float32]
    surface: Surface
    earth: WorldLight | None = None


def world_light(world: World, config: RenderConfig, seed: int, far_rocks: Rocks,
                texels: GroundTexels) -> WorldLight:
    """Compute the light of `config.sun`; seed: of the relief below the grid."""
    sun = config.sun
    direction = sun_direction(sun.azimuth_deg, sun.elevation_deg)
    started = start_tiles(config.detail, seed, direction)
    sunlight = Sunlight(world, sun, config.reflectance, direction, indirect=config.detail.bounce,
                        far=far_rocks)
    radius = math.radians(0.5 * sun.angular_diameter_deg)
    tiles = started.result()
    brightness = relief_brightness(tiles, config.reflectance, sunlight.sun.elevation_rad, radius)
    with ThreadPoolExecutor(2) as pool:
        levels = list(pool.map(lambda k: texels.under(sunlight, k, radius),
                               range(len(world.levels))))
    sunlight.forget_clearance()     # a hundred megabytes
    return WorldLight(sun, sunlight, sun_axes(sunlight.sun), sunlight.rock_light(),
                      Surface(tiles, surface_texels(world, levels, tiles, brightness)))
