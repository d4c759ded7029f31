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

A tip that is dragged meets the soil with its leading half only, and bears less than one that is
pressed straight down: at equal load it sinks while it slips. The theory is integrated over a ball,
in upright slices along the motion, and inverted: the direction in which a ball moves that bears a
given part of its bearing, so how steeply it digs itself in, or climbs.
"""

from __future__ import annotations

import dataclasses
import functools
import math

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


DEEPEST = 3.0            # depth of the last row of a table, in radii
_STEEPEST = 2.0          # a dragged tip digs down, or climbs, no steeper than this [tan]
_LOADS, _DEPTHS = 32, 8  # cells of a table


def swept_bearing(shape: ResistiveForce, depth: float,
                  gamma_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lift on a ball that moves in some directions, over that straight down.

    Args:
        shape: coefficients of resistive force theory.
        depth: of the lowest point, in radii.
        gamma_rad: directions below the horizontal [rad].

    Each slice of the ball along the motion is a disc whose leading facets are plates.
    """
    y = (np.arange(40) + 0.5) / 40.0
    theta = (np.arange(180) + 0.5) / 180.0 * 2.0 * np.pi - np.pi
    radius = np.sqrt(1.0 - y ** 2)[:, None]
    down = depth - 1.0 + radius * np.cos(theta)
    weight = np.maximum(down, 0.0) * radius

    def lift(gamma: float) -> float:
        leading = np.sin(theta + gamma) > 0.0
        _, alpha_z = shape.alpha(theta, gamma)
        return float(np.sum(weight * leading * alpha_z))

    straight = lift(0.5 * np.pi)
    return np.array([lift(float(gamma)) for gamma in gamma_rad]) / straight


@functools.lru_cache(maxsize=8)
def dig_table(shape: ResistiveForce) -> NDArray[np.float64]:
    """Return depth gained per way slipped, between -2 and 2, (depths + 1, loads + 1).

    Rows: depth from 0 to `DEEPEST` radii. Columns: load from 0 to 1 of what the ball bears.
    Positive: it digs itself in; negative: it climbs. `law.dig_slope` reads it. It is made once for
    each shape: that takes longer than to load a model.
    """
    steep = math.atan(_STEEPEST)
    gamma = np.linspace(-steep, steep, 121)
    loads = np.linspace(0.0, 1.0, _LOADS + 1)
    rows = []
    for k in range(_DEPTHS + 1):
        lift = np.maximum.accumulate(
            swept_bearing(shape, max(k * DEEPEST / _DEPTHS, 0.02), gamma))
        # Not by NumPy, whose tangent rounds otherwise where there is AVX-512.
        rows.append([math.tan(angle) for angle in np.interp(loads, lift, gamma)])
    return np.array(rows)
