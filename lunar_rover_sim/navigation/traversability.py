"""What of a map a rover can cross: step height, slope and roughness against its description."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.navigation.config import TraversabilityConfig
from lunar_rover_sim.navigation.elevation_map import Elevation
from lunar_rover_sim.rover.description import RoverDescription

LETHAL, UNKNOWN = 100, -1       # as in nav_msgs/OccupancyGrid

_SPOKE_SHARE = 0.6          # of a spoke that a leg climbs
_ROUGH_SHARE = 0.4          # of the greatest step that a plane under the rover may vary by
_LENGTHS = 1.5              # of the chassis: the plane on which the rover stands
_LEAST_SHARE = 0.4          # of that plane's cells that must be known
_EXPONENT = 2.0             # cost grows with the square: ground far below the limits is free


@dataclasses.dataclass(frozen=True)
class Limits:
    """What a rover can cross, and how much room it needs.

    Attributes:
        step_m: Greatest height over the ground around.
        slope: Greatest slope, as a tangent.
        roughness_m: Greatest RMS of heights about the plane on which it stands.
        window_m: Side of that plane.
        half_width_m: From its middle to the outside of its legs.
    """

    step_m: float
    slope: float
    roughness_m: float
    window_m: float
    half_width_m: float

    @classmethod
    def of(cls, rover: RoverDescription, config: TraversabilityConfig) -> Limits:
        """Return the limits of a rover where a configuration leaves them to it."""
        legs, chassis = rover.legs, rover.chassis
        step = config.max_step_m or min(belly_clearance_m(rover),
                                        _SPOKE_SHARE * legs.spoke_length_m)
        wide = max(abs(leg.position_m[1]) for leg in legs.each.values()) + legs.tip_radius_m
        return cls(step, math.tan(math.radians(config.max_slope_deg)),
                   config.max_roughness_m or _ROUGH_SHARE * step,
                   config.window_m or _LENGTHS * chassis.length_m,
                   max(wide, 0.5 * chassis.width_m))


def belly_clearance_m(rover: RoverDescription) -> float:
    """Return the least height of the chassis over level ground while the rover walks [m].

    Each of two groups of legs stands while its spokes sweep half the angle between two spokes, so
    an axle is never lower than a spoke that leans by a quarter of that angle.
    """
    legs = rover.legs
    axle = legs.spoke_length_m * math.cos(0.25 * legs.spoke_pitch_rad)
    return axle - legs.lowest_axle_m - 0.5 * rover.chassis.height_m


@dataclasses.dataclass(frozen=True)
class Traversability:
    """A grid of costs: 0 free to 99, 100 not to be crossed, -1 unknown.

    Attributes:
        stamp_ns: Of the map [ns].
        origin_m: (2,) corner with the least x and y.
        cell_m: Side of a cell.
        cost: (n, n) int8, row 0 south.
    """

    stamp_ns: int
    origin_m: Array
    cell_m: float
    cost: NDArray[np.int8]


def traversability(elevation: Elevation, limits: Limits, fill_cells: int = 2) -> Traversability:
    """Return the cost of each cell of a map.

    The cost is 99 times the square of what comes nearest to its limit: the step (the height over
    the plane of the surroundings, or the relief from cell to cell beyond the slope), the slope and
    the roughness of that plane, which never forbids a cell by itself. Heights count less what
    their errors may make of them.
    """
    grid = np.full(elevation.height_m.shape, UNKNOWN, np.int8)
    cell = elevation.cell_m
    rows, columns = _known_part(elevation, fill_cells)
    if rows.stop > rows.start:
        part = dataclasses.replace(elevation, height_m=elevation.height_m[rows, columns],
                                   variance_m2=elevation.variance_m2[rows, columns])
        grid[rows, columns] = _costs(part, limits, fill_cells)
    return Traversability(elevation.stamp_ns, elevation.origin_m, cell, grid)


def _known_part(elevation: Elevation, margin: int) -> tuple[slice, slice]:
    """Return the rows and columns around what is known: in the beginning that is little."""
    known = np.isfinite(elevation.height_m)
    parts = []
    for axis in (1, 0):
        found = np.flatnonzero(known.any(axis=axis))
        parts.append(slice(max(int(found[0]) - margin, 0), int(found[-1]) + 1 + margin)
                     if len(found) else slice(0, 0))
    return parts[0], parts[1]


def _costs(elevation: Elevation, limits: Limits, fill_cells: int) -> NDArray[np.int8]:
    heights, error = _filled(elevation, fill_cells)
    known = np.isfinite(heights)
    cell = elevation.cell_m
    size = 2 * max(1, round(0.5 * limits.window_m / cell)) + 1
    plane, slope, roughness, enough = _planes(heights, known, cell, size)
    above = np.where(known, np.abs(heights - plane), 0.0)
    relief = _relief(heights, known) - slope * 2.0 * cell
    step = np.maximum(above - error, relief - 1.5 * error)
    # Roughness is of a whole plane: it alone would make each rock as wide as that.
    worst = np.maximum.reduce([step / limits.step_m, slope / limits.slope,
                               np.minimum(roughness / limits.roughness_m, 0.95)])
    cost = np.where(worst >= 1.0, float(LETHAL), 99.0 * np.clip(worst, 0.0, 1.0) ** _EXPONENT)
    grid = np.where(known & enough, cost, float(UNKNOWN)).astype(np.int8)
    # A step is seen in less than a whole plane.
    grid[known & (step >= limits.step_m)] = LETHAL
    return grid


def _filled(elevation: Elevation, rounds: int) -> tuple[Array, Array]:
    """Return heights whose small holes are filled from the known cells around, and errors."""
    heights = elevation.height_m.astype(np.float64)
    error = np.sqrt(elevation.variance_m2.astype(np.float64))
    for _ in range(rounds):
        known = np.isfinite(heights)
        count = cv2.boxFilter(known.astype(np.float64), -1, (3, 3), normalize=False,
                              borderType=cv2.BORDER_CONSTANT)
        fill = ~known & (count >= 4.0)
        for array in (heights, error):
            total = cv2.boxFilter(np.where(known, array, 0.0), -1, (3, 3), normalize=False,
                                  borderType=cv2.BORDER_CONSTANT)
            array[fill] = total[fill] / count[fill]
    return heights, np.where(np.isfinite(error), error, 0.0)


def _planes(heights: Array, known: NDArray[np.bool_], cell_m: float,
            size: int) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Fit a plane to the known cells of the square around each cell.

    Returns:
        Its height in the middle, its slope, the RMS of heights about it, and whether enough of the
        square is known.
    """
    x, y = np.meshgrid(*(np.arange(n) * cell_m for n in reversed(heights.shape)))
    base = float(np.mean(heights[known])) if known.any() else 0.0
    z = np.where(known, heights - base, 0.0)
    one = known.astype(np.float64)

    def total(values: Array) -> Array:
        return np.asarray(cv2.boxFilter(values, -1, (size, size), normalize=False,
                                        borderType=cv2.BORDER_CONSTANT), float)

    count = total(one)
    enough = count >= max(6.0, _LEAST_SHARE * size * size)
    divisor = np.maximum(count, 1.0)
    mx, my, mz = total(one * x) / divisor, total(one * y) / divisor, total(z) / divisor
    xx = np.maximum(total(one * x * x) / divisor - mx * mx, 0.0)
    yy = np.maximum(total(one * y * y) / divisor - my * my, 0.0)
    xy = total(one * x * y) / divisor - mx * my
    xz = total(x * z) / divisor - mx * mz
    yz = total(y * z) / divisor - my * mz
    zz = np.maximum(total(z * z) / divisor - mz * mz, 0.0)
    # Known cells that lie on a line give no plane: it stays level across the line.
    ridge = 1e-6 + 0.01 * (xx + yy)
    determinant = (xx + ridge) * (yy + ridge) - xy * xy
    a = (xz * (yy + ridge) - yz * xy) / determinant
    b = (yz * (xx + ridge) - xz * xy) / determinant
    plane = base + mz + a * (x - mx) + b * (y - my)
    left = zz - 2.0 * (a * xz + b * yz) + a * a * xx + 2.0 * a * b * xy + b * b * yy
    return plane, np.hypot(a, b), np.sqrt(np.maximum(left, 0.0)), enough


def _relief(heights: Array, known: NDArray[np.bool_]) -> Array:
    """Return highest minus lowest known cell of the 3 x 3 around each known cell, else 0."""
    square = np.ones((3, 3), np.uint8)
    high = cv2.dilate(np.where(known, heights, -1e9), square)
    low = cv2.erode(np.where(known, heights, 1e9), square)
    return np.where(known, high - low, 0.0)
