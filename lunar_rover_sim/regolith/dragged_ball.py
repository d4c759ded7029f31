"""The way of a ball that is dragged through soil: how steeply it digs itself in, or climbs.

A tip that is dragged meets the soil with its leading half only, and bears less than one that is
pressed straight down: at equal load it sinks while it slips. Resistive force theory (Li, Zhang and
Goldman, Science 339, 2013) is integrated over the ball, in upright slices along the motion, and
inverted: the direction in which a ball moves that bears a given part of its bearing.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.regolith.resistive_force import ResistiveForce

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
        rows.append(np.tan(np.interp(loads, lift, gamma)))
    return np.array(rows)
