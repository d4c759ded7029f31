"""The curvature of the Moon: ground falls away with the distance.

The world frame is the tangent plane at the origin. A sphere of radius R lies r^2 / 2R below it at
the distance r (within 5 mm at 20 km): 0.74 m at 1.6 km, 0.46 mrad for an eye at the origin. The
ground that the rover walks on stays level, since the drop at its corners is 0.4 mm. From the
circle around them on it is (r^2 - r0^2) / 2R, without a step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.world.levels import axis_m

MOON_RADIUS_M = 1_737_400.0     # of the reference sphere of LOLA (Smith et al., 2010)
_STRIP = 64                     # rows bent at once


def drop_m(square_m2: ArrayLike, level_radius_m: float) -> NDArray[np.float64]:
    """Return how far the sphere lies below the plane, for squares of distances [m^2].

    Args:
        level_radius_m: Ground nearer than that to the origin is level.
    """
    beyond = np.maximum(np.asarray(square_m2, np.float64) - level_radius_m * level_radius_m, 0.0)
    return beyond / (2.0 * MOON_RADIUS_M)


def bend(heights: NDArray[np.float32], cell_m: float, level_radius_m: float) -> None:
    """Subtract the drop from (n, n) heights over the plane; in place.

    It consists of sums, products and quotients alone, which all machines round alike. So it needs
    no lattice, on which a plain would have terraces.
    """
    square = axis_m(len(heights), cell_m)
    square *= square
    for start in range(0, len(heights), _STRIP):
        rows = slice(start, start + _STRIP)
        heights[rows] -= drop_m(square[rows, None] + square, level_radius_m).astype(np.float32)
