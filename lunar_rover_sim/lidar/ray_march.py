"""How a ray finds the ground and the rocks: plain loops, compiled by Numba.

A ray goes from block to block of a pyramid of greatest heights (`height_pyramid`). Where it stays
above a block it passes over all of it, and the next block that it looks at is a larger one; where
it does not, it looks at the smaller blocks within. In the smallest blocks it is tested against the
rocks, and cell by cell against the triangles of the ground. After Tevs, Ihrke and Seidel, "Maximum
mipmaps for fast, accurate, and scalable dynamic height field rendering", I3D 2008.

All arithmetic is in float64 and in the order in which it stands here, so that results do not
depend on the machine. Places on the grid are in cells, heights and distances along a ray in
metres. Numba keeps what it has compiled until this file changes, so no constants or functions of
other files are used here. Functions that every ray calls get no tuples of arrays: handing one
over takes as long as twenty steps.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

import numba
import numpy as np

GROUND, NOTHING = -1, -2    # targets, besides the numbers of rocks
SHIFT = 2                   # a block is 4 x 4 cells, or 4 x 4 of the next smaller blocks
_START = 2                  # level of the first block that a ray looks at
_LEAST = 1e-9               # of a component of a direction: no ray is parallel to an axis
_SLACK = 1e-9               # of distances [m] and places: neighbouring triangles leave no gap
_HALVINGS = 4               # of a step over soft ground, before it is taken as straight


def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function, and keep the result for other processes if there is a place for it."""
    options: Any = {'error_model': 'numpy'}     # a division by zero is no exception
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:    # neither this folder nor the user's cache can be written to
        return numba.njit(**options)(function)


@_compiled
def cast(level, inner_m, rocks, soft, which, origin_m, direction, range_m, distance_m, target,
         normal):
    """Look for nearer hits of rays on a level, beyond the square of half side inner_m [m].

    which: (m,) rays; origin_m, direction: (n, 3); distance_m, target, normal: nearest hits so far
    """
    z, cell, tops, first, side, rock_first, rock_list = level
    touched, n, coarsest = soft.touched, len(z) - 1, len(first) - 1
    highest = tops[first[coarsest]:].max()
    for i in which:
        x, y, oz = origin_m[i, 0], origin_m[i, 1], origin_m[i, 2]
        dx, dy, dz = _no_zero(direction[i, 0]), _no_zero(direction[i, 1]), direction[i, 2]
        t = _exit(x, y, dx, dy, inner_m) if inner_m > 0.0 else 0.0
        nearest = min(range_m, distance_m[i])
        end = min(nearest, _exit(x, y, dx, dy, 0.5 * n * cell))
        if dz > 0.0:
            end = min(end, (highest - oz) / dz)
        ox, oy, dx, dy = x / cell + 0.5 * n, y / cell + 0.5 * n, dx / cell, dy / cell
        per_x, per_y = 1.0 / dx, 1.0 / dy
        east, north = int(dx > 0.0), int(dy > 0.0)
        ix, iy = _within(ox + t * dx, 0, n), _within(oy + t * dy, 0, n)
        k, last_rock = min(_START, coarsest), -1
        while t < end:
            # Where does it leave this block?
            shift = SHIFT * (k + 1)
            size = 1 << shift
            low_x, low_y = ix & -size, iy & -size
            edge_x, edge_y = low_x + size * east, low_y + size * north
            leave_x, leave_y = (edge_x - ox) * per_x, (edge_y - oy) * per_y
            leave = min(leave_x, leave_y)
            row, column = iy >> shift, ix >> shift
            top = tops[first[k] + row * side[k] + column]
            here = oz + t * dz
            if min(here, oz + leave * dz) <= top:
                if here > top:
                    t = (top - oz) / dz
                    ix = min(_within(ox + t * dx, low_x, size), n - 1)
                    iy = min(_within(oy + t * dy, low_y, size), n - 1)
                if k > 0:
                    k -= 1
                    continue
                block = row * side[0] + column
                for j in range(rock_first[block], rock_first[block + 1]):
                    rock = rock_list[j]
                    if rock != last_rock:
                        last_rock = rock
                        met, nx, ny, nz = meet_rock(rocks, rock, x, y, oz, direction[i, 0],
                                                    direction[i, 1], dz)
                        if met < nearest:
                            nearest = distance_m[i] = met
                            target[i] = rock
                            normal[i, 0], normal[i, 1], normal[i, 2] = nx, ny, nz
                if row < len(touched) and touched[row, column]:
                    met, sx, sy = _meet_soft_ground(z, cell, soft, x, y, oz, dx * cell, dy * cell,
                                                    dz, t, min(leave, end))
                else:
                    met, sx, sy = _meet_cells(z, low_x, low_y, ix, iy, ox, oy, oz, dx, dy, dz,
                                              per_x, per_y, t)
                    sx, sy = sx / cell, sy / cell
                if met < nearest:
                    nearest = distance_m[i] = met
                    target[i] = GROUND
                    one = 1.0 / math.sqrt(sx * sx + sy * sy + 1.0)
                    normal[i, 0], normal[i, 1], normal[i, 2] = -sx * one, -sy * one, one
                end = min(end, nearest)
            # On to the next block, and to a larger one.
            t = leave
            if leave_x < leave_y:
                ix, iy = edge_x + east - 1, _within(oy + t * dy, low_y, size)
            else:
                ix, iy = _within(ox + t * dx, low_x, size), edge_y + north - 1
            if not (0 <= ix < n and 0 <= iy < n):
                break
            k = min(k + 1, coarsest)


