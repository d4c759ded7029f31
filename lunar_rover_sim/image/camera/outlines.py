"""Anti-aliasing of the outlines of ground, rocks and rover, from radiance and depth.

A pixel beside an outline mixes with the pixel across it, by the share that the straight line
through the steps of the outline cuts off (Reshetov, "Morphological antialiasing", 2009). Outlines
are those of geometry, not of texture.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.workers import ONE_THREAD, Workers

F32 = NDArray[np.float32]

_STEEPEST = 3.5         # times the change of inverse depth from row to row of level ground


def smooth_outlines(radiance: F32, depth_m: F32, pixel: float, above_m: float,
                    workers: Workers = ONE_THREAD) -> None:
    """Mix the pixels beside outlines of an image, in place.

    Args:
        radiance: (h, w) [W m-2 sr-1].
        depth_m: (h, w) along the optical axis; 0 is the sky, and rocks and the rover are
            negative.
        pixel: Size of a pixel at depth 1.
        above_m: Height of the camera above the ground.
        workers: Share the rows.
    """
    # The inverse depth of level ground falls by pixel / above_m a row.
    limit = np.float32(_STEEPEST * pixel / above_m)
    for mixed in workers.rows(_mixed, len(depth_m), radiance, depth_m, limit):
        _write(radiance, *mixed)


@compiled
def _apart(a, b, limit):  # type: ignore[no-untyped-def]
    """Return whether neighbours of depths a and b show different surfaces.

    Their inverse depths differ by more than those of ground do, or one is the sky, or one of
    them an object.
    """
    return abs(a - b) > limit * a * b


@compiled
def _beside(first, last, depth, limit):  # type: ignore[no-untyped-def]
    """Return in which pixels of some rows a neighbour lies across an outline, no diagonal one."""
    h, w = depth.shape
    result = np.empty((last - first, w), np.uint8)
    beside = np.zeros(w + 1, np.uint8)      # whether pixels c - 1 and c are apart
    above, below = np.zeros(w, np.uint8), np.zeros(w, np.uint8)
    for r in range(max(first - 1, 0), last):
        own, out = depth[r], result[max(r - first, 0)]
        left, right, between = own[:w - 1], own[1:], beside[1:w]
        for c in range(w - 1):
            between[c] = _apart(left[c], right[c], limit)
        if r + 1 < h:
            under = depth[r + 1]
            for c in range(w):
                below[c] = _apart(own[c], under[c], limit)
        else:
            below[:] = 0
        before, after = beside[:w], beside[1:]
        for c in range(w):
            out[c] = before[c] | after[c] | above[c] | below[c]
        above, below = below, above
    return result


@compiled
def _cut(before, after):  # type: ignore[no-untyped-def]
    """Return what the other surface cuts off a pixel, by half of the line through the outline.

    The pixel is `before` and `after` pixels from the ends of a straight part of the outline. The
    line starts half a pixel deep at the first end and leaves in the middle of the part.
    """
    length = before + after + 1.0
    a, b = min(before, 0.5 * length), min(before + 1.0, 0.5 * length)
    return 0.5 * (b - a) * (1.0 - (a + b) / length)


@compiled
def _follow(depth, r, c, dr, dc, step_r, step_c, limit):  # type: ignore[no-untyped-def]
    """Return how many pixels the outline goes on straight, and 1 if it falls off there, or 0.

    Args:
        dr, dc: Step across the outline.
        step_r, step_c: Step along it.
    """
    farthest = 24
    h, w = depth.shape
    a, b = depth[r, c], depth[r + dr, c + dc]
    for k in range(farthest):
        r, c = r + step_r, c + step_c
        if r < 0 or r >= h or c < 0 or c >= w:
            return farthest, 0      # it goes on beyond the image
        following, beyond = depth[r, c], depth[r + dr, c + dc]
        ends = _apart(a, following, limit)
        if ends or not _apart(following, beyond, limit):
            return k, int(ends and not _apart(b, beyond, limit))
        a, b = following, beyond
    return farthest, 0


@compiled
def _share_of_other(depth, r, c, dr, dc, limit):  # type: ignore[no-untyped-def]
    """Return the share of a pixel that the surface across its outline covers."""
    back, falls_back = _follow(depth, r, c, dr, dc, -abs(dc), -abs(dr), limit)
    on, falls_on = _follow(depth, r, c, dr, dc, abs(dc), abs(dr), limit)
    return falls_back * _cut(back, on) + falls_on * _cut(on, back)


@compiled
def _mixed(first, last, radiance, depth, limit):  # type: ignore[no-untyped-def]
    """Return rows, columns and radiance of the pixels of some rows that outlines mix."""
    h, w = depth.shape
    beside = _beside(first, last, depth, limit)
    count = 0
    for marked in beside:
        for c in range(w):
            count += marked[c]
    rows, columns = np.empty(count, np.int64), np.empty(count, np.int64)
    k = 0
    for r in range(first, last):
        marked = beside[r - first]
        for c in range(w):
            if marked[c]:
                rows[k], columns[k] = r, c
                k += 1
    mixed = np.empty(count, np.float32)
    for k in range(count):
        r, c = rows[k], columns[k]
        own = depth[r, c]
        up, down, left, right = max(r - 1, 0), min(r + 1, h - 1), max(c - 1, 0), min(c + 1, w - 1)
        west, east = _apart(own, depth[r, left], limit), _apart(own, depth[r, right], limit)
        north, south = _apart(own, depth[up, c], limit), _apart(own, depth[down, c], limit)
        # The outline runs along the rows or along the columns; most of what lies around tells.
        nw, ne = _apart(own, depth[up, left], limit), _apart(own, depth[up, right], limit)
        sw, se = _apart(own, depth[down, left], limit), _apart(own, depth[down, right], limit)
        gx = 2 * (int(east) - int(west)) + int(ne) + int(se) - int(nw) - int(sw)
        gy = 2 * (int(south) - int(north)) + int(sw) + int(se) - int(ne) - int(nw)
        upright = not (north or south) or ((west or east) and abs(gx) > abs(gy))
        dr = dc = 0
        if upright:
            dc = 1 if (east and not west) or (east == west and gx > 0) else -1
        else:
            dr = 1 if (south and not north) or (south == north and gy > 0) else -1
        mixed[k] = radiance[r, c]
        if 0 <= r + dr < h and 0 <= c + dc < w:
            share = np.float32(_share_of_other(depth, r, c, dr, dc, limit))
            mixed[k] += share * (radiance[r + dr, c + dc] - radiance[r, c])
    return rows, columns, mixed


@compiled
def _write(radiance, rows, columns, mixed):  # type: ignore[no-untyped-def]
    """Write what `_mixed` returned into the image."""
    for k in range(len(rows)):
        radiance[rows[k], columns[k]] = mixed[k]
