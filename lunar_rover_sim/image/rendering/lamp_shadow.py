"""The pass of the lamp's shadow: depth of ground and rocks as the lamp sees them."""

from __future__ import annotations

import math

import moderngl
import numpy as np

from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, R_BODY_OPTICAL, se3, wxyz_from_rpy
from lunar_rover_sim.base.workers import Workers
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.illumination.config import LampConfig
from lunar_rover_sim.image.rendering.canvas import attachment, read_image
from lunar_rover_sim.image.rendering.context import clear_window, release_all
from lunar_rover_sim.image.rendering.ground import Ground
from lunar_rover_sim.image.rendering.ground_picture import cover_depth
from lunar_rover_sim.image.rendering.lamp_rows import LampLight
from lunar_rover_sim.image.rendering.projection import Projection, View
from lunar_rover_sim.image.rendering.rock_pass import RockPass

MAP = 2048              # pixels along a side of the shadow map
_WIDEST_DEG = 55.0      # half angle of the map: what the cameras see lies within
_ROCK_MIN_PX = 2.0      # of the map; rocks that look smaller cast no shadow
_WINDOW = (0, 0, MAP, MAP)


class LampShadow:
    """Beam and shadow map of the lamp, a spot light whose light falls with the squared distance.

    The radiant intensity falls as the m-th power of the cosine to the axis. m is such that the
    intensity is halved at half the cone angle, and the whole beam has the configured flux.
    """

    def __init__(self, context: moderngl.Context, config: LampConfig,
                 camera: CameraConfig) -> None:
        """Make the map; camera: gives the range of depth."""
        self._context = context
        tilt = matrix_from_wxyz(wxyz_from_rpy(0.0, math.radians(config.pitch_deg), 0.0))
        self._T_base_lamp = se3(tilt @ R_BODY_OPTICAL, config.position_m)
        self._exponent = config.beam_exponent
        self._intensity = config.peak_intensity
        # The map covers the beam down to a hundredth of its peak.
        half = min(math.acos(0.01**(1.0 / self._exponent)), math.radians(_WIDEST_DEG))
        focal = 0.5 * MAP / math.tan(half)
        centre = 0.5 * (MAP - 1)
        K: Array = np.array([[focal, 0, centre], [0, focal, centre], [0, 0, 1.0]])
        self._projection = Projection(K, MAP, MAP, camera.near_m, camera.far_m)
        self._view = View(context)
        self._depth = attachment(context, (MAP, MAP))
        self._buffer = context.depth_renderbuffer((MAP, MAP))
        self._target = context.framebuffer([self._depth], self._buffer)

    def draw(self, T_world_base: Array, world: World, ground: Ground, rocks: RockPass,
             workers: Workers) -> LampLight:
        """Draw the shadow map, and return the lamp with it.

        The rocks are chosen anew afterwards, for the cameras.
        """
        T_world_lamp = T_world_base @ self._T_base_lamp
        volume = self._projection.view_volume([T_world_lamp], world)
        self._view.place(T_world_lamp, self._projection, volume.centre_m)
        self._view.bind()
        clear_window(self._target, _WINDOW)
        rocks.choose(volume, self._projection.focal_px, _ROCK_MIN_PX)
        rocks.draw()
        shadow = read_image(self._target, 0, 0, (MAP, MAP))
        cover_depth(shadow, ground.depth(self._view.numbers, self._projection,
                                         ground.tracks_in(volume), workers), workers)
        return LampLight(T_world_lamp, (self._intensity, self._exponent,
                                        2.0 / self._projection.focal_px),
                         self._projection.clip_matrix(T_world_lamp), shadow)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(self._target, self._buffer, self._depth, self._view)
