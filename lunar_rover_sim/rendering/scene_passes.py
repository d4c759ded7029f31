"""The passes of a frame in their order: geometry, light, rocks, rover, edges, truth."""

from __future__ import annotations

import contextlib
import math
from typing import Any, TypeVar

import moderngl
import numpy as np

from lunar_rover_sim.camera.rig import StereoRig
from lunar_rover_sim.frames import sun_direction
from lunar_rover_sim.illumination.rock_shadow import sun_axes
from lunar_rover_sim.illumination.sunlight import Sunlight
from lunar_rover_sim.regolith.overlay import Overlay
from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rendering.context import clear_window, set_uniform
from lunar_rover_sim.rendering.edge_pass import EdgePass
from lunar_rover_sim.rendering.frame_targets import FrameTargets, LitTargets
from lunar_rover_sim.rendering.ground_pass import GroundPass
from lunar_rover_sim.rendering.lamp_shadow import LampShadow
from lunar_rover_sim.rendering.lighting import lighting_constants
from lunar_rover_sim.rendering.projection import Projection
from lunar_rover_sim.rendering.relief_brightness import relief_brightness
from lunar_rover_sim.rendering.relief_tiles import start_tiles
from lunar_rover_sim.rendering.rock_pass import RockPass
from lunar_rover_sim.rendering.rover_pass import RoverPass
from lunar_rover_sim.rendering.rover_shadow import RoverShadow
from lunar_rover_sim.rendering.scene import LEFT, Request, Scene
from lunar_rover_sim.rendering.seen_links import seen_links
from lunar_rover_sim.rendering.sun_pass import Occluders, SunPass
from lunar_rover_sim.rendering.surface import Surface
from lunar_rover_sim.rendering.track_map import TrackMap
from lunar_rover_sim.rendering.track_texels import TrackSun
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.world.far_rocks import far_rocks
from lunar_rover_sim.world.model import World

FRAMES_UNDER_WAY = 2    # one is lit while the geometry of the next one is drawn

Owned = TypeVar('Owned')


