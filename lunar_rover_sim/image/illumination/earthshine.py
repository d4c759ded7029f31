"""Earthshine: the Earth as a source of light, in the terms of the sun.

The Earth lights the ground as a sun of its place, size and irradiance would. Its disc is taken as
evenly bright, whatever its phase: half of it may really be dark, which makes penumbrae up to a
degree narrower than they are drawn.
"""

from __future__ import annotations

import math

from lunar_rover_sim.image.illumination.config import LOWEST_DEG, SunConfig
from lunar_rover_sim.image.illumination.earth_disc import earth_disc


def earth_as_sun(sun: SunConfig) -> SunConfig:
    """Return the sun that would light the ground as the Earth does at the date of a sun.

    Args:
        sun: As for `earth_disc`. The irradiance is 0 while none of the disc is above the
            horizontal.
    """
    disc = earth_disc(sun)
    if disc is None:
        return SunConfig(irradiance=0.0, elevation_deg=LOWEST_DEG)
    x, y, z = disc.direction
    return SunConfig(azimuth_deg=math.degrees(math.atan2(y, x)),
                     elevation_deg=max(math.degrees(math.asin(z)), LOWEST_DEG),
                     angular_diameter_deg=2.0 * math.degrees(disc.radius_rad),
                     irradiance=disc.irradiance)
