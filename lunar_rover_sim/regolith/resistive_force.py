"""Resistive force theory: what dry grains do to a small plate that is pushed through them.

A plate of area A at depth d feels the force zeta alpha(beta, gamma) d A (Li, Zhang and Goldman, A
terradynamics of legged locomotion on granular media, Science 339, 2013), with

    alpha_z = A00 + A10 cos 2b + B11 sin(2b + g) + B01 sin g + B-11 sin(-2b + g)
    alpha_x = C11 cos(2b + g) + C01 cos g + C-11 cos(-2b + g) + D10 sin 2b

b (beta) is the tilt of the plate: 0 if it faces down, > 0 if it faces forward and down, pi/2 if it
faces forward. g (gamma) is the direction of motion below the horizontal: 0 forward, pi/2 down. A
motion backward, |g| > pi/2, is the mirror image of one forward, b -> -b, g -> +-pi - g, alpha_x ->
-alpha_x, under which the series does not change. alpha_z > 0 pushes up, alpha_x > 0 backward,
against a motion forward. Only faces that lead are pushed.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclasses.dataclass(frozen=True)
class ResistiveForce:
    """The nine coefficients, in one unit of their own; only their ratios matter beside zeta."""

    a00: float
    a10: float
    b11: float
    b01: float
    b_11: float
    c11: float
    c01: float
    c_11: float
    d10: float

    def alpha(self, beta_rad: ArrayLike,
              gamma_rad: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (alpha_x, alpha_z) in the unit of the coefficients; arrays are broadcast."""
        b, g = np.broadcast_arrays(np.asarray(beta_rad, float), np.asarray(gamma_rad, float))
        alpha_z = (self.a00 + self.a10 * np.cos(2.0 * b) + self.b11 * np.sin(2.0 * b + g)
                   + self.b01 * np.sin(g) + self.b_11 * np.sin(-2.0 * b + g))
        alpha_x = (self.c11 * np.cos(2.0 * b + g) + self.c01 * np.cos(g)
                   + self.c_11 * np.cos(-2.0 * b + g) + self.d10 * np.sin(2.0 * b))
        return alpha_x, alpha_z

    @property
    def bearing(self) -> float:
        """alpha_z of a flat plate that is pressed straight down."""
        return self.a00 + self.a10 + self.b11 + self.b01 + self.b_11

    @property
    def side_ratio(self) -> float:
        """alpha_x of an upright plate that is pushed forward, over `bearing`."""
        return (-self.c11 + self.c01 - self.c_11) / self.bearing


# Li et al. 2013: the shape common to all grains that they tried, and two packings of poppy seeds
# [N/cm^3] (friction angles and fits in the supplement).
GENERIC = ResistiveForce(.206, .169, .212, .358, .055, -.124, .253, .007, .088)
POPPY_LOOSE = ResistiveForce(.051, .047, .053, .083, .020, -.026, .057, .0, .025)
POPPY_CLOSE = ResistiveForce(.094, .092, .092, .151, .035, -.039, .086, .018, .046)


def plate_force_n(shape: ResistiveForce, bearing_npm3: float, area_m2: float, depth_m: float,
                  beta_rad: float, gamma_rad: float) -> tuple[float, float]:
    """Return (F_x, F_z) [N] on a plate, x against the motion forward, z up.

    Args:
        bearing_npm3: Zeta [N/m^3], force per area and depth of a flat plate that is pressed down.
    """
    alpha_x, alpha_z = shape.alpha(beta_rad, gamma_rad)
    scale = bearing_npm3 / shape.bearing * area_m2 * depth_m
    return float(alpha_x * scale), float(alpha_z * scale)
