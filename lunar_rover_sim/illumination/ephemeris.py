"""Sun and Earth as seen from the Moon at a date.

The positions are ERFA's series: `epv00` for Earth and sun (VSOP2000, fitted to DE405, 1900 to
2100) and `moon98` for the Moon (Meeus 1998, from ELP2000-82). Light time and aberration are
included, so directions are apparent ones, as in the tables of JPL's Horizons. There is no
refraction: the Moon has no air.
"""

from __future__ import annotations

import dataclasses
import warnings

import erfa
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.illumination.dates import check_dates
from lunar_rover_sim.illumination.moon_rotation import rotation_moon_icrf

Dates = NDArray[np.datetime64]

MOON_RADIUS_KM = 1737.4     # of the sphere of longitude and latitude (Archinal et al. 2011)
EARTH_RADIUS_KM = 6378.137  # at the equator (WGS 84)
SUN_RADIUS_KM = 695700.0    # nominal (IAU 2015, resolution B3)
AU_KM = 149597870.7         # IAU 2012, resolution B2
_J2000 = np.datetime64('2000-01-01T12:00:00', 'us')
_J2000_JD = 2451545.0
_LIGHT_AU_PER_DAY = 173.1446326846693


@dataclasses.dataclass(frozen=True)
class SunAndEarth:
    """Apparent positions, in axes fixed to the Moon (x: longitude 0, latitude 0; z: north).

    Attributes:
        sun_km: (..., 3) position of the sun, from the centre of the Moon.
        earth_km: (..., 3) position of the Earth, from the centre of the Moon.
    """

    sun_km: Array
    earth_km: Array


def sun_and_earth(dates_utc: Dates) -> SunAndEarth:
    """Return where sun and Earth are at (...) dates; raise ConfigError outside 1972 to 2100."""
    dates = check_dates('date', np.asarray(dates_utc, 'datetime64[us]'))
    days = _terrestrial_days(dates)
    # TDB differs from TT by 2 ms at most: 2 m of the Moon's way.
    heliocentric, barycentric = erfa.epv00(_J2000_JD, days)
    moon = erfa.moon98(_J2000_JD, days)
    moon_velocity = barycentric['v'] + moon['v']
    sun_from_earth = -heliocentric['p']
    sun_velocity = barycentric['v'] - heliocentric['v']
    rotation = rotation_moon_icrf(days)
    sun = _apparent(sun_from_earth - moon['p'], sun_velocity, moon_velocity)
    earth = _apparent(-moon['p'], barycentric['v'], moon_velocity)
    return SunAndEarth(*(np.einsum('...ij,...j->...i', rotation, vector) * AU_KM
                         for vector in (sun, earth)))


def _terrestrial_days(dates: Dates) -> Array:
    """Return the days since J2000.0 in terrestrial time."""
    days = (dates - _J2000) / np.timedelta64(1, 'D')
    with warnings.catch_warnings():
        # Leap seconds to come are unknown. One of them turns the sky by 0.00015 deg.
        warnings.filterwarnings('ignore', 'ERFA function "utctai"', erfa.ErfaWarning)
        first, second = erfa.utctai(_J2000_JD, days)
    first, second = erfa.taitt(first, second)
    return (first - _J2000_JD) + second


def _apparent(position: Array, body_velocity: Array, observer_velocity: Array) -> Array:
    """Return (..., 3) positions [au] as an observer sees them: light time, then aberration.

    Both are of first order in v/c: what is left out is 1e-8 rad.

    Args:
        position: Now, from the observer [au].
        body_velocity: Barycentric [au/d].
        observer_velocity: Barycentric [au/d].
    """
    distance = np.linalg.norm(position, axis=-1, keepdims=True)
    delayed = position - body_velocity * (distance / _LIGHT_AU_PER_DAY)
    length = np.linalg.norm(delayed, axis=-1, keepdims=True)
    direction = delayed / length + observer_velocity / _LIGHT_AU_PER_DAY
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True) * length
