"""A window of a site as it is drawn, and its light, without what the device holds.

Both are made in any thread.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array, sun_direction
from lunar_rover_sim.ground.world.far_rocks import far_rocks
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.image.illumination.config import EarthConfig, LampConfig, SunConfig
from lunar_rover_sim.image.illumination.discs import earth_as_sun
from lunar_rover_sim.image.illumination.rock_shadow import sun_axes
from lunar_rover_sim.image.illumination.sunlight import Sunlight
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.crater_map import crater_lists, CraterLists
from lunar_rover_sim.image.rendering.ground import GroundHeights
from lunar_rover_sim.image.rendering.relief_brightness import relief_brightness
from lunar_rover_sim.image.rendering.relief_tiles import start_tiles
from lunar_rover_sim.image.rendering.relief_views import relief_views
from lunar_rover_sim.image.rendering.surface import GroundTexels, Surface, surface_texels


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
    views = None
    if sun.shines and not tiles.flat:
        views = relief_views(tiles, config.reflectance, brightness.tangent, radius)
    with ThreadPoolExecutor(2) as pool:
        levels = list(pool.map(lambda k: texels.under(sunlight, k, radius),
                               range(len(world.levels))))
    sunlight.forget_clearance()     # a hundred megabytes
    return WorldLight(sun, sunlight, sun_axes(sunlight.sun), sunlight.rock_light(),
                      Surface(tiles, surface_texels(world, levels, tiles, brightness, views)))


@dataclasses.dataclass(eq=False)
class DrawnWindow:
    """All that is drawn of a world but its light.

    Attributes:
        given: The world, in the frame of the site.
        world: The same in a frame of its own, which single precision holds.
        far_rocks: Beyond its fine ground.
        texels: Of its ground.
        heights: Of its grids.
    """

    given: World
    world: World
    far_rocks: Rocks
    texels: GroundTexels
    heights: GroundHeights
    _craters: CraterLists | None = None

    @classmethod
    def of(cls, given: World, config: RenderConfig) -> DrawnWindow:
        """Prepare a world for drawing."""
        world = given.local()
        return cls(given, world, far_rocks(world, config.detail.far_rocks_m), GroundTexels(world),
                   GroundHeights.of(world))

    @property
    def offset_m(self) -> Array:
        """(3,) place of the origin of `world` in the frame of `given`."""
        x, y = self.given.ground.middle_m
        return np.array([x, y, 0.0])

    def light(self, config: RenderConfig, seed: int) -> WorldLight:
        """Return the light of `config.sun`, and of the Earth; seed: of the relief below the grid.
        """
        light = self._light_under(config, seed)
        if not config.earth.lights_ground:
            return light
        return dataclasses.replace(light, earth=self._light_under(under_earth(config), seed))

    def _light_under(self, config: RenderConfig, seed: int) -> WorldLight:
        return world_light(self.world, config, seed, self.far_rocks, self.texels)

    def crater_lists(self) -> CraterLists:
        """Return where craters are, numbered by their order in the catalogue."""
        if self._craters is None:
            self._craters = crater_lists(self.world.craters,
                                         [grid.half_extent_m for grid in self.world.levels])
        return self._craters


def under_earth(config: RenderConfig) -> RenderConfig:
    """Return the parameters with the Earth in place of the sun, and without a lamp."""
    return dataclasses.replace(config, sun=earth_as_sun(config.sun), earth=EarthConfig(),
                               lamp=LampConfig())
