"""Passes that all cameras of a renderer share: ground, its light, rocks, rover, tracks, lamp."""

from __future__ import annotations

import dataclasses
import math

import moderngl
import numpy as np

from lunar_rover_sim.base.frames import Array, sun_direction
from lunar_rover_sim.base.workers import Workers
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.world.far_rocks import far_rocks
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.illumination.config import EarthConfig, LampConfig, SunConfig
from lunar_rover_sim.image.illumination.earthshine import earth_as_sun
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.crater_map import crater_lists, CraterLists
from lunar_rover_sim.image.rendering.gl_owner import GlOwner
from lunar_rover_sim.image.rendering.ground import Ground
from lunar_rover_sim.image.rendering.ground_band import GroundSource
from lunar_rover_sim.image.rendering.ground_picture import GroundPicture
from lunar_rover_sim.image.rendering.ground_texels import GroundTexels
from lunar_rover_sim.image.rendering.lamp_rows import LampLight
from lunar_rover_sim.image.rendering.lamp_shadow import LampShadow
from lunar_rover_sim.image.rendering.lighting import LightConstants
from lunar_rover_sim.image.rendering.object_light import ObjectSource
from lunar_rover_sim.image.rendering.rock_pass import rock_table, RockPass
from lunar_rover_sim.image.rendering.rover_pass import RoverPass
from lunar_rover_sim.image.rendering.rover_shadow import RoverShadow
from lunar_rover_sim.image.rendering.scene import SceneLight
from lunar_rover_sim.image.rendering.surface import Surface
from lunar_rover_sim.image.rendering.track_map import TrackMap
from lunar_rover_sim.image.rendering.track_texels import TrackSun
from lunar_rover_sim.image.rendering.world_light import world_light, WorldLight
from lunar_rover_sim.rover.description import RoverDescription


class WorldPasses(GlOwner):
    """The passes that draw the world, for whichever camera is bound.

    What they have chosen for a camera holds until its frame is lit.

    Attributes:
        world, rover, config, seed: As given.
        sunlight, sun_axes: What the sun sees.
        ground: Of the world.
        rocks, body, rover_shadow: Passes.
        lamp: None without a lamp.
        tracks: None before `follow`.
        rock_table: What the light of rocks follows from.
        workers: Threads for rows of images.
        waiting: Frames whose ground is not made yet.
        earth: Passes of the light of the Earth, as if that were the sun; None if it is not drawn.
    """

    def __init__(self, context: moderngl.Context, world: World, rover: RoverDescription,
                 config: RenderConfig, seed: int, ground: Ground | None = None) -> None:
        """Make all passes.

        Args:
            seed: Of the relief below the grid.
            ground: That of another source of light.
        """
        super().__init__()
        self._context = context
        self.world, self.rover, self.config, self.seed = world, rover, config, seed
        with self._making():
            self._build(ground)

    def _build(self, ground: Ground | None) -> None:
        context, config, world = self._context, self.config, self.world
        self._surface = Surface(world)
        self._far_rocks = far_rocks(world, config.detail.far_rocks_m)
        self._texels = GroundTexels(world)
        light = self._light_under(config)
        self._light_surface(light)
        sunlight = light.sunlight
        self.ground = ground or Ground(world, config.detail, self._surface)
        rocks = sunlight.rocks
        self.rocks = self._own(RockPass(context, rocks, world.rock_shapes))
        self.rock_table = rock_table(rocks, light.rock_light,
                                     world.height_at(rocks.position_m[:, :2]))
        self.body = self._own(RoverPass(context, self.rover))
        self.rover_shadow = RoverShadow(self.rover)
        self.lamp = (self._own(LampShadow(context, config.lamp, config.camera))
                     if config.lamp.power_w > 0.0 else None)
        self.tracks: TrackMap | None = None
        self._craters: CraterLists | None = None
        self.workers = self._own(Workers())
        self.waiting: list[GroundPicture] = []
        self._set_constants()
        self.earth = (self._own(WorldPasses(context, world, self.rover, _under_earth(config),
                                            self.seed, self.ground))
                      if config.earth.lights_ground else None)

    @property
    def sources(self) -> tuple[WorldPasses, ...]:
        """The passes of each source of light: of the sun, and of the Earth if it is up."""
        if self.earth is None or not self.earth.config.sun.shines:
            return (self,)
        return self, self.earth

    def follow(self, overlay: Overlay) -> None:
        """Draw the tracks of an overlay from now on."""
        self.tracks = TrackMap(self.world.ground, overlay, self._track_sun())
        if self.earth is not None:
            self.earth.follow(overlay)
        self.ground.follow(self.tracks)     # which is also that of the Earth

    def _track_sun(self) -> TrackSun:
        sun = self.config.sun
        return TrackSun.of(sun_direction(sun.azimuth_deg, sun.elevation_deg),
                           math.radians(0.5 * sun.angular_diameter_deg))

    def crater_lists(self) -> CraterLists:
        """Return where craters are; they are listed for the first frame that asks for it."""
        if self._craters is None:
            self._craters = crater_lists(self.world.craters,
                                         [grid.half_extent_m for grid in self.world.levels])
        return self._craters

    def source(self, light: SceneLight, lamp: LampLight | None,
               T_world_links: Array) -> ObjectSource:
        """Return what a frame is lit with by this source of light."""
        ground = GroundSource(self._constants, self._surface.texels,
                              None if self.tracks is None else self.tracks.arrays, light.shadow,
                              lamp)
        return ObjectSource(ground, self.rock_table, light.body, self.body.parts,
                            T_world_links.astype(np.float32))

    def make_waiting(self) -> None:
        """Make the ground of frames that wait for it, before the ground changes."""
        waiting, self.waiting = self.waiting, []
        for picture in waiting:
            picture.make()

    def light_of(self, sun: SunConfig) -> WorldLight:
        """Compute the light of another sun; in any thread, while others draw."""
        config = dataclasses.replace(self.config, sun=sun)
        light = self._light_under(config)
        if not config.earth.lights_ground:
            return light
        return dataclasses.replace(light, earth=self._light_under(_under_earth(config)))

    def _light_under(self, config: RenderConfig) -> WorldLight:
        return world_light(self.world, config, self.seed, self._far_rocks, self._texels)

    def relight(self, light: WorldLight) -> None:
        """Move the sun; light: as `light_of` returned it, to be used once."""
        self.config = dataclasses.replace(self.config, sun=light.sun)
        self._light_surface(light)
        self.rock_table = np.column_stack([self.rock_table[:, :15], light.rock_light])
        if self.tracks is not None:
            self.tracks.relight(self._track_sun())
        self._set_constants()
        if self.earth is not None and light.earth is not None:
            self.earth.relight(light.earth)

    def _light_surface(self, light: WorldLight) -> None:
        self.sunlight, self.sun_axes = light.sunlight, light.sun_axes
        self._surface.light(light.texels, light.tiles, light.brightness)
        light.texels.clear()    # tens of megabytes

    def _set_constants(self) -> None:
        self._constants = LightConstants.of(self.config, self.world.config.seed)


def _under_earth(config: RenderConfig) -> RenderConfig:
    """Return the parameters with the Earth in place of the sun, and without a lamp."""
    return dataclasses.replace(config, sun=earth_as_sun(config.sun, config.earth),
                               earth=EarthConfig(), lamp=LampConfig())
