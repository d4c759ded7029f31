"""The pass of motion: the mean of radiance over the exposure, from the picture at its stamp."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol

import moderngl
import numpy as np

from lunar_rover_sim.camera.motion import CameraTwist
from lunar_rover_sim.camera.mount import Mount
from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering import texture_units
from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rendering.context import load_program, release_all, set_uniform
from lunar_rover_sim.rendering.frame_targets import attachment, LitImages
from lunar_rover_sim.rendering.image_geometry import ImageGeometry
from lunar_rover_sim.rendering.scene import Scene, Uniforms
from lunar_rover_sim.rover.description import RoverDescription

_STILL_PX = 0.2         # a picture in which nothing moves farther stays as it is: at an edge,
# the mean over such a path differs by less than 0.2 % of the step
_SMEAR_PX = 1.2         # up to this length, paths are left to the point spread of the sensor
_STEP_PX = 1.5          # between samples on the longest path; most paths are half as long
_MOST_SAMPLES = 128
_GRID = np.linspace(0.0, 1.0, 5)    # places in the image, over its size, where paths are measured
_NEAREST_M = 0.1        # least depth that counts then
_RADIANCE, _DEPTH, _LINK = range(3)     # texture units


class Blurred(NamedTuple):
    """A pair of radiance images, and motion that the point spread of the sensor has yet to add.

    smear: uniforms of shaders/sensor.frag by side, None if there is nothing to add
    """

    radiance: moderngl.Texture
    smear: dict[int, Uniforms] | None = None


class LitPasses(Protocol):
    """What has lit a scene, as `ScenePasses`."""

    @property
    def lit(self) -> LitImages:
        """What it is lit into."""

    def mark_rover(self, scene: Scene, target: moderngl.Framebuffer) -> None:
        """Draw which link of the rover each pixel of a lit scene shows, as `RoverPass.mark`."""


class MotionPass:
    """Blurs pairs of radiance images by the motion during the exposure, and rolls the shutter.

    The exposure of the middle row is centred on the stamp; with a global shutter, that of all
    rows is. Velocities are taken as constant. The picture at the stamp is sampled along the path
    of each pixel, and what lies beyond the image repeats its edge. Parts of the rover in view
    move as their links do. Shadows move with the ground, also those of the rover and of its lamp.
    """

    def __init__(self, context: moderngl.Context, rover: RoverDescription, config: RenderConfig,
                 image: ImageGeometry, mount: Mount, seen: tuple[int, ...]) -> None:
        """Compile the programs; image: either of both; seen: as `seen_links`."""
        self._context, self._rover, self._image = context, rover, image
        self._mount = mount
        self._blur, self._line_time_s = config.sensor.motion_blur, config.sensor.line_time_s
        self._roll_s = config.camera.height * self._line_time_s
        # The sensor smears pixels as they lie in the pinhole image, before charge blooms.
        self._smears = not (config.camera.distorted or config.sensor.blooming
                            or self._line_time_s or image.defines)
        self._sees_rover = bool(seen)
        # Links that move in the images.
        self._links = [link for link in seen if link > 0 or not mount.on_body]
        size = (image.width, 2 * image.height)
        self._mean = attachment(context, size)
        self._target = context.framebuffer([self._mean])
        self._sampler = context.sampler(repeat_x=False, repeat_y=False,
                                        filter=(context.LINEAR, context.LINEAR))
        rolling: dict[str, int] = {}
        rover_moves = {'ROVER': 1, **({'ON_BODY': 1} if mount.on_body else {})}
        if self._line_time_s > 0.0:
            rolling = {'ROLLING': 1, **({'DISTORTED': 1} if config.camera.distorted else {})}
        whole = load_program(context, 'screen', 'motion', BODIES=1 + len(self._links),
                             **(rover_moves if self._sees_rover else {}), **rolling,
                             **image.defines)
        self._programs = [whole] if image.defines else [
            load_program(context, 'screen', 'motion', BODIES=1, SHORT=1), whole]
        for program in self._programs:
            set_uniform(program, u_radiance=_RADIANCE, u_depth=_DEPTH, u_link=_LINK,
                        **image.uniforms,
                        u_texel=(1.0 / size[0], 1.0 / size[1]), u_line_time=self._line_time_s,
                        u_distortion=config.camera.distortion,
                        u_leg=np.array([0, *(1 + link for link in self._links)], np.float32))
        self._screens = [context.vertex_array(program, []) for program in self._programs]
        self._marked = LinkTargets(context, size) if self._sees_rover else None

    def draw(self, passes: LitPasses, scene: Scene, exposure_s: float) -> Blurred:
        """Return the mean radiance over an exposure [s] of a scene that has just been lit.

        Where nothing moves far enough to be seen, this is the lit picture itself. Where paths
        are about as short as a pixel, too; the point spread of the sensor takes them in.
        """
        exposure_s *= self._blur
        twists = {side: self._twists(scene, side) for side in scene.request.lit_sides}
        longest = max((self._longest_path(scene, side, twists[side], exposure_s + self._roll_s)
                       for side in twists), default=0.0)
        if longest < _STILL_PX:
            return Blurred(passes.lit.radiance)
        sees_rover = self._sees_rover and scene.shows_rover
        if longest < _SMEAR_PX and self._smears and not sees_rover:
            passes.lit.depth.use(texture_units.GROUND_DEPTH)
            return Blurred(passes.lit.radiance, self._smear(twists, exposure_s))
        samples = 2 * math.ceil(0.5 * longest / _STEP_PX)
        short = (samples == 2 and not sees_rover and not self._line_time_s
                 and len(self._programs) > 1)
        values: dict[str, Any] = {'u_exposure': exposure_s,
                                  'u_samples': min(samples, _MOST_SAMPLES) if self._blur else 1}
        if self._marked is not None and not short:
            passes.mark_rover(scene, self._marked.framebuffer)
            self._marked.link.use(_LINK)
        kind = 0 if short else -1
        program, screen = self._programs[kind], self._screens[kind]
        self._target.use()
        self._context.enable_only(self._context.NOTHING)
        passes.lit.radiance.use(_RADIANCE)
        passes.lit.depth.use(_DEPTH)
        for unit in (_RADIANCE, _LINK):
            self._sampler.use(unit)
        for side, bodies in twists.items():
            if short:
                bodies = bodies[:1]
            self._target.viewport = window = scene.pixels.windows[side]
            set_uniform(program, u_rows=(window[1], window[3] - 1), **values,
                        u_rate=_packed([twist.angular_velocity_radps for twist in bodies]),
                        u_velocity=_packed([twist.linear_velocity_mps for twist in bodies]),
                        u_leg_nearness=self._leg_nearness(scene, side))
            screen.render(vertices=3)
        for unit in (_RADIANCE, _LINK):
            self._sampler.clear(unit)
        return Blurred(self._mean)

    def _smear(self, twists: dict[int, list[CameraTwist]],
               exposure_s: float) -> dict[int, Uniforms]:
        """Return the uniforms that tell the sensor how each camera moves."""
        return {side: {'u_depth': texture_units.GROUND_DEPTH, **self._image.uniforms,
                       'u_turn': tuple(exposure_s * ground.angular_velocity_radps),
                       'u_shift': tuple(exposure_s * ground.linear_velocity_mps)}
                for side, (ground, *_) in twists.items()}

    def _twists(self, scene: Scene, side: int) -> list[CameraTwist]:
        """Return the motion of a camera relative to the world, then to links that move in view."""
        links = self._mount.link_twists(scene.state, side, self._rover) if self._links else []
        return [self._mount.ground_twist(scene.state, side), *(links[k] for k in self._links)]

    def _leg_nearness(self, scene: Scene, side: int) -> Array:
        """Return the inverse depths of the origins of these links, after a 0 [1/m]."""
        camera = scene.T_world_cameras[side]
        axles = (scene.T_world_links[self._links, :3, 3] - camera[:3, 3]) @ camera[:3, :3]
        nearness = np.minimum(self._image.nearness(axles), 1.0 / _NEAREST_M)
        return np.concatenate([[0.0], nearness]).astype(np.float32)

    def _longest_path(self, scene: Scene, side: int, twists: list[CameraTwist],
                      time_s: float) -> float:
        """Return about how far points move in the image during a time, at most [px].

        It is measured at 25 places, where the ground is taken to be level under the rover's feet.
        """
        camera = scene.T_world_cameras[side]
        rays = self._image.rays(np.stack(np.meshgrid(
            _GRID * (self._image.width - 1), _GRID * (self._image.height - 1)),
            axis=-1).reshape(-1, 2))
        fall = -(rays @ camera[2, :3])
        height = max(camera[2, 3] - scene.T_world_links[1:, 2, 3].mean()
                     + self._rover.legs.spoke_length_m, _NEAREST_M)
        ground = np.minimum(np.maximum(fall, 0.0) / height, 1.0 / _NEAREST_M)
        nearness = [ground, *(np.full(len(rays), n) for n in self._leg_nearness(scene, side)[1:])]
        speeds = [self._image.image_speed(twist, rays, near)
                  for twist, near in zip(twists, nearness)]
        return float(np.max(speeds)) * time_s

    def release(self) -> None:
        """Release the GL objects."""
        if self._marked is not None:
            self._marked.release()
        release_all(*self._screens, *self._programs, self._sampler, self._target, self._mean)


class LinkTargets:
    """Where it is drawn which pixels show which link of the rover.

    link: texture of 0 where none is seen, else of 1 + the index of the link; framebuffer: of it
    """

    def __init__(self, context: moderngl.Context, size: tuple[int, int]) -> None:
        self.link = attachment(context, size)
        self._buffer = context.depth_renderbuffer(size)
        self.framebuffer = context.framebuffer([self.link], self._buffer)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(self.framebuffer, self._buffer, self.link)


def _packed(vectors: list[Array]) -> Array:
    return np.array(vectors, np.float32)