class ScenePasses:
    """Draws the world into radiance, depth and truth.

    lit: what frames are lit into
    seen: indices of the rover's links that its cameras may see, as `seen_links`
    """

    def __init__(self, context: moderngl.Context, world: World, rover: RoverDescription,
                 config: RenderConfig, projection: Projection, seed: int) -> None:
        """Make all passes; projection: of both cameras; seed: of the relief below the grid."""
        self._context, self._world, self._config = context, world, config
        self._rig, self._projection = StereoRig(rover, config.camera), projection
        self._owned = contextlib.ExitStack()
        try:
            self._build(rover, seed)
        except Exception:
            self.release()
            raise

    def _build(self, rover: RoverDescription, seed: int) -> None:
        context, config, world = self._context, self._config, self._world
        self._seed = seed
        self.lit = self._own(LitTargets(context, (self._projection.width,
                                                  2 * self._projection.height)))
        self._targets = [self._own(FrameTargets(context, self.lit))
                         for _ in range(FRAMES_UNDER_WAY)]
        self._edges = (self._own(EdgePass(context, self.lit, self._projection))
                       if config.detail.smooth_outlines else None)
        self._surface = self._own(Surface(context, world))
        self._far_rocks = far_rocks(world, config.detail.far_rocks_m)
        sunlight = self._light_surface()
        lamp = config.lamp.power_w > 0.0
        self._ground = self._own(GroundPass(context, world, config.detail, self._surface, lamp))
        self._rocks = self._own(RockPass(context, sunlight.rocks, world.rock_shapes,
                                         sunlight.rock_light(), self._surface, lamp,
                                         config.detail.smooth_outlines))
        self.seen = seen_links(rover, (self._rig.T_base_left, self._rig.T_base_right),
                               self._projection)
        self._rover = self._own(RoverPass(context, rover))
        self._rover_shadow = self._own(RoverShadow(context, rover))
        self._sun = self._own(SunPass(context, self.lit, self._projection, config))
        self._lamp = self._own(LampShadow(context, config.lamp, config.camera)) if lamp else None
        self._tracks: TrackMap | None = None
        self._gather_programs()

    def _gather_programs(self) -> None:
        self._programs = (*self._ground.programs, *self._rocks.programs, *self._rover.programs)
        self._set_constants()

    def follow(self, overlay: Overlay) -> None:
        """Draw the tracks of an overlay from now on."""
        self._tracks = self._own(TrackMap(self._context, self._world.ground, overlay,
                                          self._track_sun()))
        self._ground.follow(self._tracks)
        self._gather_programs()

    def _track_sun(self) -> TrackSun:
        sun = self._config.sun
        return TrackSun.of(sun_direction(sun.azimuth_deg, sun.elevation_deg),
                           math.radians(0.5 * sun.angular_diameter_deg))

    def _own(self, item: Owned) -> Owned:
        """Have an object released with the passes, the last one first."""
        self._owned.callback(item.release)      # type: ignore[attr-defined]
        return item

    def relight(self, config: RenderConfig) -> None:
        """Move the sun; config: differs in the sun only."""
        self._config = config
        self._rocks.relight(self._light_surface().rock_light())
        self._sun.relight(config.sun)
        if self._tracks is not None:
            self._tracks.relight(self._track_sun())
        self._set_constants()

    def _light_surface(self) -> Sunlight:
        """Compute what the sun sees."""
        sun = self._config.sun
        direction = sun_direction(sun.azimuth_deg, sun.elevation_deg)
        tiles = start_tiles(self._config.detail, self._seed, direction)
        self._sunlight = Sunlight(self._world, sun, self._config.reflectance, direction,
                                  indirect=self._config.detail.bounce, far=self._far_rocks)
        self._sun_axes = sun_axes(self._sunlight.sun)
        made, radius = tiles.result(), math.radians(0.5 * sun.angular_diameter_deg)
        self._surface.light(self._sunlight, radius, made, relief_brightness(
            made, self._config.reflectance, self._sunlight.sun.elevation_rad, radius))
        return self._sunlight

    def _set_constants(self) -> None:
        sun = self._config.sun
        self._set_uniforms(**lighting_constants(
            self._config, sun_direction(sun.azimuth_deg, sun.elevation_deg)))

    def _set_uniforms(self, **values: Any) -> None:
        for program in self._programs:
            set_uniform(program, **values)

    def draw_geometry(self, request: Request, state: RoverPose) -> Scene:
        """Draw the depth of the ground and choose what else is in view."""
        self._targets.reverse()
        targets, projection = self._targets[0], self._projection
        T_world_base = state.T_world_base
        links = self._rover.poses(T_world_base, state.joint_angle_rad)
        # Both cameras decide what is drawn: an image does not depend on the other layers.
        cameras = [T_world_base @ self._rig.T_base_left, T_world_base @ self._rig.T_base_right]
        volume = projection.view_volume(cameras, self._world)
        if self._tracks is not None:
            self._tracks.update(volume)
        chosen = self._ground.choose(volume)
        if self._lamp is not None and request.lit:
            self._lamp.draw(T_world_base, self._world, self._ground, self._rocks)
        w, h = projection.width, projection.height
        windows = [(0, side * h, w, h) for side in range(len(cameras))]
        scene = Scene(request, targets, state, links, cameras, windows)
        if request.lit:
            self._sun.look(scene, volume, Occluders(self._ground, self._rocks, self._rover,
                                                    self._sunlight))
        for side in request.sides:
            targets.views[side].place(cameras[side], projection, volume, window=windows[side],
                                      size=targets.size)
            targets.views[side].bind()
            clear_window(targets.ground[side], windows[side])
            if side == request.sides[-1]:   # meanwhile the driver draws the other side
                scene.shadow = self._rover_shadow.cast(links, self._sun_axes, volume)
                outlined = self._rocks.choose(volume, self._rig.focal_px,
                                              self._config.detail.rock_min_px)
                smooth = bool(self.seen) and self._edges is not None
                if self._rover.is_in_view(links, volume):
                    scene.body = self._rover.light(links, self._rover_shadow.radius_m,
                                                   self._sunlight, self._config.sun.irradiance,
                                                   -1.0 if smooth else 1.0)
                    if smooth:
                        outlined = np.concatenate([outlined, self._rover.balls(links)])
                scene.outlined_m = outlined
                scene.rows = self._ground.rows(chosen, projection, cameras[LEFT])
            self._ground.draw_depth(chosen)
        return scene

    def light(self, scene: Scene) -> None:
        """Light the ground, and draw rocks and the rover over it."""
        targets, request = scene.targets, scene.request
        self._set_uniforms(**scene.shadow)
        for side in request.sides:
            self._look_from(scene, side)
            clear_window(self.lit.framebuffer, scene.windows[side])
            self._ground.draw(self.lit.framebuffer, scene.windows[side], scene.rows,
                              targets.ground_depth, lit=request.lit)
        for side in request.sides:
            self._look_from(scene, side)
            self._draw_objects(scene, targets.objects[side], side)
        if request.lit and self._edges is not None:
            self._edges.draw({side: scene.T_world_cameras[side] for side in request.sides},
                             scene.outlined_m)
        if request.lit:
            self._sun.draw(scene)
        if request.truth:
            self._look_from(scene, LEFT)
            # The depth is kept: which surface is nearest is known already.
            clear_window(targets.truth.colour, scene.windows[LEFT])
            self._ground.draw_truth(targets.ground_depth)
            self._context.depth_func = '<='
            try:
                self._draw_objects(scene, targets.truth.framebuffer, LEFT, truth=True)
            finally:
                self._context.depth_func = '<'

    def mark_rover(self, scene: Scene, target: moderngl.Framebuffer) -> None:
        """Draw which link of the rover each pixel of a lit scene shows, as `RoverPass.mark`."""
        for side in scene.request.sides:
            scene.targets.views[side].bind()
            clear_window(target, scene.windows[side])
            self._rover.mark(scene.T_world_links, self.lit.depth)

    def _look_from(self, scene: Scene, side: int) -> None:
        """Draw for a camera from now on."""
        scene.targets.views[side].bind()
        if self._lamp is not None:
            self._lamp.bind(self._programs, scene.state.T_world_base,
                            scene.T_world_cameras[side])

    def _draw_objects(self, scene: Scene, target: Any, side: int, *, truth: bool = False) -> None:
        target.use()
        target.viewport = scene.windows[side]
        self._rocks.draw(truth=truth)
        if scene.body is not None:
            self._rover.draw(scene.T_world_links, scene.body, truth=truth)

    def release(self) -> None:
        """Release the GL objects."""
        self._owned.close()
