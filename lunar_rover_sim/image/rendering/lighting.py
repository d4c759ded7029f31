"""The constants of light: sun and reflectance, as compiled loops take them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.image.illumination import colours, hapke
from lunar_rover_sim.image.illumination.config import LOWEST_DEG
from lunar_rover_sim.image.rendering.config import DetailConfig, RenderConfig

F32 = NDArray[np.float32]

# Of soil that a rover has disturbed, as for `shade_rows.shade`. Its tracks are seen by their
# relief first. It is darker on the Moon, by a tenth or so in images from orbit, and scatters less
# back where it is smooth; how much differs from place to place, so these are choices: part of the
# albedo that compacted and that loose soil loses, tangent of the mean slope of the relief too
# small to be drawn on compacted soil, and what that adds to the balance c of the lobes.
_TRODDEN = 0.06, 0.08, math.tan(math.radians(12.0)), -0.25


@dataclasses.dataclass(frozen=True)
class LightConstants:
    """Those of one source of light and of what it lights.

    Attributes:
        sun: (7,) unit vector to it, vector to it over level ground, radius of its disc [rad].
        irradiance: Normal [W/m2].
        diffuse, rock_diffuse: Diffuse albedo over pi of ground and rocks.
        law, rock_law: (5,) w, b, c, b_s0, h_s.
        theta: Tangent of the roughness of ground no relief of which is drawn.
        rock_theta: Tangent of the roughness of rocks.
        rough: How rough rocks are, and how much soil lies on them; 1 is usual.
        trodden: (4,) as for `shade_rows.shade`.
        soil_tint: (4,) logarithms of red and blue over green at 30 deg of phase; their slopes.
        rock_tint, lamp_tint: (2,) those of rocks; of the light of the lamp over that of the sun.
        tint_spread: (4,) of the patches; change with the logarithm of albedo.
        tint_place: (2,) where the patches of this world lie [m].
        smooth: Whether edges of shadows are drawn without steps.
    """

    sun: F32
    irradiance: np.float32
    diffuse: np.float32
    rock_diffuse: np.float32
    law: F32
    rock_law: F32
    theta: np.float32
    rock_theta: np.float32
    rough: np.float32
    trodden: F32
    soil_tint: F32
    rock_tint: F32
    lamp_tint: F32
    tint_spread: F32
    tint_place: F32
    smooth: bool

    @property
    def towards(self) -> F32:
        """(4,) unit vector to the sun, radius of its disc [rad]."""
        return self.sun[[0, 1, 2, 6]]

    @classmethod
    def of(cls, config: RenderConfig, world_seed: int,
           origin_m: tuple[float, float] = (0.0, 0.0)) -> LightConstants:
        """Return the constants under the sun of `config`.

        Args:
            world_seed: Places patches of colour.
            origin_m: Of the frame that is drawn in, in the site.
        """
        matter, sun = config.reflectance, config.sun
        ground, rocks = (hapke.parameter_set(name) for name in (matter.ground, matter.rocks))
        direction = sun_direction(sun.azimuth_deg, sun.elevation_deg)
        horizontal = max(math.hypot(*direction[:2]), 0.02)  # stays finite for a sun overhead
        place = np.random.default_rng([max(world_seed, 0), *b'colour']).uniform(-5e3, 5e3, 2)
        place += origin_m
        spread, fresh = matter.colour_spread, matter.colour_of_fresh

        def vector(*numbers: float) -> F32:
            return np.array(numbers, np.float32)
        return cls(
            vector(*direction, *direction / horizontal,
                   math.radians(0.5 * sun.angular_diameter_deg)),
            # A sun that is farther down is held at the lowest elevation.
            np.float32(sun.irradiance if sun.elevation_deg > LOWEST_DEG else 0.0),
            np.float32(hapke.hemispherical_albedo(ground) * matter.albedo_scale / math.pi),
            np.float32(hapke.hemispherical_albedo(rocks) / math.pi),
            ground.law(matter.albedo_scale), rocks.law(),
            np.float32(math.tan(math.radians(ground.theta_deg))),
            np.float32(math.tan(math.radians(rocks.theta_deg))),
            np.float32(config.detail.relief_rms_slope / DetailConfig().relief_rms_slope),
            vector(*_TRODDEN),
            vector(*np.log(colours.ground_colour(matter.ground)), *colours.PHASE_SLOPE),
            vector(*np.log(colours.rock_colour(matter.rocks))),
            vector(*np.log(colours.Bands().colour_of_light(config.lamp.temperature_k))),
            vector(spread, -spread, -fresh, fresh), vector(*place), config.detail.smooth_outlines)
