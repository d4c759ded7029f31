"""Tracks in soft ground as pixels see them, from the two windows of a `TrackMap`."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.image.rendering.row_math import disc, wrapped

_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
_THOUSAND, _NOWHERE = np.float32(1000.0), np.float32(-0.1)


@compiled
def prints_of(depth, x, y, level, windows, sizes, touched,  # type: ignore[no-untyped-def]
              near, near_first, near_side, far, any_level,
              print_x, print_y, horizon, seen, coarse, pressed, loose):
    """Look up tracks at each pixel of a band.

    Args:
        depth, x, y, level: (n,) as `grid_rows.light_of_grid` leaves them.
        windows: 1 / extent [1/m] and half extent [m] of the near window, the far one; centre [m];
            place of the frame in both, x and y [m].
        sizes: Of a sample [m]; log2 of samples per metre; of a texel of the far window [m].
        touched: (tiles, tiles) whether a tile has anything to show.
        near: (texels, 6) slopes, tangent of the horizon less that of untouched ground, share of
            the sun that is hidden, height change [m], share that is compacted. Levels begin at
            `near_first` and are `near_side` along a side.
        far: (n, n, 3) sunlight over that on level ground less 1, compacted, loose.
        any_level: Whether mip levels count; otherwise the finest one is read.
        print_x to loose: (n,) filled in.
    """
    tiles, values = len(touched), np.empty(6, np.float32)
    for k in range(len(depth)):
        print_x[k] = print_y[k] = coarse[k] = pressed[k] = loose[k] = _ZERO
        horizon[k], seen[k] = _NOWHERE, _ONE
        if depth[k] <= _ZERO:
            continue
        east_m, north_m = x[k] + windows[6], y[k] + windows[7]
        p, q = east_m * windows[2], north_m * windows[2]
        i, j = wrapped(p, tiles, _ZERO)[0], wrapped(q, tiles, _ZERO)[0]
        if not touched[j, i]:
            continue
        away = max(abs(x[k] - windows[4]), abs(y[k] - windows[5]))
        if away < windows[1]:
            own = min(max(level[k] + sizes[1], _ZERO), np.float32(len(near_side) - 1))
            if not any_level:
                own = _ZERO
            lower = np.int64(own)
            part = own - np.float32(lower)
            values[:] = _ZERO
            for turn in range(2 if part > _ZERO else 1):
                share = part if turn else (_ONE - part)
                n, first = near_side[lower + turn], near_first[lower + turn]
                # The first sample lies at the origin.
                moved = _HALF / np.float32(near_side[0])
                west, east, f = wrapped(east_m * windows[0] + moved, n, _HALF)
                south, north, g = wrapped(north_m * windows[0] + moved, n, _HALF)
                a, b = first + south * n + west, first + south * n + east
                d, e = first + north * n + west, first + north * n + east
                for channel in range(6):
                    low = near[a, channel] + f * (near[b, channel] - near[a, channel])
                    high = near[d, channel] + f * (near[e, channel] - near[d, channel])
                    values[channel] += share * (low + g * (high - low))
            print_x[k], print_y[k] = values[0], values[1]
            horizon[k], seen[k] = _NOWHERE + values[2], _ONE - values[3]
            coarse[k], pressed[k] = min(own, _ONE), values[5]
            loose[k] = min(abs(values[4]) * _THOUSAND, _ONE) * (_ONE - values[5])
        else:
            horizon[k], coarse[k] = _ZERO, _ONE
            if away <= windows[3]:
                n = len(far)
                offset = _HALF * sizes[0] * windows[2]
                west, east, f = wrapped(p + offset, n, _HALF)
                south, north, g = wrapped(q + offset, n, _HALF)
                for channel in range(3):
                    low = far[south, west, channel] + f * (far[south, east, channel]
                                                           - far[south, west, channel])
                    high = far[north, west, channel] + f * (far[north, east, channel]
                                                            - far[north, west, channel])
                    low += g * (high - low)
                    if channel == 0:
                        seen[k] = _ONE + low
                    elif channel == 1:
                        pressed[k] = low
                    else:
                        loose[k] = low


@compiled
def add_prints(depth, print_x, print_y, horizon, seen, coarse, sun,  # type: ignore[no-untyped-def]
               slope_x, slope_y, beside):
    """Add the slopes of tracks to those of the grid; fill in the sunlight that tracks leave.

    Args:
        depth to coarse: (n,) as `prints_of` fills them in.
        sun: Unit vector to it; to it over level ground; radius of its disc [rad].
        slope_x, slope_y: (n,) added to.
        beside: (n,) filled in.
    """
    for k in range(len(depth)):
        if depth[k] <= _ZERO:
            continue
        untouched = sun[5] - slope_x[k] * sun[3] - slope_y[k] * sun[4]
        width = sun[6] * (_ONE + untouched * untouched)
        own = disc(untouched - horizon[k], width)
        beside[k] = own + coarse[k] * (seen[k] - own)
        slope_x[k] += print_x[k]
        slope_y[k] += print_y[k]