@_compiled
def _no_zero(component):
    """Return a component of a direction that one may divide by."""
    return component if abs(component) >= _LEAST else _LEAST


@_compiled
def _exit(x, y, dx, dy, half_m):
    """Return how far a ray goes until it leaves the square of half side half_m [m]."""
    return min((math.copysign(half_m, dx) - x) / dx, (math.copysign(half_m, dy) - y) / dy)


@_compiled
def _within(place, low, size):
    """Return the cell of a place, one of `size` from `low` on whatever rounding says."""
    return min(max(int(place), low), low + size - 1)


@_compiled
def _meet_cells(z, low_x, low_y, ix, iy, ox, oy, oz, dx, dy, dz, per_x, per_y, t):
    """Go from cell to cell of a smallest block; (ix, iy): the one at t.

    Returns the distance at which the ray meets the ground, inf if it does not, and the slopes
    there [m per cell].
    """
    east, north = int(dx > 0.0), int(dy > 0.0)
    high_x = min(low_x + (1 << SHIFT), len(z) - 1)
    high_y = min(low_y + (1 << SHIFT), len(z) - 1)
    while low_x <= ix < high_x and low_y <= iy < high_y:
        leave_x = (ix + east - ox) * per_x
        leave_y = (iy + north - oy) * per_y
        leave = min(leave_x, leave_y)
        met, sx, sy = _meet_triangles(z, ix, iy, ox - ix, oy - iy, oz, dx, dy, dz, t, leave)
        if met < np.inf:
            return met, sx, sy
        t = leave
        if leave_x < leave_y:
            ix += 2 * east - 1
        else:
            iy += 2 * north - 1
    return np.inf, 0.0, 0.0


@_compiled
def _meet_triangles(z, ix, iy, u, v, oz, dx, dy, dz, enter, leave):
    """Test a ray between two distances against both triangles of a cell.

    u, v: origin from the corner of the cell. The lower triangle, u >= v, has the corner
    south-east, the upper one that north-west.
    """
    z00, z10 = float(z[iy, ix]), float(z[iy, ix + 1])
    z01, z11 = float(z[iy + 1, ix]), float(z[iy + 1, ix + 1])
    if min(oz + enter * dz, oz + leave * dz) > max(z00, z10, z01, z11):
        return np.inf, 0.0, 0.0
    across, start = dx - dy, u - v
    lower = _meet_plane(z10 - z00, z11 - z10, u, v, oz - z00, dx, dy, dz, enter, leave)
    if start + lower * across < -_SLACK:
        lower = np.inf
    upper = _meet_plane(z11 - z01, z01 - z00, u, v, oz - z00, dx, dy, dz, enter, leave)
    if start + upper * across > _SLACK:
        upper = np.inf
    if lower <= upper:
        return lower, z10 - z00, z11 - z10
    return upper, z11 - z01, z01 - z00


@_compiled
def _meet_plane(slope_x, slope_y, u, v, height, dx, dy, dz, enter, leave):
    """Return where a ray meets a plane from above between two distances, inf if it does not."""
    speed = dz - dx * slope_x - dy * slope_y
    if speed < 0.0:
        at = (u * slope_x + v * slope_y - height) / speed
        if enter - _SLACK <= at <= leave + _SLACK:
            return at
    return np.inf


