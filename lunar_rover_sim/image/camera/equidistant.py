"""The equidistant fisheye with four coefficients, as ROS's and OpenCV's `equidistant` define it.

A ray at an angle theta to the optical axis is imaged at the distance
rho(theta) = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)
from the principal point, over the focal length (Kannala & Brandt, 2006, IEEE Trans. Pattern Anal.
Mach. Intell. 28, 1335, eq. 6).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.frames import Array

_TURNS = 12


def radius(angle_rad: ArrayLike, k: ArrayLike) -> Array:
    """Return rho of angles [rad]; k: (4,) coefficients."""
    theta = np.asarray(angle_rad, dtype=float)
    k1, k2, k3, k4 = np.asarray(k, dtype=float)
    t = theta * theta
    return theta * (1.0 + t * (k1 + t * (k2 + t * (k3 + t * k4))))


def radius_slope(angle_rad: ArrayLike, k: ArrayLike) -> Array:
    """Return the derivative of rho at angles [rad]; k: (4,) coefficients."""
    t = np.asarray(angle_rad, dtype=float)**2
    k1, k2, k3, k4 = np.asarray(k, dtype=float)
    return 1.0 + t * (3.0 * k1 + t * (5.0 * k2 + t * (7.0 * k3 + t * 9.0 * k4)))


def angle(rho: ArrayLike, k: ArrayLike, most_rad: float) -> Array:
    """Return the angles [rad] that `radius` maps to `rho`, at most `most_rad`.

    rho must grow with the angle up to there. Newton's method, kept within the bounds.
    """
    target = np.asarray(rho, dtype=float)
    theta = np.clip(target, 0.0, most_rad)
    for _ in range(_TURNS):
        step = (target - radius(theta, k)) / np.maximum(radius_slope(theta, k), 0.05)
        theta = np.clip(theta + step, 0.0, most_rad)
    return theta


def grows(k: ArrayLike, most_rad: float) -> bool:
    """Return whether rho grows with the angle, by a twentieth at least, up to `most_rad`."""
    return bool(np.all(radius_slope(np.linspace(0.0, most_rad, 400), k) > 0.05))
