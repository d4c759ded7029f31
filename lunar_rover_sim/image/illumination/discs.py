"""The discs of sun and Earth as cameras on the Moon see them, and the Earth as a source of light.

The sun is darker towards its limb: I(mu) = I(1) mu^a, mu being the cosine of the angle at which
light leaves it, with a = -0.023 + 0.292 um / wavelength (Hestroffer & Magnan, 1998, Astron.
Astrophys. 333, 338; the numbers were compared with a program that cites the paper). A further
factor of their law is 1 here, which is a choice. At 0.6 um, about the middle of what a silicon
sensor makes of sunlight, a is 0.464 and the mean of the disc is 2 / (2 + a) = 0.812 of its centre;
Neckel & Labs (1994, Solar Physics 153, 91) measured 0.81 at 590 to 600 nm.

The Earth is a sphere that the sun lights from one side. Its phase function is after Mallama &
Hilton (2018, Astronomy and Computing 25, equation 5), in magnitudes -1.060e-3 a + 2.054e-4 a^2 for
a phase angle of a degrees; the coefficients were compared with programs that cite the paper. Over
the disc it is spread as on a Lambert sphere. Clouds, land and the glow of the air are left out.
Over the whole solar spectrum the Earth reflects about half of what it does in V (Glenar et al.,
2019, Icarus 321: 0.15 W/m2 at full phase, half of which is its own heat).

It lights the ground as a sun of its place, size and irradiance would. Its disc is taken as evenly
bright then, whatever its phase: half of it may really be dark, which makes penumbrae up to a
degree narrower than they are drawn.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.illumination.config import LOWEST_DEG, SunConfig
from lunar_rover_sim.image.illumination.dates import parse_date
from lunar_rover_sim.image.illumination.sky import sky
from lunar_rover_sim.image.illumination.sun_of_date import given_site

LIMB_EXPONENT = 0.464
MEAN_OVER_CENTRE = 2.0 / (2.0 + LIMB_EXPONENT)


def central_radiance(sun: SunConfig) -> float:
    """Return the radiance of the middle of the disc [W m-2 sr-1].

    The disc as a whole has the normal irradiance of the sun.
    """
    radius = math.radians(0.5 * sun.angular_diameter_deg)
    return sun.irradiance / (math.pi * math.sin(radius)**2 * MEAN_OVER_CENTRE)


def limb_darkening(distance: ArrayLike) -> Array:
    """Return radiance over that of the middle; 0 beyond the limb.

    Args:
        distance: From the middle of the disc, over its radius.
    """
    square = np.asarray(distance, dtype=float)**2
    return np.where(square < 1.0, np.maximum(1.0 - square, 0.0)**(0.5 * LIMB_EXPONENT), 0.0)


def disc_radiance(rays: ArrayLike, direction: ArrayLike, sun: SunConfig) -> Array:
    """Return the radiance (...,) that comes along (..., 3) rays of any length [W m-2 sr-1].

    Args:
        direction: (3,) unit vector to the sun in the same axes.
    """
    rays = np.asarray(rays, dtype=float)
    across = np.cross(rays, np.asarray(direction, dtype=float))
    sine = np.linalg.norm(across, axis=-1) / np.linalg.norm(rays, axis=-1)
    radius = math.sin(math.radians(0.5 * sun.angular_diameter_deg))
    ahead = rays @ np.asarray(direction, dtype=float) > 0.0
    return np.where(ahead, central_radiance(sun) * limb_darkening(sine / radius), 0.0)


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