@_compiled
def meet_rock(rocks, rock, x, y, z, dx, dy, dz):
    """Return where a ray enters a rock, inf if it does not or begins inside, and the normal."""
    miss = (np.inf, 0.0, 0.0, 0.0)
    ax, ay, az = (rocks.position_m[rock, 0] - x, rocks.position_m[rock, 1] - y,
                  rocks.position_m[rock, 2] - z)
    along = ax * dx + ay * dy + az * dz
    if along <= 0.0 or ax * ax + ay * ay + az * az - along * along >= rocks.radius_m[rock] ** 2:
        return miss
    # In the axes of the rock, and with its diameter as unit.
    R, size = rocks.R_world_rock[rock], rocks.diameter_m[rock]
    px, py, pz = _turned_back(R, -ax / size, -ay / size, -az / size)
    qx, qy, qz = _turned_back(R, dx, dy, dz)
    enter, leave, face = -np.inf, np.inf, -1
    shape, planes = rocks.shape[rock], rocks.planes
    for p in range(rocks.plane_first[shape], rocks.plane_first[shape + 1]):
        nx, ny, nz = planes[p, 0], planes[p, 1], planes[p, 2]
        speed = nx * qx + ny * qy + nz * qz
        gap = planes[p, 3] - (nx * px + ny * py + nz * pz)      # < 0: outside
        if speed < 0.0:
            if gap / speed > enter:
                enter, face = gap / speed, p
        elif speed > 0.0:
            leave = min(leave, gap / speed)
        elif gap < 0.0:
            return miss
        if enter > leave:
            return miss
    if enter <= 0.0:
        return miss
    nx, ny, nz = planes[face, 0], planes[face, 1], planes[face, 2]
    return (enter * size, R[0, 0] * nx + R[0, 1] * ny + R[0, 2] * nz,
            R[1, 0] * nx + R[1, 1] * ny + R[1, 2] * nz, R[2, 0] * nx + R[2, 1] * ny + R[2, 2] * nz)


@_compiled
def _turned_back(R, x, y, z):
    """Return the transpose of R times a vector."""
    return (R[0, 0] * x + R[1, 0] * y + R[2, 0] * z, R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
            R[0, 2] * x + R[1, 2] * y + R[2, 2] * z)


@_compiled
def _meet_soft_ground(z, cell, soft, x, y, oz, dx, dy, dz, begin, end):
    """Look every half sample for a hit on changed ground; return distance or inf, and slopes."""
    step_m = 0.5 * soft.sample_m
    count = int(math.ceil((end - begin) * math.hypot(dx, dy) / step_m)) + 1
    t0, gap0 = begin, oz + begin * dz - _height(z, cell, soft, x + begin * dx, y + begin * dy)
    if gap0 <= -step_m:     # it comes from below
        return np.inf, 0.0, 0.0
    met = begin if gap0 <= 0.0 else np.inf
    for s in range(1, count + 1):
        if met < np.inf:
            break
        t1 = begin + (end - begin) * s / count
        gap1 = oz + t1 * dz - _height(z, cell, soft, x + t1 * dx, y + t1 * dy)
        if gap1 > 0.0:
            t0, gap0 = t1, gap1
            continue
        for _ in range(_HALVINGS):
            t2 = 0.5 * (t0 + t1)
            gap2 = oz + t2 * dz - _height(z, cell, soft, x + t2 * dx, y + t2 * dy)
            if gap2 <= 0.0:
                t1, gap1 = t2, gap2
            else:
                t0, gap0 = t2, gap2
        met = t0 + (t1 - t0) * gap0 / (gap0 - gap1)
    if met == np.inf:
        return met, 0.0, 0.0
    x, y = x + met * dx, y + met * dy
    east, west = _height(z, cell, soft, x + step_m, y), _height(z, cell, soft, x - step_m, y)
    north, south = _height(z, cell, soft, x, y + step_m), _height(z, cell, soft, x, y - step_m)
    return met, 0.5 * (east - west) / step_m, 0.5 * (north - south) / step_m


@_compiled
def _height(z, cell, soft, x, y):
    """Return the height of the triangles and of what has changed [m] at a place [m]."""
    n = len(z) - 1
    u, v = x / cell + 0.5 * n, y / cell + 0.5 * n
    ix, iy = _within(u, 0, n), _within(v, 0, n)
    u, v = u - ix, v - iy
    z00, z11 = float(z[iy, ix]), float(z[iy + 1, ix + 1])
    if u >= v:
        z10 = float(z[iy, ix + 1])
        height = z00 + u * (z10 - z00) + v * (z11 - z10)
    else:
        z01 = float(z[iy + 1, ix])
        height = z00 + v * (z01 - z00) + u * (z11 - z01)
    u, v = x / soft.sample_m, y / soft.sample_m
    ix, iy = int(math.floor(u)), int(math.floor(v))
    u, v = u - ix, v - iy
    south = _change(soft, ix, iy) * (1.0 - u) + _change(soft, ix + 1, iy) * u
    north = _change(soft, ix, iy + 1) * (1.0 - u) + _change(soft, ix + 1, iy + 1) * u
    return height + south * (1.0 - v) + north * v


@_compiled
def _change(soft, ix, iy):
    """Return the change [m] of one sample."""
    tile, last = soft.change_m.shape[1], len(soft.slot) - 1
    row = min(max(iy // tile - soft.corner, 0), last)
    column = min(max(ix // tile - soft.corner, 0), last)
    return float(soft.change_m[soft.slot[row, column], iy % tile, ix % tile])
