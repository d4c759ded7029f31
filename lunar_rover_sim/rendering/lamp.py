"""The rover's lamp: a spot light with inverse square fall-off and a shadow map of its own."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array, matrix_from_wxyz, R_BODY_OPTICAL, se3, wxyz_from_rpy
from lunar_rover_sim.illumination.config import LampConfig
from lunar_rover_sim.illumination.lamp import beam_exponent, peak_intensity
from lunar_rover_sim.rendering.context import set_uniform

if TYPE_CHECKING:
    import moderngl

MAP = 2048      # pixels along a side of the shadow map
_WIDEST_DEG = 55.0      # half angle of the map: what the cameras see lies within


class Lamp:
    """Beam and shadow map of the lamp.

    The radiant intensity falls as the m-th power of the cosine to the axis, m such that it is
    halved at half the cone's angle; all of it makes the configured flux.
    """

    def __init__(self, context: moderngl.Context, config: LampConfig) -> None:
        self.config = config
        tilt = matrix_from_wxyz(wxyz_from_rpy(0.0, math.radians(config.pitch_deg), 0.0))
        self.T_base_lamp = se3(tilt @ R_BODY_OPTICAL, config.position_m)
        self.exponent = beam_exponent(config)
        self.intensity = peak_intensity(config)
        # The map covers the beam down to a hundredth of its peak.
        half = min(math.acos(0.01**(1.0 / self.exponent)), math.radians(_WIDEST_DEG))
        focal = 0.5 * MAP / math.tan(half)
        centre = 0.5 * (MAP - 1)
        self.K: Array = np.array([[focal, 0, centre], [0, focal, centre], [0, 0, 1.0]])
        self.depth = context.texture((MAP, MAP), 1, dtype='f4')
        self.depth.filter = (context.NEAREST, context.NEAREST)
        self.depth.repeat_x = self.depth.repeat_y = False
        self._unused = context.texture((MAP, MAP), 1, dtype='f4')
        self._buffer = context.depth_renderbuffer((MAP, MAP))
        self.ground_target = context.framebuffer([self.depth], self._buffer)
        self.object_target = context.framebuffer([self._unused, self.depth], self._buffer)

    def place(self, program: moderngl.Program, pose: Array, camera: Array,
              clip: NDArray[np.float32], unit: int) -> None:
        """Tell a program where the lamp is, relative to a camera; clip as in the shadow map."""
        offset = pose[:3, 3] - camera[:3, 3]
        set_uniform(program, u_lamp=tuple(offset), u_lamp_axis=tuple(pose[:3, 2]),
                    u_lamp_beam=(self.intensity, self.exponent), u_lamp_clip=clip,
                    u_lamp_depth=unit, u_lamp_pixel=2.0 / float(self.K[0, 0]))
        self.depth.use(unit)
