"""The orientation of the Moon: the rotation series of the IAU working group WGCCRE.

Archinal et al. (2011), Report of the IAU Working Group on Cartographic Coordinates and Rotational
Elements: 2009, Celestial Mechanics and Dynamical Astronomy 109, 101-135, table 2. Its axes are the
mean Earth/polar axis ones, in which maps of the Moon are made. The series is good to a few
thousandths of a degree: with `ephemeris`, the places below sun and Earth are within 0.0063 deg of
those from JPL's DE421 (docs/measurements).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.frames import Array

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
