"""The Earth as it is seen from the Moon: a sphere that the sun lights from one side.

Its phase function is after Mallama & Hilton (2018, Astronomy and Computing 25, equation 5), in
magnitudes -1.060e-3 a + 2.054e-4 a^2 for a phase angle of a degrees; the coefficients were
compared with programs that cite the paper.
Over the disc it is spread as on a Lambert sphere. Clouds, land and the glow of the air are left
out. Over the whole solar spectrum the Earth reflects about half of what it does in V (Glenar et
al., 2019, Icarus 321: 0.15 W/m2 at full phase, half of which is its own heat).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.illumination.dates import parse_date
from lunar_rover_sim.image.illumination.sky import sky
from lunar_rover_sim.image.illumination.sun_of_date import given_site

_GEOMETRIC_ALBEDO = 0.434   # in V: Mallama et al., 2017, Icarus 282
_LEAST_LIT = 1e-4       # of a Lambert sphere: thinner crescents keep their radiance


@dataclasses.dataclass(frozen=True)
class EarthDisc:
    """The Earth over a site.

    Attributes:
        direction: (3,) unit vector to it, world axes.
        sun_direction: (3,) unit vector from it to the sun, world axes.
        radius_rad: Apparent radius.
        irradiance: Normal irradiance by all that is lit of it [W/m2].
    """

    direction: Array
    sun_direction: Array
    radius_rad: float
    irradiance: float

    @property
    def phase_rad(self) -> float:
        """The angle between sun and Moon, seen from the Earth: 0 is full."""
        return math.acos(min(max(-float(self.direction @ self.sun_direction), -1.0), 1.0))

    def radiance(self, rays: Array) -> Array:
        """Return the radiance (...,) that comes along (..., 3) rays of any length [W m-2 sr-1]."""
        rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        along = rays @ self.direction
        across = (rays - along[..., None] * self.direction) / math.sin(self.radius_rad)
        square = (across**2).sum(axis=-1)
        inside = (square < 1.0) & (along > 0.0)
        normal = across - np.sqrt(np.maximum(1.0 - square, 0.0))[..., None] * self.direction
        cosine = np.maximum(normal @ self.sun_direction, 0.0)
        # Of a Lambert sphere, the integral of the cosine over the unit disc.
        whole = 2.0 / 3.0 * math.pi * max(lambert_phase(self.phase_rad), _LEAST_LIT)
        return np.where(inside, cosine, 0.0) * self.irradiance / (
            whole * math.sin(self.radius_rad)**2)


def earth_disc(sun: SunConfig) -> EarthDisc | None:
    """Return the Earth at the date of a sun that `sun_of_date` or `SunPath` returned.

    None without a date, or if all of it is more than a degree below the
    horizontal: a rover on a hill sees so far down.
    """
    site = given_site(sun.site)
    if not sun.date or site is None:
        return None
    seen = sky(site, np.asarray(parse_date('sun.date', sun.date)))
    radius = math.radians(float(seen.earth.radius_deg))
    if seen.earth.elevation_deg < -1.0 - math.degrees(radius):
        return None
    towards = seen.earth.direction
    from_earth = (seen.sun.direction * float(seen.sun.distance_km)
                  - towards * float(seen.earth.distance_km))
    from_earth /= np.linalg.norm(from_earth)
    disc = EarthDisc(towards, from_earth, radius, 0.0)
    irradiance = (sun.irradiance * _GEOMETRIC_ALBEDO * math.sin(radius)**2
                  * phase_function(disc.phase_rad))
    return dataclasses.replace(disc, irradiance=irradiance)


def phase_function(phase_rad: float) -> float:
    """Return the light of the Earth at a phase angle, over that of the full one."""
    a = math.degrees(phase_rad)
    return 10.0**(-0.4 * (-1.060e-3 * a + 2.054e-4 * a**2))


def lambert_phase(phase_rad: float) -> float:
    """Return the same of a Lambert sphere."""
    return (math.sin(phase_rad) + (math.pi - phase_rad) * math.cos(phase_rad)) / math.pi
