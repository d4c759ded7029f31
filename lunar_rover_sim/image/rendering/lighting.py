"""The constants of light: sun and reflectance, for shaders and for the loops of the ground."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.illumination import colours, hapke
from lunar_rover_sim.image.illumination.config import LOWEST_DEG
from lunar_rover_sim.image.rendering.config import DetailConfig, RenderConfig


def lighting_constants(config: RenderConfig, sun_direction: Array) -> dict[str, Any]:
    """Return values by the names of uniforms."""
    ground = hapke.parameter_set(config.reflectance.ground)
    rocks = hapke.parameter_set(config.reflectance.rocks)
    scale = config.reflectance.albedo_scale
    horizontal = max(math.hypot(*sun_direction[:2]), 0.02)  # stays finite for a sun overhead
    values: dict[str, Any] = {
        'u_sun': tuple(sun_direction),
        'u_heading': tuple(sun_direction / horizontal),
        # A sun that is farther down is held at the lowest elevation.
        'u_irradiance': config.sun.irradiance if config.sun.elevation_deg > LOWEST_DEG else 0.0,
        'u_sun_radius': math.radians(0.5 * config.sun.angular_diameter_deg),
        'u_rough': config.detail.relief_rms_slope / DetailConfig().relief_rms_slope,
        'u_rock_theta': math.tan(math.radians(rocks.theta_deg)),
        'u_diffuse': (hapke.hemispherical_albedo(ground) * scale / math.pi,
                      hapke.hemispherical_albedo(rocks) / math.pi),
        'u_trodden': (config.tracks.compacted_darkening, config.tracks.loose_darkening,
                      math.tan(math.radians(config.tracks.compacted_theta_deg)),
                      config.tracks.compacted_c),
    }
    red, blue = np.log(colours.ground_colour(config.reflectance.ground))
    spread = config.reflectance.colour_spread
    fresh = config.reflectance.colour_of_fresh
    lamp = np.log(colours.Bands().colour_of_light(config.lamp.temperature_k))
    values |= {'u_soil_tint': (red, blue, *colours.PHASE_SLOPE),
               'u_rock_tint': tuple(np.log(colours.rock_colour(config.reflectance.rocks))),
               'u_tint_spread': (spread, -spread, -fresh, fresh), 'u_lamp_tint': tuple(lamp)}
    for name, kind, factor in (('u_regolith', ground, scale), ('u_rock', rocks, 1.0)):
        values.update({f'{name}.w': kind.w * factor, f'{name}.b': kind.b, f'{name}.c': kind.c,
                       f'{name}.b_s0': kind.b_s0, f'{name}.h_s': kind.h_s})
    return values


@dataclasses.dataclass(frozen=True)
class GroundConstants:
    """Those of the ground, float32.

    Attributes:
        sun: (7,) unit vector to it, vector to it over level ground as `u_heading`, radius of its
            disc [rad].
        irradiance, diffuse: Of the sun, normal [W/m2]; diffuse albedo over pi.
        law: (5,) w, b, c, b_s0, h_s.
        trodden: (4,) as `u_trodden`.
        tint: `u_soil_tint`, `u_tint_spread`, `u_tint_place`, `u_lamp_tint`.
        smooth: Whether edges of shadows are drawn without steps.
    """

    sun: NDArray[np.float32]
    irradiance: np.float32
    diffuse: np.float32
    law: NDArray[np.float32]
    trodden: NDArray[np.float32]
    tint: list[NDArray[np.float32]]
    smooth: bool

    @classmethod
    def of(cls, values: dict[str, Any], smooth: bool) -> GroundConstants:
        """Return those among `lighting_constants` with the place of the tint."""
        def vector(*names: str) -> NDArray[np.float32]:
            return np.array([number for name in names for number in np.ravel(values[name])],
                            np.float32)
        law = (f'u_regolith.{key}' for key in ('w', 'b', 'c', 'b_s0', 'h_s'))
        return cls(vector('u_sun', 'u_heading', 'u_sun_radius'),
                   np.float32(values['u_irradiance']), np.float32(values['u_diffuse'][0]),
                   vector(*law), vector('u_trodden'),
                   [vector(name) for name in ('u_soil_tint', 'u_tint_spread', 'u_tint_place',
                                              'u_lamp_tint')], smooth)

    @property
    def towards(self) -> NDArray[np.float32]:
        """(4,) unit vector to the sun, radius of its disc [rad]."""
        return self.sun[[0, 1, 2, 6]]
