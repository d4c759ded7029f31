"""Depth of the ground itself, from that of its meshes, pixel by pixel.

Where the mesh is coarser than the grid, the ray of a pixel is intersected with the triangles of
the grid; nearby, where it has shape, with the relief below the grid.
"""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.compiled import compiled, inlined
from lunar_rover_sim.rendering.row_math import grid_cell, shape_at, shape_share

_ZERO, _HALF, _ONE, _TINY = (np.float32(x) for x in (0.0, 0.5, 1.0, 1e-9))
_QUARTER, _BESIDE, _THOUSAND = (np.float32(x) for x in (0.25, 0.6, 1000.0))
_SHARE, _ACROSS, _FLAT, _FAR = (np.float32(x) for x in (0.06, 0.05, 0.02, 1e9))
_RELAXED = np.float32(1.5)      # length of a step over the relief, over what its bounds allow
_REFINED, _SEARCHED, _TURNS = 8, 14, 2


@inlined
def _grid_height(x, y, heights, lattice):  # type: ignore[no-untyped-def]
    """Return the height of the triangles of the grid."""
    column, row, u, v = grid_cell(x, y, lattice)
    n = np.int64(lattice[2]) + 2
    lower = u >= v
    k = row * n + column
    # Without branches: which half of a cell it is cannot be foreseen.
    low, corner, high = heights[k], heights[k + (1 if lower else n)], heights[k + n + 1]
    along, aside = max(u, v), min(u, v)
    return low + along * (corner - low) + aside * (high - corner)


@compiled
def _soil_at(x, y, windows, touched, near, n):  # type: ignore[no-untyped-def]
    """Return height change [m], and the share of the relief below the grid that is left there."""
    tiles = len(touched)
    i = np.int64(np.floor(x * windows[2] * np.float32(tiles))) % tiles
    j = np.int64(np.floor(y * windows[2] * np.float32(tiles))) % tiles
    if not touched[j, i] or max(abs(x - windows[4]), abs(y - windows[5])) >= windows[1]:
        return _ZERO, _ONE
    u, v = x * windows[0] * np.float32(n), y * windows[0] * np.float32(n)
    column, row = np.floor(u), np.floor(v)
    u, v = u - column, v - row
    i, j = np.int64(column) % n, np.int64(row) % n
    east, north = (i + 1) % n, (j + 1) % n
    rise, pressed = _ZERO, _ZERO
    for k in range(4, 6):
        low = near[j * n + i, k] + u * (near[j * n + east, k] - near[j * n + i, k])
        high = near[north * n + i, k] + u * (near[north * n + east, k] - near[north * n + i, k])
        low += v * (high - low)
        if k == 4:
            rise = low
        else:
            pressed = low
    buried = _BESIDE * min(abs(rise) * _THOUSAND, _ONE) * (_ONE - pressed)
    return rise, _ONE - max(pressed, buried)


