"""The grids of the ground as pixels see them: slope, sunlight, albedo, light from around."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import inlined, vectorised
from lunar_rover_sim.base.fast_math import log2
from lunar_rover_sim.image.rendering.row_math import (any_positive, byte, CHUNK, disc, NO_PIXELS,
                                                      of_half, PAGE, shape_share)

_N, _PAGE = CHUNK, PAGE
_LAYER, _SCALE, _OFFSET, _LOG, _REACH = (k * _PAGE for k in range(5))
_COARSE, _MATTER, _SIZE, _WEIGHT, _TOP = (k * _PAGE for k in range(5, 10))
_U, _V, _ANGLE, _MOST, _TURN = (k * _PAGE for k in range(10, 15))
_OUT = 15 * _PAGE       # four pages
_AT, _OF, _WHOLE, _X, _Y = (k * _PAGE for k in (19, 21, 22, 23, 24))    # _AT: two pages
_RAW = 25 * _PAGE       # four pages
_FLOATS = 29 * _PAGE
_INDEX, _EAST, _NORTH = 0, _PAGE, 2 * _PAGE

_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_FOUR, _TWELVE = np.float32(4.0), np.float32(12.0)
_GRAZING, _TINY = np.float32(0.02), np.float32(1e-6)
_BYTE = np.float32(1.0 / 255.0)
# A pixel is longer along the view than it is wide, and texels are as wide as they are long: seen
# across the sun, where shadows end across the view, ones as long as a pixel would average shadows
# that it keeps apart. So a part of the length, in octaves, is left out there: less of it where a
# pixel is many times as long as it is wide, since small texels alias. These numbers bring single
# pixels, and the share in shadow, near to those of finer images (bench_resolution.py).
_SHORTER, _LONGEST, _SHARPER = np.float32(0.34), np.float32(1.0 / 8.0), np.float32(0.05)
_FIRST, _SPAN = np.float32(0.35), np.float32(1.0 / 0.3)


@inlined
def _mip(level):  # type: ignore[no-untyped-def]
    """Return the mip level to read: mostly a whole one, which halves the work."""
    whole = np.floor(level)
    part = min(max((level - whole - _FIRST) * _SPAN, _ZERO), _ONE)
    return max(whole + part, _ZERO)


@vectorised
def _find(s, place, count, side, first):  # type: ignore[no-untyped-def]
    """Find the four texels around each pixel, and its place between them, at _U and _V.

    Places over a side are those at _AT, grids those at _OF, whole mip levels those at _WHOLE.

    Args:
        s, place: Scratch memory, of float32 and int32.
        count: Of pixels.
        side, first: Texels along a side of each level, and where it begins.
    """
    lowest, highest = np.int32(99), np.int32(0)
    for j in range(count):
        whole = np.int32(s[_WHOLE + j])
        lowest, highest = min(lowest, whole), max(highest, whole)
    # Of all levels of the chunk; mostly it is one.
    for k in range(lowest, highest + 1):
        n, start, chosen = np.int32(side[k]), np.int32(first[k]), np.float32(k)
        wide, last = np.float32(n), np.float32(n - 1)
        for j in range(count):
            u = min(max(s[_AT + j] * wide - _HALF, _ZERO), last)    # at the edges
            v = min(max(s[_AT + _PAGE + j] * wide - _HALF, _ZERO), last)
            column, row = np.floor(u), np.floor(v)
            own = s[_WHOLE + j] == chosen
            index = np.int32(start + np.int32(
                np.int32(np.int32(np.int32(s[_OF + j]) * n) + np.int32(row)) * n)
                + np.int32(column))
            east = np.int32(min(last - column, _ONE))
            north = np.int32(np.int32(min(last - row, _ONE)) * n)
            s[_U + j] = u - column if own else s[_U + j]
            s[_V + j] = v - row if own else s[_V + j]
            place[_INDEX + j] = index if own else place[_INDEX + j]
            place[_EAST + j] = east if own else place[_EAST + j]
            place[_NORTH + j] = north if own else place[_NORTH + j]


@vectorised
def _ground_at(s, place, t, count, ground, side, first):  # type: ignore[no-untyped-def]
    """Interpolate four float16, which go to _RAW, where `_find` looks."""
    low = np.uint64(0xffffffff)
    _find(s, place, count, side, first)
    for j in range(count):
        k, east = np.uint32(place[_INDEX + j]), np.uint32(place[_EAST + j])
        north = np.uint32(place[_NORTH + j])
        a, b, d, e = ground[k], ground[k + east], ground[k + north], ground[k + north + east]
        t[j], t[_PAGE + j] = np.uint32(a & low), np.uint32(b & low)
        t[2 * _PAGE + j], t[3 * _PAGE + j] = np.uint32(d & low), np.uint32(e & low)
        t[4 * _PAGE + j] = np.uint32(a >> np.uint64(32))
        t[5 * _PAGE + j] = np.uint32(b >> np.uint64(32))
        t[6 * _PAGE + j] = np.uint32(d >> np.uint64(32))
        t[7 * _PAGE + j] = np.uint32(e >> np.uint64(32))
    for channel in range(4):
        corner, out = 4 * _PAGE * (channel // 2), _RAW + channel * _PAGE
        down = np.uint32(16 * (channel % 2))
        for j in range(count):
            f, g = s[_U + j], s[_V + j]
            a, b = of_half(t[corner + j] >> down), of_half(t[corner + _PAGE + j] >> down)
            d, e = (of_half(t[corner + 2 * _PAGE + j] >> down),
                    of_half(t[corner + 3 * _PAGE + j] >> down))
            a += f * (b - a)
            d += f * (e - d)
            s[out + j] = a + g * (d - a)


@vectorised
def light_of_grid(at, levels, ground, matter,  # type: ignore[no-untyped-def]
                  side, first, constants, smooth, grid):
    """Look up what is known of the ground at each pixel of a band.

    Args:
        at: (7, n) as `ground_band.place` fills it in.
        levels: (levels, 4) of each grid: scale and offset from metres to places over a side, log2
            of texels per metre, half extent [m].
        ground: Texels of 4 float16 as uint64: slopes, clearance, occluder distance. Those of a mip
            level begin at `first` and are `side` along a side; grids follow each other.
        matter: Texels of 4 bytes as uint32: albedo / 2, roots of 4 irradiance scattered here and
            around; on the finest grid the share of the sun that is seen, on the others the share
            of ground in the shadow of far rocks.
        constants: Size of a pixel at depth 1; radius of the sun [rad]; place of the middle of all
            cameras [m], reach of relief with shape [m]; log2 of texels per metre of the fine tile,
            and its last level; horizontal part of the unit vector to the sun.
        smooth: Whether edges of shadows are drawn without steps.
        grid: (8, n) filled in: slopes along x and y; share of the sun over the grid; factor of the
            albedo; irradiance scattered here and around, over that of the sun; mip level of the
            fine tile of relief; log2 of the footprint along the view [m].
    """
    depth, x, y, vx, vy, vz = at[0], at[1], at[2], at[4], at[5], at[6]
    slope_x, slope_y, lit, albedo, below, around, detail, level = (
        grid[0], grid[1], grid[2], grid[3], grid[4], grid[5], grid[6], grid[7])
    s, place = np.empty(_FLOATS, np.float32), np.empty(3 * _PAGE, np.int32)
    t, which = np.empty(8 * _PAGE, np.uint32), np.empty(_N, np.uint32)
    pixel, radius, middle_x, middle_y, reach, fine, last = (
        constants[0], constants[1], constants[2], constants[3], constants[4], constants[5],
        constants[6])
    deepest = np.float32(len(side) - 1)
    sun_x, sun_y = constants[7], constants[8]
    for c in range(len(depth) // _N):
        i = c * _N
        if not any_positive(depth, i):
            continue
        for j in range(_N):
            s[_SIZE + j] = depth[i + j] * pixel
        for j in range(_N):
            s[_X + j] = x[i + j]
        for j in range(_N):
            s[_Y + j] = y[i + j]
        for j in range(_N):
            s[_TURN + j] = vz[i + j]
        # The finest grid that is there.
        far = False
        for j in range(_N):
            s[_REACH + j] = max(abs(s[_X + j]), abs(s[_Y + j]))
            far |= s[_REACH + j] > levels[0, 3]
        for j in range(_N):
            s[_LAYER + j] = _ZERO
            s[_SCALE + j], s[_OFFSET + j], s[_LOG + j] = levels[0, 0], levels[0, 1], levels[0, 2]
        if far:
            for k in range(1, len(levels)):
                half, number = levels[k - 1, 3], np.float32(k)
                scale, offset, log = levels[k, 0], levels[k, 1], levels[k, 2]
                for j in range(_N):
                    beyond = s[_REACH + j] > half
                    s[_LAYER + j] = number if beyond else s[_LAYER + j]
                    s[_SCALE + j] = scale if beyond else s[_SCALE + j]
                    s[_OFFSET + j] = offset if beyond else s[_OFFSET + j]
                    s[_LOG + j] = log if beyond else s[_LOG + j]
        # Footprint of the pixel on level ground, across and along the line of sight. Along it the
        # pixel shows the slopes that face it; a mean over more ground has those that are hidden.
        for j in range(_N):
            size = max(s[_SIZE + j], _TINY)
            along = log2(min(size / max(abs(s[_TURN + j]), _GRAZING), _TWO * size))
            s[_TOP + j] = along
            s[_COARSE + j] = min(_mip(along + s[_LOG + j]), deepest)
            # Far rocks' shadows are as narrow as a pixel: they are not blurred along the view.
            own = max(log2(size) + s[_LOG + j], _ZERO)
            own = own if s[_LAYER + j] > _ZERO else s[_COARSE + j]
            s[_MATTER + j] = min(np.ceil(own - _HALF), deepest)
        for j in range(_N):
            level[i + j] = s[_TOP + j]
        for j in range(_N):
            s[_AT + j] = s[_X + j] * s[_SCALE + j] + s[_OFFSET + j]
            s[_AT + _PAGE + j] = s[_Y + j] * s[_SCALE + j] + s[_OFFSET + j]
        for j in range(_N):
            s[_OF + j] = s[_LAYER + j]
            s[_WHOLE + j] = np.floor(s[_COARSE + j])
            s[_WEIGHT + j] = s[_COARSE + j] - s[_WHOLE + j]
        _ground_at(s, place, t, _N, ground, side, first)
        for j in range(4 * _PAGE):
            s[_OUT + j] = s[_RAW + j]
        # A third of the pixels lie between two levels.
        few = NO_PIXELS
        for j in range(_N):
            which[few] = j
            few += s[_WEIGHT + j] > _ZERO       # without a branch, which could not be foreseen
        if few:
            for k in range(few):
                j = which[k]
                s[_AT + k], s[_AT + _PAGE + k] = s[_AT + j], s[_AT + _PAGE + j]
                s[_OF + k], s[_WHOLE + k] = s[_OF + j], min(s[_WHOLE + j] + _ONE, deepest)
            _ground_at(s, place, t, few, ground, side, first)
            for k in range(few):
                j = which[k]
                for page in range(0, 4 * _PAGE, _PAGE):
                    own = s[_OUT + page + j]
                    s[_OUT + page + j] = own + s[_WEIGHT + j] * (s[_RAW + page + k] - own)
        for j in range(_N):
            s[_AT + j] = s[_X + j] * s[_SCALE + j] + s[_OFFSET + j]
            s[_AT + _PAGE + j] = s[_Y + j] * s[_SCALE + j] + s[_OFFSET + j]
        for j in range(_N):
            s[_OF + j] = s[_LAYER + j]
            s[_WHOLE + j] = s[_MATTER + j]
        _find(s, place, _N, side, first)
        for j in range(_N):
            here, east = np.uint32(place[_INDEX + j]), np.uint32(place[_EAST + j])
            north = np.uint32(place[_NORTH + j])
            t[j], t[_PAGE + j] = matter[here], matter[here + east]
            t[2 * _PAGE + j], t[3 * _PAGE + j] = matter[here + north], matter[here + north + east]
        # Albedo / 2, below, around, last: the pages of scale, offset, log and reach are free now.
        for channel in range(4):
            out, down = _SCALE + channel * _PAGE, np.uint32(8 * channel)
            for j in range(_N):
                f, g = s[_U + j], s[_V + j]
                a, b = byte(t[j] >> down), byte(t[_PAGE + j] >> down)
                d, e = byte(t[2 * _PAGE + j] >> down), byte(t[3 * _PAGE + j] >> down)
                a += f * (b - a)
                d += f * (e - d)
                s[out + j] = _BYTE * (a + g * (d - a))
        for j in range(_N):
            albedo[i + j] = _TWO * s[_SCALE + j]
        for j in range(_N):
            below[i + j] = s[_OFFSET + j] * s[_OFFSET + j]
        for j in range(_N):
            around[i + j] = s[_LOG + j] * s[_LOG + j]
        # Relief below the grid has the most contrast: little of it may be left out along the
        # view, on slopes that turn away from the camera either. Where it has shape, rays meet
        # what faces them.
        for j in range(_N):
            a, b = s[_OUT + j], s[_OUT + _PAGE + j]
            facing = s[_TURN + j] - a * vx[i + j] - b * vy[i + j]
            s[_WEIGHT + j] = facing / np.sqrt(a * a + b * b + _ONE)
        for j in range(_N):
            a, b = s[_X + j] - middle_x, s[_Y + j] - middle_y
            shaped = shape_share(a, b, reach)
            s[_WEIGHT + j] = min(max(max(s[_WEIGHT + j], shaped), _GRAZING), _ONE)
        for j in range(_N):
            size = max(s[_SIZE + j], _TINY)
            s[_TURN + j] = min(size / s[_WEIGHT + j], _TWELVE * size)
        for j in range(_N):
            size = max(s[_SIZE + j], _TINY)
            p, q = vx[i + j], vy[i + j]
            across = p * sun_y - q * sun_x
            across = across * across / max(p * p + q * q, _TINY)
            longer = s[_TURN + j] / size
            across *= _SHORTER * min(_TWO - longer * _LONGEST, _ONE)
            longer = log2(longer) * (_ONE - across)
            detail[i + j] = min(_mip(log2(size) + longer + fine - _SHARPER), last)
        for j in range(_N):
            slope_x[i + j] = s[_OUT + j]
        for j in range(_N):
            slope_y[i + j] = s[_OUT + _PAGE + j]
        for j in range(_N):
            s[_ANGLE + j] = s[_OUT + 2 * _PAGE + j] / s[_OUT + 3 * _PAGE + j]
            s[_SIZE + j] = radius
        if smooth:
            # A pixel shows the mean of its light. Angles may jump from one occluder to the next,
            # but not between those where light changes; very near ones are part of the relief.
            for j in range(_N):
                away, wide = s[_OUT + 3 * _PAGE + j], s[_TURN + j]
                most = wide / away if away > _FOUR * wide else _ZERO
                s[_MOST + j] = most
                s[_ANGLE + j] = min(max(s[_ANGLE + j], -radius - most), radius + most)
            for j in range(_N // 2):
                a = s[_ANGLE + 2 * j + 1] - s[_ANGLE + 2 * j]
                s[_WEIGHT + 2 * j], s[_WEIGHT + 2 * j + 1] = a, a
            for j in range(_N // 2):
                a = s[_ANGLE + _N // 2 + j] - s[_ANGLE + j]
                s[_U + j], s[_U + _N // 2 + j] = a, a
            for j in range(_N):
                a, b = s[_WEIGHT + j], s[_U + j]
                s[_SIZE + j] = radius + _HALF * min(np.sqrt(a * a + b * b), s[_MOST + j])
        # Clearances make a crisp edge, but their mean is none: coarser mip levels of the finest
        # grid are of visibility.
        for j in range(_N):
            seen, last_channel = disc(s[_ANGLE + j], s[_SIZE + j]), s[_REACH + j]
            mean = seen + min(s[_COARSE + j], _ONE) * (last_channel - seen)
            s[_MATTER + j] = seen * (_ONE - last_channel) if s[_LAYER + j] > _ZERO else mean
        for j in range(_N):
            lit[i + j] = s[_MATTER + j]
