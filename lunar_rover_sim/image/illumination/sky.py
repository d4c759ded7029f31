"""Directions to sun and Earth at a site and a date, as a rover there sees them.

The positions are ERFA's series: `epv00` for Earth and sun (VSOP2000, fitted to DE405, 1900 to
2100) and `moon98` for the Moon (Meeus 1998, from ELP2000-82). Light time and aberration are
included, so directions are apparent ones, as in the tables of JPL's Horizons. There is no
refraction: the Moon has no air.

The orientation of the Moon is the rotation series of the IAU working group WGCCRE: Archinal et al.
(2011), Report of the IAU Working Group on Cartographic Coordinates and Rotational Elements: 2009,
Celestial Mechanics and Dynamical Astronomy 109, 101-135, table 2. Its axes are the mean
Earth/polar axis ones, in which maps of the Moon are made. The series is good to a few thousandths
of a degree: the places below sun and Earth are within 0.0063 deg of those from JPL's DE421
(docs/measurements).
"""

from __future__ import annotations

import dataclasses
import warnings

import erfa
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.frames import Array, sun_direction
from lunar_rover_sim.ground.world.moon_place import MoonPlace, unit_vector
from lunar_rover_sim.image.illumination.dates import check_dates

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


# E1 to E13: value at J2000.0 [deg] and rate [deg/d]; then what each adds to right ascension (sine)
# and declination (cosine) of the pole and to the prime meridian (sine) [deg].
_SERIES = np.array([
    (125.045, -0.0529921, -3.8787, 1.5419, 3.5610),
    (250.089, -0.1059842, -0.1204, 0.0239, 0.1208),
    (260.008, 13.0120009, 0.0700, -0.0278, -0.0642),
    (176.625, 13.3407154, -0.0172, 0.0068, 0.0158),
    (357.529, 0.9856003, 0.0, 0.0, 0.0252),
    (311.589, 26.4057084, 0.0072, -0.0029, -0.0066),
    (134.963, 13.0649930, 0.0, 0.0009, -0.0047),
    (276.617, 0.3287146, 0.0, 0.0, -0.0046),
    (34.226, 1.7484877, 0.0, 0.0, 0.0028),
    (15.134, -0.1589763, -0.0052, 0.0008, 0.0052),
    (119.743, 0.0036096, 0.0, 0.0, 0.0040),
    (239.961, 0.1643573, 0.0, 0.0, 0.0019),
    (25.053, 12.9590088, 0.0043, -0.0009, -0.0044)])
_DAYS_PER_CENTURY = 36525.0


def rotation_moon_icrf(days_tdb: ArrayLike) -> Array:
    """Return the (..., 3, 3) rotation from the axes of the ICRF to those of the Moon.

    The Moon's x points to longitude 0 and latitude 0, its z to the north pole.

    Args:
        days_tdb: (...) days since J2000.0, barycentric dynamical time.
    """
    days = np.asarray(days_tdb, float)
    angle = np.radians(_SERIES[:, 0] + _SERIES[:, 1] * days[..., None])
    centuries = days / _DAYS_PER_CENTURY
    ascension = 269.9949 + 0.0031 * centuries + np.sin(angle) @ _SERIES[:, 2]
    declination = 66.5392 + 0.0130 * centuries + np.cos(angle) @ _SERIES[:, 3]
    meridian = (38.3213 + 13.17635815 * days - 1.4e-12 * days**2
                + np.sin(angle) @ _SERIES[:, 4])
    # Ibid., section 2: R = Rz(W) Rx(90 - delta) Rz(90 + alpha).
    first, second = np.radians(90.0 + ascension), np.radians(90.0 - declination)
    return _about_z(np.radians(meridian)) @ _about_x(second) @ _about_z(first)


def _about_z(angle: Array) -> Array:
    """Return the turn of the axes, not of vectors, about z."""
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return _matrix((c, s, zero), (-s, c, zero), (zero, zero, one))


def _about_x(angle: Array) -> Array:
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return _matrix((one, zero, zero), (zero, c, s), (zero, -s, c))


def _matrix(*rows: tuple[Array, ...]) -> Array:
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@dataclasses.dataclass(frozen=True)
class Body:
    """A body in the sky; each field is (...), as the dates are.

    Attributes:
        azimuth_deg: From x towards y of the world, as `sun.azimuth_deg`, 0 to 360.
        true_azimuth_deg: From true north towards east, 0 to 360.
        elevation_deg: Of the centre above the horizontal of the sphere.
        distance_km: From the site.
        radius_deg: Apparent radius of the disc.
    """

    azimuth_deg: Array
    true_azimuth_deg: Array
    elevation_deg: Array
    distance_km: Array
    radius_deg: Array

    @property
    def direction(self) -> Array:
        """The (3,) unit vector to it, world axes; of one date."""
        return sun_direction(float(self.azimuth_deg), float(self.elevation_deg))


@dataclasses.dataclass(frozen=True)
class Sky:
    """Sun and Earth."""

    sun: Body
    earth: Body


def sky(site: MoonPlace, dates_utc: Dates) -> Sky:
    """Return the sky over a site at (...) dates; raise ConfigError outside 1972 to 2100.

    The site is on the sphere of 1737.4 km. A kilometre above it moves the Earth by 0.0002 deg.
    """
    positions = sun_and_earth(dates_utc)
    return Sky(_seen(site, positions.sun_km, SUN_RADIUS_KM),
               _seen(site, positions.earth_km, EARTH_RADIUS_KM))


def lit_share(sun: Body, horizon_deg: Array | float) -> Array:
    """Return the share of the sun's disc, 0 to 1, above a horizon that is level across it.

    Args:
        horizon_deg: Elevation of the horizon below the sun.
    """
    height = np.clip((sun.elevation_deg - horizon_deg) / sun.radius_deg, -1.0, 1.0)
    return 1.0 - (np.arccos(height) - height * np.sqrt(1.0 - height**2)) / np.pi


def _seen(site: MoonPlace, position_km: Array, radius_km: float) -> Body:
    from_site = position_km - MOON_RADIUS_KM * unit_vector(site.lon_deg, site.lat_deg)
    east, north, up = np.moveaxis(from_site @ site.rotation_enu_moon().T, -1, 0)
    distance = np.linalg.norm(from_site, axis=-1)
    true_azimuth = np.mod(np.degrees(np.arctan2(east, north)), 360.0)
    return Body(site.azimuth_deg(true_azimuth), true_azimuth,
                np.degrees(np.arcsin(up / distance)), distance,
                np.degrees(np.arcsin(radius_km / distance)))
