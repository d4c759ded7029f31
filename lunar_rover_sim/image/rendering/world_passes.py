"""Passes that all cameras of a renderer share: ground, its light, rocks, rover, tracks, lamp."""

from __future__ import annotations

import dataclasses
import math

import moderngl
import numpy as np

from lunar_rover_sim.base.frames import Array, sun_direction
from lunar_rover_sim.base.workers import Workers
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.lidar.ray_arrays import RockHulls
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.context import GlOwner
from lunar_rover_sim.image.rendering.crater_map import CraterLists
from lunar_rover_sim.image.rendering.drawn_window import DrawnWindow, under_earth, WorldLight
from lunar_rover_sim.image.rendering.ground import Ground
from lunar_rover_sim.image.rendering.ground_band import GroundSource
from lunar_rover_sim.image.rendering.ground_picture import GroundPicture
from lunar_rover_sim.image.rendering.labels import FIRST_CRATER, LABEL_FIRST_ROCK, Numbers
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
from lunar_rover_sim.rover.description import RoverDescription


class WorldPasses(GlOwner):
    """The passes that draw the world, for whichever camera is bound.

    What they have chosen for a camera holds until its frame is lit.

    Attributes:
        world: The window of the site that is drawn, in its own frame.
        offset_m: (3,) place of that frame in the one that poses are given in.
        rover, config, seed: As given.
        sunlight, sun_axes: What the sun sees.
        ground: Of the world.
        rocks, body, rover_shadow: Passes.
        lamp: None without a lamp.
        tracks: None before `follow`.
        rock_table: What the light of rocks follows from.
        rock_labels, crater_numbers: (m,) of those of the window, in the images of truth.
        workers: Threads for rows of images.
        waiting: Frames whose ground is not made yet.
        earth: Passes of the light of the Earth, as if that were the sun; None if it is not drawn.
    """

    def __init__(self, context: moderngl.Context, window: DrawnWindow, light: WorldLight,
                 rover: RoverDescription, config: RenderConfig, seed: int,
                 ground: Ground | None = None) -> None:
        """Make all passes.

        Args:
            window: What to draw, and its light.
            seed: Of the relief below the grid.
            ground: That of another source of light.
        """
        super().__init__()
        self._context = context
        self.rover, self.config, self.seed = rover, config, seed
        with self._making():
            self._build(window, light, ground)

    def _build(self, window: DrawnWindow, light: WorldLight, ground: Ground | None) -> None:
        context, config = self._context, self.config
        self._surface = Surface(light.surface.tiles, light.surface.texels)
        self._rock_book, self._crater_book = Numbers(LABEL_FIRST_ROCK), Numbers(FIRST_CRATER)
        self.ground = ground or Ground(window.world, config.detail, self._surface, window.heights)
        self.rocks = self._own(RockPass(context, light.sunlight.rocks, window.world.rock_shapes))
        self.body = self._own(RoverPass(context, self.rover))
        self.rover_shadow = RoverShadow(self.rover)
        self.lamp = (self._own(LampShadow(context, config.lamp, config.camera))
                     if config.lamp.power_w > 0.0 else None)
        self.tracks: TrackMap | None = None
        self.workers = self._own(Workers())
        self.waiting: list[GroundPicture] = []
        self._take(window, light)
        self.earth = (self._own(WorldPasses(context, window, light.earth, self.rover,
                                            under_earth(config), self.seed, self.ground))
                      if light.earth is not None else None)

    def _take(self, window: DrawnWindow, light: WorldLight) -> None:
        """Take what is known of a window, and its light."""
        self._window, self.world, rocks = window, window.world, light.sunlight.rocks
        self.offset_m = window.offset_m
        self.rock_labels = self._rock_book.of(rocks.key)
        self.crater_numbers = self._crater_book.of(self.world.craters.key)
        self._craters: CraterLists | None = None
        self.rock_table = rock_table(rocks, light.rock_light,
                                     self.world.height_at(rocks.position_m[:, :2]))
        self._hulls = RockHulls(rocks, self.world.rock_shapes).arrays
        self._light_surface(light)
        self._set_constants()

    def enter(self, window: DrawnWindow, light: WorldLight) -> None:
        """Draw another window of the site; no frame may be under way.

        Args:
            light: Of `config.sun` on it.
        """
        self.make_waiting()
        self._take(window, light)
        self.rocks.enter(light.sunlight.rocks)
        self.ground.enter(window.world, window.heights)
        if self.tracks is not None:
            self.tracks.enter(window.given.ground)
        if self.earth is not None and light.earth is not None:
            self.earth.enter(window, light.earth)

    @property
    def numbers(self) -> tuple[Numbers, Numbers]:
        """Those of rocks and craters, of all windows so far; set, they count from `enter` on."""
        return self._rock_book, self._crater_book

    @numbers.setter
    def numbers(self, numbers: tuple[Numbers, Numbers]) -> None:
        self._rock_book, self._crater_book = numbers

    @property
    def sources(self) -> tuple[WorldPasses, ...]:
        """The passes of each source of light: of the sun, and of the Earth if it is up."""
        if self.earth is None or not self.earth.config.sun.shines:
            return (self,)
        return self, self.earth

    def follow(self, overlay: Overlay) -> None:
        """Draw the tracks of an overlay from now on."""
        self.tracks = TrackMap(self._window.given.ground, overlay, self._track_sun())
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
            self._craters = self._window.crater_lists().numbered(self.crater_numbers)
        return self._craters

    def source(self, light: SceneLight, lamp: LampLight | None,
               T_world_links: Array) -> ObjectSource:
        """Return what a frame is lit with by this source of light."""
        ground = GroundSource(self._constants, self._surface.texels,
                              None if self.tracks is None else self.tracks.arrays, light.shadow,
                              lamp)
        return ObjectSource(ground, self.rock_table, self._hulls, light.body, self.body.parts,
                            T_world_links.astype(np.float32))

    def make_waiting(self) -> None:
        """Make the ground of frames that wait for it, before the ground changes."""
        waiting, self.waiting = self.waiting, []
        for picture in waiting:
            picture.make()

    def light_of(self, sun: SunConfig) -> WorldLight:
        """Compute the light of another sun; in any thread, while others draw."""
        return self._window.light(dataclasses.replace(self.config, sun=sun), self.seed)

    def relight(self, light: WorldLight) -> None:
        """Move the sun; light: as `light_of` returned it for this window."""
        self.config = dataclasses.replace(self.config, sun=light.sun)
        self._light_surface(light)
        self.rock_table = self.rock_table.copy()
        self.rock_table[:, 15:20] = light.rock_light
        if self.tracks is not None:
            self.tracks.relight(self._track_sun())
        self._set_constants()
        if self.earth is not None and light.earth is not None:
            self.earth.relight(light.earth)

    def _light_surface(self, light: WorldLight) -> None:
        self.sunlight, self.sun_axes = light.sunlight, light.sun_axes
        self._surface.tiles, self._surface.texels = light.surface.tiles, light.surface.texels

    def _set_constants(self) -> None:
        self._constants = LightConstants.of(self.config, self.world.config.seed,
                                            self.world.origin_m)
