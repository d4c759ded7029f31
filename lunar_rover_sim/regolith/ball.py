"""The round tip of a spoke in soil: how much it bears at a depth, and how it ploughs and digs.

Pressed straight down to a depth z, a ball of radius R displaces its cap. With each facet counted
by its projection on the ground, and zeta the force per area and depth of a flat plate,

    F(z) = zeta pi (R z^2 - z^3 / 3)   up to z = R,   zeta pi R^2 (z - R / 3)   beyond.

Above z = 2 R the rod follows, of radius r, tilted by t from the normal: it adds zeta r tan t
(z - 2 R)^2. Sideways the same is pushed as its silhouette, an upright plate: with the ratio a of
its force to that of a flat one, and S(z) the first moment of the silhouette about the surface,
H(z) = zeta a S(z).

A tip that is dragged meets the soil with its leading half only, and bears less: at equal load it
sinks while it slips. `DigTable` integrates resistive force theory over the ball, in upright slices
along the motion, and inverts it: the direction in which a ball moves that bears a given part of
F(z).
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.regolith.resistive_force import ResistiveForce

_STEEPEST = 2.0          # a dragged tip digs down, or climbs, no steeper than this [tan]
_LOADS, _DEPTHS, _DEEPEST = 32, 8, 3.0   # cells of the table; greatest depth in radii


def bearing_n(depth_m: float, radius_m: float, zeta_npm3: float) -> float:
    """Return F(z) [N]; 0 above the surface."""
    if depth_m <= 0.0:
        return 0.0
    if depth_m <= radius_m:
        return zeta_npm3 * math.pi * depth_m * depth_m * (radius_m - depth_m / 3.0)
    return zeta_npm3 * math.pi * radius_m * radius_m * (depth_m - radius_m / 3.0)


def contact_area_m2(depth_m: float, radius_m: float) -> float:
    """Return the area of the ball's cap on the surface [m^2], that of its equator from R on."""
    depth = min(max(depth_m, 0.0), radius_m)
    return math.pi * depth * (2.0 * radius_m - depth)


def bearing_slope_npm(depth_m: float, radius_m: float, zeta_npm3: float) -> float:
    """Return dF/dz [N/m]: zeta times the contact area."""
    return zeta_npm3 * contact_area_m2(depth_m, radius_m)


def depth_m(force_n: float, radius_m: float, zeta_npm3: float) -> float:
    """Return the depth at which F(z) is a force [m]."""
    if force_n <= 0.0:
        return 0.0
    at_equator = bearing_n(radius_m, radius_m, zeta_npm3)
    if force_n >= at_equator:
        return force_n / (zeta_npm3 * math.pi * radius_m ** 2) + radius_m / 3.0
    # R z^2 - z^3 / 3 = q: the root between 0 and R of a cubic with three real ones.
    q = force_n / (zeta_npm3 * math.pi * radius_m ** 3)
    return radius_m * (1.0 + 2.0 * math.cos((math.acos(1.0 - 1.5 * q) + 4.0 * math.pi) / 3.0))


def silhouette_m3(depth_m: float, radius_m: float) -> float:
    """Return S(z) [m^3]: the depth integrated over the silhouette of the ball below ground.

    With u = 1 - z / R and the half angle t = acos(u) of the segment it is
    R^3 ((2 / 3) sin^3 t - u (t - u sin t)); below z = 2 R it is pi R^2 (z - R).
    """
    if depth_m <= 0.0:
        return 0.0
    if depth_m >= 2.0 * radius_m:
        return math.pi * radius_m ** 2 * (depth_m - radius_m)
    u = 1.0 - depth_m / radius_m
    t = math.acos(u)
    sine = math.sin(t)
    return radius_m ** 3 * (2.0 / 3.0 * sine ** 3 - u * (t - u * sine))


def swept_bearing(shape: ResistiveForce, depth: float,
                  gamma_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lift on a ball that moves in the directions gamma, over that straight down.

    depth: in radii. Each slice of the ball along the motion is a disc whose leading facets are
    plates of resistive force theory.
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


class DigTable:
    """The slope of the path of a dragged tip: depth gained per distance slipped.

    Read it with `slope(load, depth)`: load as a part of F(z), depth in radii. Positive: it digs
    itself in; negative: it climbs. It is rate independent, and a tip that does not slip stays.
    """

    def __init__(self, shape: ResistiveForce) -> None:
        steep = math.atan(_STEEPEST)
        gamma = np.linspace(-steep, steep, 121)
        loads = np.linspace(0.0, 1.0, _LOADS + 1)
        rows = []
        for k in range(_DEPTHS + 1):
            lift = np.maximum.accumulate(
                swept_bearing(shape, max(k * _DEEPEST / _DEPTHS, 0.02), gamma))
            rows.append(np.tan(np.interp(loads, lift, gamma)).tolist())
        self._rows: list[list[float]] = rows

    def slope(self, load: float, depth: float) -> float:
        """Return depth gained per distance slipped, between -2 and 2."""
        # Conditional expressions take a third of the time of min() and max().
        x = 0.0 if load < 0.0 else load * _LOADS if load < 1.0 else _LOADS
        y = 0.0 if depth < 0.0 else (depth * (_DEPTHS / _DEEPEST) if depth < _DEEPEST
                                     else _DEPTHS)
        i = int(x) if x < _LOADS else _LOADS - 1
        k = int(y) if y < _DEPTHS else _DEPTHS - 1
        u, v = x - i, y - k
        low, high = self._rows[k], self._rows[k + 1]
        return ((low[i] * (1.0 - u) + low[i + 1] * u) * (1.0 - v)
                + (high[i] * (1.0 - u) + high[i + 1] * u) * v)


@functools.lru_cache(maxsize=8)
def dig_table(shape: ResistiveForce) -> DigTable:
    """Return the table of a shape, which is made once: that takes longer than to load a model."""
    return DigTable(shape)