@compiled
def refine(depth, first, last, view, heights, lattice, bounds,  # type: ignore[no-untyped-def]
           has_tracks, windows, touched, near, side):
    """Intersect rays with the triangles of the grid, in rows of an (h, w) image of depth.

    Args:
        depth: Replaced [m].
        first, last: The first row, and the one after the last.
        view: As `view.numbers`.
        heights, lattice: Of the finest grid [m]; 1 / cell [1/m], half and last whole index of
            cells.
        bounds: Nearest and farthest depth, bound of the mesh's error [m].
        has_tracks, windows, touched, near, side: Tracks, as for `track_rows.prints_of`; `side` of
            the finest level.
    """
    ex, ey, ez = view[9], view[10], view[11]
    flat = heights.ravel()
    for r in range(first, last):
        row, down = depth[r], np.float32(r)
        ax, ay, az = (view[0] + view[6] * down, view[1] + view[7] * down, view[2] + view[8] * down)
        for c in range(len(row)):
            far = row[c]
            if not bounds[0] < far < bounds[1]:
                continue
            across = np.float32(c)
            rx, ry, rz = ax + view[3] * across, ay + view[4] * across, az + view[5] * across
            reach = min(bounds[2] / max(-rz, _QUARTER * bounds[2]), _SHARE * far)
            t = far - reach
            low, high, f_low, f_high = t, -_ONE, -_ONE, _ZERO
            for _ in range(_REFINED + 1):
                x, y = ex + rx * t, ey + ry * t
                f = ez + rz * t - _grid_height(x, y, flat, lattice)
                if has_tracks:
                    f -= _soil_at(x, y, windows, touched, near, side)[0]
                if f <= _ZERO:
                    high, f_high = t, f
                    break
                low, f_low = t, f
                t += reach * _QUARTER
            if high <= _ZERO or f_low <= _ZERO:
                continue
            for _ in range(_TURNS):
                t = low + (high - low) * f_low / max(f_low - f_high, _TINY)
                x, y = ex + rx * t, ey + ry * t
                f = ez + rz * t - _grid_height(x, y, flat, lattice)
                if has_tracks:
                    f -= _soil_at(x, y, windows, touched, near, side)[0]
                if f > _ZERO:
                    low, f_low = t, f
                else:
                    high, f_high = t, f
            row[c] = low + (high - low) * f_low / max(f_low - f_high, _TINY)


@inlined
def _near_ground(x, y, rx, ry, heights, lattice, shape, scale,  # type: ignore[no-untyped-def]
                 centre, has_tracks, windows, touched, near, side):
    """Return the height of grid, tracks and relief, and a bound of the slopes of relief around.

    Between them is how fast the grid rises along a ray.
    """
    last = lattice[2] + _ONE
    u = min(max(x * lattice[0] + lattice[1], _ZERO), last)
    v = min(max(y * lattice[0] + lattice[1], _ZERO), last)
    i, j = min(np.int64(u), np.int64(lattice[2])), min(np.int64(v), np.int64(lattice[2]))
    u, v = u - np.float32(i), v - np.float32(j)
    south, north = heights[j, i + 1] - heights[j, i], heights[j + 1, i + 1] - heights[j + 1, i]
    low, high = heights[j, i] + u * south, heights[j + 1, i] + u * north
    base = low + v * (high - low)
    along = (rx * (south + v * (north - south)) + ry * (high - low)) * lattice[0]
    share = shape_share(x - centre[0], y - centre[1], centre[2])
    if has_tracks:
        rise, left = _soil_at(x, y, windows, touched, near, side)
        base += rise
        share *= left
    if share == _ZERO:
        return base, along, _ZERO
    rise, steep = shape_at(x, y, shape, scale)
    return base + share * rise, along, share * steep


@inlined
def _step(above, rise, steep, rz, across):  # type: ignore[no-untyped-def]
    """Return how far a ray may go on that is so high above the ground.

    Args:
        rise: Of the grid along the ray; `steep` bounds the slopes of relief.
    """
    return _RELAXED * above / (max(rise - rz, _FLAT * across) + steep * across)


@compiled
def _towards_nadir(rx, ry, view):  # type: ignore[no-untyped-def]
    """Return the step of columns for a row down in which a ray stays in its vertical plane."""
    aside = rx * view[4] - ry * view[3]
    return (ry * view[6] - rx * view[7]) / aside if aside != _ZERO else _FAR


@compiled
def _are_ordered(first, last, columns, view):  # type: ignore[no-untyped-def]
    """Return whether all rays look farther down a row below, less than a column aside."""
    right, down = view[3:6], view[6:9]
    for r in (first, last - 1):
        for c in (0, columns - 1):
            ray = view[:3] + right * np.float32(c) + down * np.float32(r)
            step = _towards_nadir(ray[0], ray[1], view)
            below = ray + right * step + down
            if abs(step) > _ONE or (below[2] * np.sqrt(ray[0]**2 + ray[1]**2)
                                    >= ray[2] * np.sqrt(below[0]**2 + below[1]**2)):
                return False
    return True


