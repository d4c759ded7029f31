"""Rays against ground and rocks: plain loops, compiled by Numba.

A ray begins where it may meet something (`free_sight`), and goes through large blocks of cells.
Where it dips below the greatest height of one, it goes through the small blocks within; where it
dips below that of one of those, it is tested against the rocks there, and cell by cell against the
triangles of the ground. Over ground that has changed, short steps follow from there on. Blocks of
greatest heights: Tevs, Ihrke and Seidel, "Maximum mipmaps for fast, accurate, and scalable dynamic
height field rendering", I3D 2008.

All arithmetic is in float64 and in the order in which it stands here, so that results do not
depend on the machine. Places on the grid are in cells, heights and distances along a ray in
metres. Functions that every ray calls get no tuples of arrays: handing one over takes as long as
twenty steps.
"""

from __future__ import annotations

import math

import numpy as np

from lunar_rover_sim.base.compiled import compiled, inlined

GROUND, NOTHING = -1, -2    # targets, besides the numbers of rocks
SMALL, LARGE = 2, 4         # blocks are 4 x 4 and 16 x 16 cells: powers of 2
_LEAST = 1e-9               # of a component of a direction: no ray is parallel to an axis
_SLACK = 1e-9               # of distances [m] and places: neighbouring triangles leave no gap
_HALVINGS = 4               # of a step over soft ground, before it is taken as straight


@compiled
def cast(level, inner_m, rocks, soft, which, free_m, origin_m, direction, range_m, distance_m,
         target, normal):
    """Look for nearer hits of rays on a level, beyond the square of half side inner_m [m].

    Args:
        which: (m,) rays.
        free_m: (n,) within which they meet nothing of it.
        origin_m: (n, 3).
        direction: (n, 3).
        distance_m: Of the nearest hits so far.
        target: What they meet.
        normal: Its normal there.
    """
    z, cell, tops, first, side, rock_first, rock_list = level
    rise_m, n, highest = soft.rise_m, len(z) - 1, tops[first[len(first) - 1]]
    for i in which:
        if free_m[i] >= range_m:
            continue
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
        # It begins where it enters the large block in which it is free no more.
        free, last_rock = max(t, free_m[i]), -1
        bx, by = _within(ox + free * dx, 0, n) >> LARGE, _within(oy + free * dy, 0, n) >> LARGE
        t = max(t, (((bx + 1 - east) << LARGE) - ox) * per_x,
                (((by + 1 - north) << LARGE) - oy) * per_y)
        while t < end and 0 <= bx < side[1] and 0 <= by < side[1]:
            leave_x = (((bx + east) << LARGE) - ox) * per_x
            leave_y = (((by + north) << LARGE) - oy) * per_y
            leave = min(leave_x, leave_y)
            t = _dip(t, leave, oz, dz, tops[first[1] + by * side[1] + bx])
            low_x, low_y = bx << LARGE, by << LARGE
            cx = min(_within(ox + t * dx, low_x, 1 << LARGE), n - 1) >> SMALL
            cy = min(_within(oy + t * dy, low_y, 1 << LARGE), n - 1) >> SMALL
            while t < min(leave, end) and 0 <= cx < side[0] and 0 <= cy < side[0]:
                out_x = (((cx + east) << SMALL) - ox) * per_x
                out_y = (((cy + north) << SMALL) - oy) * per_y
                out, block = min(out_x, out_y), cy * side[0] + cx
                t = _dip(t, out, oz, dz, tops[block])
                if t < out:
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
                    rise = rise_m[cy, cx] if cy < len(rise_m) else 0.0
                    met, sx, sy = _meet_cells(z, cx << SMALL, cy << SMALL, ox, oy, oz - rise, dx,
                                              dy, dz, per_x, per_y, t)
                    if rise > 0.0:
                        met, sx, sy = _meet_soft_ground(z, cell, soft, rise, x, y, oz, dx * cell,
                                                        dy * cell, dz, t, min(out, end), met)
                    else:
                        sx, sy = sx / cell, sy / cell
                    if met < nearest:
                        nearest = distance_m[i] = met
                        target[i] = GROUND
                        one = 1.0 / math.sqrt(sx * sx + sy * sy + 1.0)
                        normal[i, 0], normal[i, 1], normal[i, 2] = -sx * one, -sy * one, one
                    end = min(end, nearest)
                t = out
                cx, cy = (cx + 2 * east - 1, cy) if out_x < out_y else (cx, cy + 2 * north - 1)
            t = leave
            bx, by = (bx + 2 * east - 1, by) if leave_x < leave_y else (bx, by + 2 * north - 1)


@compiled
def _dip(t, leave, oz, dz, top):
    """Return where a ray is at or below a height first, between two distances; else the latter."""
    if oz + t * dz <= top:
        return t
    return leave if oz + leave * dz > top else (top - oz) / dz


@compiled
def _no_zero(component):
    """Return a component of a direction that one may divide by."""
    return component if abs(component) >= _LEAST else _LEAST


@compiled
def _exit(x, y, dx, dy, half_m):
    """Return how far a ray goes until it leaves the square of half side half_m [m]."""
    return min((math.copysign(half_m, dx) - x) / dx, (math.copysign(half_m, dy) - y) / dy)


@compiled
def _within(place, low, size):
    """Return the cell of a place, one of `size` from `low` on whatever rounding says."""
    return min(max(int(place), low), low + size - 1)


