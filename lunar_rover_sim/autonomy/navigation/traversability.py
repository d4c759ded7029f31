"""Ground that a rover can cross: step height, slope and roughness against its description."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.autonomy.navigation.config import TraversabilityConfig
from lunar_rover_sim.autonomy.navigation.elevation_map import Elevation
from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.rover.description import RoverDescription

LETHAL, UNKNOWN = 100, -1       # as in nav_msgs/OccupancyGrid

_SPOKE_SHARE = 0.6          # of a spoke that a leg climbs
_ROUGH_SHARE = 0.4          # of the greatest step that a plane under the rover may vary by
_LENGTHS = 1.5              # of the chassis: the plane on which the rover stands
_LEAST_SHARE = 0.4          # of that plane's cells that must be known
_HIDDEN_M = 0.6             # of unknown ground behind what is too steep, that counts as it
_EXPONENT = 2               # cost grows with the square: ground far below the limits is free


@dataclasses.dataclass(frozen=True)
class Limits:
    """What a rover can cross, and how much room it needs.

    Attributes:
        step_m: Greatest height over the ground around.
        slope: Greatest slope, as a tangent.
        roughness_m: Greatest RMS of heights about the plane on which it stands.
        window_m: Side of that plane.
        radius_m: Of the circle around its body and its spokes: it turns on the spot.
    """

    step_m: float
    slope: float
    roughness_m: float
    window_m: float
    radius_m: float

    @classmethod
    def of(cls, rover: RoverDescription, config: TraversabilityConfig) -> Limits:
        """Return the limits of a rover where a configuration leaves them to it."""
        legs, chassis = rover.legs, rover.chassis
        step = config.max_step_m or min(belly_clearance_m(rover),
                                        _SPOKE_SHARE * legs.spoke_length_m)
        reach = legs.spoke_length_m + legs.tip_radius_m
        radius = max(math.hypot(abs(leg.position_m[0]) + reach,
                                abs(leg.position_m[1]) + legs.tip_radius_m)
                     for leg in legs.each.values())
        return cls(step, math.tan(math.radians(config.max_slope_deg)),
                   _ROUGH_SHARE * step, _LENGTHS * chassis.length_m,
                   max(radius, 0.5 * math.hypot(chassis.length_m, chassis.width_m)))


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


def traversability(elevation: Elevation, limits: Limits, fill_cells: int = 3,
                   eye_m: ArrayLike | None = None) -> Traversability:
    """Return the cost of each cell of a map.

    The cost is 99 times the square of what comes nearest to its limit: the step (the height over
    the plane of the surroundings, or the relief from cell to cell beyond the slope), the slope and
    the roughness of that plane, which never forbids a cell by itself. Heights count less what
    their errors may make of them. Unknown ground that lies right behind what is too steep, seen
    from the rover at eye_m (2,), is as steep: the far side of a rock of which only the near one
    is seen.
    """
    grid = np.full(elevation.height_m.shape, UNKNOWN, np.int8)
    cell = elevation.cell_m
    part = _known_part(elevation, fill_cells)
    if part[0].stop > part[0].start:
        heights, error = elevation.height_m[part], np.sqrt(elevation.variance_m2[part])
        # Between what is known; beyond the edge of it nothing is.
        square = np.ones((2 * fill_cells + 1,) * 2, np.uint8)
        within = cv2.erode(cv2.dilate(np.isfinite(heights).astype(np.uint8), square), square,
                           borderType=cv2.BORDER_CONSTANT, borderValue=0)
        for _ in range(fill_cells):
            heights, error = _filled(heights, error, within)
        half = max(1, round(0.5 * limits.window_m / cell))
        _write_costs(heights, error, cell, half, limits.step_m, limits.slope, limits.roughness_m,
                     grid[part])
        if eye_m is not None:
            eye = (np.asarray(eye_m, float)[:2] - elevation.origin_m) / cell - 0.5
            grid = _with_hidden(grid, float(eye[1]), float(eye[0]), _HIDDEN_M / cell)
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


@compiled
def _with_hidden(grid, eye_row, eye_column, reach):
    """Return costs where unknown cells behind lethal ones are lethal, up to a reach in cells."""
    found = grid.copy()
    rows, columns = grid.shape
    for r in range(rows):
        for c in range(columns):
            if grid[r, c] != UNKNOWN:
                continue
            distance = math.hypot(r - eye_row, c - eye_column)
            for k in range(1, int(min(reach, distance)) + 1):
                i = int(round(r + k * (eye_row - r) / distance))
                j = int(round(c + k * (eye_column - c) / distance))
                if not (0 <= i < rows and 0 <= j < columns):
                    break
                if grid[i, j] != UNKNOWN:
                    if grid[i, j] == LETHAL:
                        found[r, c] = LETHAL
                    break
    return found


@compiled
def _filled(heights, error, within):
    """Return heights whose holes within a mask have means of known neighbours, and errors."""
    filled, errors = heights.copy(), error.copy()
    rows, columns = heights.shape
    for r in range(rows):
        for c in range(columns):
            if not within[r, c] or math.isfinite(heights[r, c]):
                continue
            count, height, wrong = 0, 0.0, 0.0
            for i in range(max(r - 1, 0), min(r + 2, rows)):
                for j in range(max(c - 1, 0), min(c + 2, columns)):
                    if math.isfinite(heights[i, j]):
                        count += 1
                        height += heights[i, j]
                        wrong += error[i, j]
            if count >= 3:      # at a straight edge
                filled[r, c], errors[r, c] = height / count, wrong / count
    return filled, errors


@compiled
def _add_row(sums, heights, row, sign):
    """Add a row of cells to the sums of columns, or take it out: 1, y, z, y^2, y z, z^2."""
    for c in range(heights.shape[1]):
        z = float(heights[row, c])
        if math.isfinite(z):
            sums[c, 0] += sign
            sums[c, 1] += sign * row
            sums[c, 2] += sign * z
            sums[c, 3] += sign * row * row
            sums[c, 4] += sign * row * z
            sums[c, 5] += sign * z * z


@compiled
def _write_costs(heights, error, cell_m, half, step_m, slope_limit, roughness_m, grid):
    """Fit a plane to the known cells of the square around each cell; write what it costs.

    Args:
        half: The square has 2 half + 1 cells a side, whose sums move along with it.
        grid: (rows, columns) int8 to write to.
    """
    rows, columns = heights.shape
    side = 2 * half + 1
    of_column = np.zeros((columns, 6))
    for r in range(min(half, rows)):
        _add_row(of_column, heights, r, 1.0)
    for r in range(rows):
        if r + half < rows:
            _add_row(of_column, heights, r + half, 1.0)
        if r > half:
            _add_row(of_column, heights, r - half - 1, -1.0)
        n = sx = sy = sz = sxx = syy = szz = sxy = sxz = syz = 0.0
        for entering in range(columns + half):
            for x, sign in ((entering, 1.0), (entering - side, -1.0)):
                if 0 <= x < columns:
                    n += sign * of_column[x, 0]
                    sx += sign * x * of_column[x, 0]
                    sy += sign * of_column[x, 1]
                    sz += sign * of_column[x, 2]
                    sxx += sign * x * x * of_column[x, 0]
                    syy += sign * of_column[x, 3]
                    szz += sign * of_column[x, 5]
                    sxy += sign * x * of_column[x, 1]
                    sxz += sign * x * of_column[x, 2]
                    syz += sign * of_column[x, 4]
            c = entering - half
            if c < 0 or not math.isfinite(heights[r, c]):
                continue
            mx, my, mz = sx / n, sy / n, sz / n
            xx, yy, zz = sxx / n - mx * mx, syy / n - my * my, max(szz / n - mz * mz, 0.0)
            xy, xz, yz = sxy / n - mx * my, sxz / n - mx * mz, syz / n - my * mz
            # Known cells that lie on a line give no plane: it stays level across the line.
            ridge = 1e-6 / cell_m ** 2 + 0.01 * (xx + yy)
            determinant = (xx + ridge) * (yy + ridge) - xy * xy
            a = (xz * (yy + ridge) - yz * xy) / determinant
            b = (yz * (xx + ridge) - xz * xy) / determinant
            left = zz - 2.0 * (a * xz + b * yz) + a * a * xx + 2.0 * a * b * xy + b * b * yy
            slope = math.hypot(a, b) / cell_m
            low = high = heights[r, c]
            for i in range(max(r - 1, 0), min(r + 2, rows)):
                for j in range(max(c - 1, 0), min(c + 2, columns)):
                    if math.isfinite(heights[i, j]):
                        low, high = min(low, heights[i, j]), max(high, heights[i, j])
            above = abs(heights[r, c] - mz - a * (c - mx) - b * (r - my))
            step = max(above - error[r, c],
                       high - low - slope * 2.0 * cell_m - 1.5 * error[r, c]) / step_m
            # Roughness is of a whole plane: it alone would make each rock as wide as that.
            rough = min(math.sqrt(max(left, 0.0)) / roughness_m, 0.95)
            worst = max(step, slope / slope_limit, rough)
            # A step is seen in less than a whole plane.
            if step >= 1.0:
                grid[r, c] = LETHAL
            elif n >= max(6.0, _LEAST_SHARE * side * side):
                grid[r, c] = LETHAL if worst >= 1.0 else int(99.0 * worst ** _EXPONENT)