@compiled
def displace(depth, first, last, view, heights, lattice, shape,  # type: ignore[no-untyped-def]
             relief, centre, has_tracks, windows, touched, near, side):
    """Intersect rays with the relief below the grid, in rows of an (h, w) image of depth.

    Steps are as long as the slopes around a point allow: Dummer, Cone step mapping, 2006. They
    begin where the ray of the row below, in the same vertical plane, has met the ground: what lies
    before that is below that ray.

    Args:
        depth: Replaced [m].
        shape: A map as for `row_math.shape_at`: height over what is interpolated between heights
            of the grid [m], bound of the slopes around.
        relief: 1 / extent of `shape` [1/m], greatest height in it, half of the finest grid [m].
        centre: Place of the middle of all cameras [m], reach of relief with shape [m].
        first, last, view, heights, lattice, has_tracks, windows, touched, near, side: As for
            `refine`.
    """
    ex, ey, ez, pixel = view[9], view[10], view[11], view[15]
    columns = depth.shape[1]
    ordered = _are_ordered(first, last, columns, view)
    # Of rays of a row and of that below: horizontal distance and height at which they meet the
    # ground, slope of the grid, bound of those of relief; a distance of 0 where it is not known.
    met, met_below = np.zeros((columns, 4), np.float32), np.zeros((columns, 4), np.float32)
    for r in range(last - 1, first - 1, -1):
        row, down = depth[r], np.float32(r)
        ax, ay, az = (view[0] + view[6] * down, view[1] + view[7] * down, view[2] + view[8] * down)
        met, met_below = met_below, met
        for c in range(columns):
            met[c, 0] = _ZERO
            far = row[c]
            if far <= _ZERO:
                continue
            column = np.float32(c)
            rx, ry, rz = ax + view[3] * column, ay + view[4] * column, az + view[5] * column
            x, y = ex + rx * far, ey + ry * far
            if max(abs(x), abs(y)) >= relief[2] or np.sqrt(
                    (x - centre[0])**2 + (y - centre[1])**2) >= centre[2]:
                continue
            across = np.sqrt(rx * rx + ry * ry)
            t = far - min(relief[1] / max(-rz, _ACROSS * across), _HALF * far)
            before, f_before = t, _ZERO
            beside = np.int64(np.floor(column + _towards_nadir(rx, ry, view)))
            if ordered and 0 <= beside < columns - 1:
                # The nearer one of the two that this plane lies between.
                of_left, of_right = met_below[beside], met_below[beside + 1]
                below = of_left if of_left[0] < of_right[0] else of_right
                from_below = below[0] / across
                f = ez + rz * from_below - below[1]
                if from_below > t and f > _ZERO:
                    before, f_before = from_below, f
                    t = from_below + _step(f, below[2] * across, below[3], rz, across)
            f, height, rise, steep = _ZERO, _ZERO, _ZERO, _ZERO
            close = _QUARTER * pixel * t
            for _ in range(_SEARCHED):
                height, rise, steep = _near_ground(
                    ex + rx * t, ey + ry * t, rx, ry, heights, lattice, shape, relief[0], centre,
                    has_tracks, windows, touched, near, side)
                f = ez + rz * t - height
                if f < close:
                    break
                before, f_before = t, f
                t += _step(f, rise, steep, rz, across)
            if f < _ZERO < f_before:
                low, high, f_high = before, t, f
                for _ in range(_TURNS):
                    t = low + (high - low) * f_before / (f_before - f_high)
                    height, rise, steep = _near_ground(
                        ex + rx * t, ey + ry * t, rx, ry, heights, lattice, shape, relief[0],
                        centre, has_tracks, windows, touched, near, side)
                    f = ez + rz * t - height
                    if f > _ZERO:
                        low, f_before = t, f
                    else:
                        high, f_high = t, f
            met[c, 0], met[c, 1], met[c, 2], met[c, 3] = (t * across, height, rise / across,
                                                          steep)
            row[c] = t