@inlined
def _meet_cells(z, low_x, low_y, ox, oy, oz, dx, dy, dz, per_x, per_y, t):
    """Go from cell to cell of a smallest block, from the one at t on.

    Returns the distance at which the ray meets the ground, inf if it does not, and the slopes
    there [m per cell].
    """
    east, north = int(dx > 0.0), int(dy > 0.0)
    high_x, high_y = min(low_x + (1 << SMALL), len(z) - 1), min(low_y + (1 << SMALL), len(z) - 1)
    ix = _within(ox + t * dx, low_x, high_x - low_x)
    iy = _within(oy + t * dy, low_y, high_y - low_y)
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


@inlined
def _meet_triangles(z, ix, iy, u, v, oz, dx, dy, dz, enter, leave):
    """Test a ray between two distances against both triangles of a cell.

    Args:
        u: Origin from the corner of the cell, eastward. The lower triangle, u >= v, has the corner
            south-east, the upper one that north-west.
        v: The same, northward.
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


@inlined
def _meet_plane(slope_x, slope_y, u, v, height, dx, dy, dz, enter, leave):
    """Return where a ray meets a plane from above between two distances, inf if it does not."""
    speed = dz - dx * slope_x - dy * slope_y
    if speed < 0.0:
        at = (u * slope_x + v * slope_y - height) / speed
        if enter - _SLACK <= at <= leave + _SLACK:
            return at
    return np.inf


@compiled
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
    nearest, face = np.inf, -1
    shape, planes = rocks.shape[rock], rocks.planes
    for piece in range(rocks.piece_first[shape], rocks.piece_first[shape + 1]):
        enter, leave, front = -np.inf, np.inf, -1
        for p in range(rocks.plane_first[piece], rocks.plane_first[piece + 1]):
            nx, ny, nz = planes[p, 0], planes[p, 1], planes[p, 2]
            speed = nx * qx + ny * qy + nz * qz
            gap = planes[p, 3] - (nx * px + ny * py + nz * pz)      # < 0: outside
            if speed < 0.0:
                if gap / speed > enter:
                    enter, front = gap / speed, p
            elif speed > 0.0:
                leave = min(leave, gap / speed)
            elif gap < 0.0:
                leave = -np.inf
            if enter > leave or leave < 0.0:
                break
        if enter <= leave:
            if enter <= 0.0 <= leave:
                return miss
            if 0.0 < enter < nearest:
                nearest, face = enter, front
    if face < 0:
        return miss
    nx, ny, nz = planes[face, 0], planes[face, 1], planes[face, 2]
    return (nearest * size, R[0, 0] * nx + R[0, 1] * ny + R[0, 2] * nz,
            R[1, 0] * nx + R[1, 1] * ny + R[1, 2] * nz, R[2, 0] * nx + R[2, 1] * ny + R[2, 2] * nz)


@compiled
def _turned_back(R, x, y, z):
    """Return the transpose of R times a vector."""
    return (R[0, 0] * x + R[1, 0] * y + R[2, 0] * z, R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
            R[0, 2] * x + R[1, 2] * y + R[2, 2] * z)


@compiled
def _meet_soft_ground(z, cell, soft, rise, x, y, oz, dx, dy, dz, begin, end, at):
    """Look every half sample for a hit on changed ground; return distance or inf, and slopes.

    Args:
        at: Where a ray from above meets ground that has risen by `rise`, as it has nowhere more.
    """
    step_m = 0.5 * soft.sample_m
    count, first = int(math.ceil((end - begin) * math.hypot(dx, dy) / step_m)) + 1, 0
    if oz + begin * dz > _ground(z, cell, x + begin * dx, y + begin * dy) + rise:
        if at == np.inf:
            return np.inf, 0.0, 0.0
        first = max(int((at - begin) / (end - begin) * count) - 1, 0)
    t0 = begin + (end - begin) * first / count
    gap0 = oz + t0 * dz - _height(z, cell, soft, x + t0 * dx, y + t0 * dy)
    if gap0 <= -step_m:     # it comes from below
        return np.inf, 0.0, 0.0
    met = begin if gap0 <= 0.0 else np.inf
    for s in range(first + 1, count + 1):
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


@compiled
def _height(z, cell, soft, x, y):
    """Return the height of the triangles and of what has changed [m] at a place [m]."""
    height, u, v = _ground(z, cell, x, y), x / soft.sample_m, y / soft.sample_m
    ix, iy = int(math.floor(u)), int(math.floor(v))
    u, v = u - ix, v - iy
    change, tile, last = soft.change_m, soft.change_m.shape[1] - 1, len(soft.slot) - 1
    tx, ty = ix // tile, iy // tile
    k = soft.slot[min(max(ty - soft.corner, 0), last), min(max(tx - soft.corner, 0), last)]
    ix, iy = ix - tx * tile, iy - ty * tile
    south = change[k, iy, ix] * (1.0 - u) + change[k, iy, ix + 1] * u
    north = change[k, iy + 1, ix] * (1.0 - u) + change[k, iy + 1, ix + 1] * u
    return height + south * (1.0 - v) + north * v


@compiled
def _ground(z, cell, x, y):
    """Return the height of the triangles [m] at a place [m]."""
    n = len(z) - 1
    u, v = x / cell + 0.5 * n, y / cell + 0.5 * n
    ix, iy = _within(u, 0, n), _within(v, 0, n)
    u, v = u - ix, v - iy
    z00, z11 = float(z[iy, ix]), float(z[iy + 1, ix + 1])
    if u >= v:
        z10 = float(z[iy, ix + 1])
        return z00 + u * (z10 - z00) + v * (z11 - z10)
    z01 = float(z[iy + 1, ix])
    return z00 + v * (z01 - z00) + u * (z11 - z01)
