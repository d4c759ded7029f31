"""Passes that all cameras of a renderer share: ground, its light, rocks, rover, tracks, lamp."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import moderngl
import numpy as np

from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.base.workers import Workers
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.world.far_rocks import far_rocks
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.illumination.config import EarthConfig, LampConfig, SunConfig
from lunar_rover_sim.image.illumination.earthshine import earth_as_sun
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.context import set_uniform
from lunar_rover_sim.image.rendering.crater_map import crater_lists, CraterLists
from lunar_rover_sim.image.rendering.gl_owner import GlOwner
from lunar_rover_sim.image.rendering.ground import Ground
from lunar_rover_sim.image.rendering.ground_band import GroundSource
from lunar_rover_sim.image.rendering.ground_picture import GroundPicture
from lunar_rover_sim.image.rendering.ground_texels import GroundTexels
from lunar_rover_sim.image.rendering.lamp_rows import LampLight
from lunar_rover_sim.image.rendering.lamp_shadow import LampShadow
from lunar_rover_sim.image.rendering.lighting import GroundConstants, lighting_constants
from lunar_rover_sim.image.rendering.rock_pass import RockPass
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
        programs: Of all passes that compute light or truth.
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
        self._surface = self._own(Surface(context, world))
        self._far_rocks = far_rocks(world, config.detail.far_rocks_m)
        self._texels = GroundTexels(world)
        light = self._light_under(config)
        self._light_surface(light)
        sunlight = light.sunlight
        lamp = config.lamp.power_w > 0.0
        self.ground = ground or Ground(world, config.detail, self._surface)
        self.rocks = self._own(RockPass(context, sunlight.rocks, world.rock_shapes,
                                        light.rock_light,
                                        world.height_at(sunlight.rocks.position_m[:, :2]),
                                        self._surface, lamp))
        self.body = self._own(RoverPass(context, self.rover, lamp))
        self.rover_shadow = self._own(RoverShadow(context, self.rover))
        self.lamp = self._own(LampShadow(context, config.lamp, config.camera)) if lamp else None
        self.tracks: TrackMap | None = None
        self._craters: CraterLists | None = None
        self._has_truth = False
        self.workers = self._own(Workers())
        self.waiting: list[GroundPicture] = []
        self._gather_programs()
        self.earth = (self._own(WorldPasses(context, world, self.rover, _under_earth(config),
                                            self.seed, self.ground))
                      if config.earth.lights_ground else None)

    @property
    def sources(self) -> tuple[WorldPasses, ...]:
        """The passes of each source of light: of the sun, and of the Earth if it is up."""
        if self.earth is None or not self.earth.config.sun.shines:
            return (self,)
        return self, self.earth

    def _gather_programs(self) -> None:
        self.programs = (*self.rocks.programs, *self.body.programs)
        self._set_constants()

    def prepare_truth(self) -> None:
        """Be able to draw truth from now on; programs are compiled for the first frame of it."""
        if not self._has_truth:
            self._has_truth = True
            for passes in (self.rocks, self.body):
                passes.prepare_truth()
            self._gather_programs()

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

    def light_on_ground(self, light: SceneLight, lamp: LampLight | None) -> GroundSource:
        """Return what the ground is lit with in a frame."""
        return GroundSource(self._constants, self._surface.texels,
                            None if self.tracks is None else self.tracks.arrays, light.shadow,
                            lamp)

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
        self.rocks.relight(light.rock_light)
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
        sun = self.config.sun
        # Patches of colour lie elsewhere in each world.
        place = np.random.default_rng([max(self.world.config.seed, 0), *b'colour']).uniform(
            -5e3, 5e3, 2)
        values = lighting_constants(self.config, sun_direction(sun.azimuth_deg,
                                                               sun.elevation_deg))
        values['u_tint_place'] = tuple(place)
        self.set_uniforms(**values)
        self._constants = GroundConstants.of(values, self.config.detail.smooth_outlines)

    def set_uniforms(self, **values: Any) -> None:
        """Set uniforms of all programs that have them."""
        for program in self.programs:
            set_uniform(program, **values)


def _under_earth(config: RenderConfig) -> RenderConfig:
    """Return the parameters with the Earth in place of the sun, and without a lamp."""
    return dataclasses.replace(config, sun=earth_as_sun(config.sun, config.earth),
                               earth=EarthConfig(), lamp=LampConfig())
