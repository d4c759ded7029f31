"""A window of a site as it is drawn, without what the device holds: made in any thread."""

from __future__ import annotations

import dataclasses

import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.far_rocks import far_rocks
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.image.illumination.config import EarthConfig, LampConfig
from lunar_rover_sim.image.illumination.earthshine import earth_as_sun
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.crater_map import crater_lists, CraterLists
from lunar_rover_sim.image.rendering.ground import GroundHeights
from lunar_rover_sim.image.rendering.ground_texels import GroundTexels
from lunar_rover_sim.image.rendering.world_light import world_light, WorldLight


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
