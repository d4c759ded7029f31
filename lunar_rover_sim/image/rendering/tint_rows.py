"""The colour of pixels of the ground, as shaders/tint.glsl has it for rocks."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import inlined, vectorised
from lunar_rover_sim.base.fast_math import exp2, log2
from lunar_rover_sim.image.rendering.row_math import any_positive, CHUNK, PAGE

_N, _PAGE = CHUNK, PAGE
_PATCHES, _FRESH, _SUN, _LIT, _PHASE, _LOG, _RED, _X, _Y = (k * _PAGE for k in range(9))

_ZERO, _HALF, _ONE, _THREE = (np.float32(x) for x in (0.0, 0.5, 1.0, 3.0))
_ACROSS, _ALONG = np.float32(1.0 / 23.0), np.float32(1.0 / 5.0)
_MOVED, _WIDE, _NARROW = np.float32(7.5), np.float32(1.92), np.float32(1.33)
_DARKEST, _LEAST, _LEAST_SHARE = (np.float32(x) for x in (0.2, 1e-9, 1e-3))
_LOG_2, _PER_LOG, _AT_30_DEG = (np.float32(x) for x in (np.log(2.0), 1.0 / np.log(2.0), 0.258819))
_CODES, _QUARTER = np.float32(65535.0), np.float32(0.25 * 65535.0)


@inlined
def _corner_value(i, j):  # type: ignore[no-untyped-def]
    """Return the random value of a corner of a lattice, -1 to 1."""
    h = np.uint32(np.uint32(i) * np.uint32(0x9e3779b9) + np.uint32(j) * np.uint32(0x85ebca6b))
    h = np.uint32(np.uint32(h ^ (h >> np.uint32(15))) * np.uint32(0x846ca68b))
    bits = np.int32((h ^ (h >> np.uint32(16))) & np.uint32(0xffff))
    return np.float32(bits) * np.float32(2.0 / 65535.0) - _ONE


@inlined
def _add_patches(s, share):  # type: ignore[no-untyped-def]
    """Add the values between the corners of a lattice, -1 to 1, times a share.

    Args:
        s: Scratch memory; the places of pixels in the lattice are in two pages.
    """
    # Most chunks lie within one cell, whose corners are computed once.
    i, j = np.floor(s[_X]), np.floor(s[_Y])
    others = 0
    for c in range(_N):
        others += (np.floor(s[_X + c]) != i) + (np.floor(s[_Y + c]) != j)
    if others == 0:
        column, row, one = np.int32(i), np.int32(j), np.int32(1)
        east, north = np.int32(column + one), np.int32(row + one)
        sw, se = _corner_value(column, row), _corner_value(east, row)
        nw, ne = _corner_value(column, north), _corner_value(east, north)
        for c in range(_N):
            u, v = s[_X + c] - i, s[_Y + c] - j
            u, v = u * u * (_THREE - u - u), v * v * (_THREE - v - v)
            low, high = sw + u * (se - sw), nw + u * (ne - nw)
            s[_PATCHES + c] += share * (low + v * (high - low))
        return
    for c in range(_N):
        i, j = np.floor(s[_X + c]), np.floor(s[_Y + c])
        u, v = s[_X + c] - i, s[_Y + c] - j
        column, row, one = np.int32(i), np.int32(j), np.int32(1)
        east, north = np.int32(column + one), np.int32(row + one)
        u, v = u * u * (_THREE - u - u), v * v * (_THREE - v - v)
        low, high = _corner_value(column, row), _corner_value(column, north)
        low += u * (_corner_value(east, row) - low)
        high += u * (_corner_value(east, north) - high)
        s[_PATCHES + c] += share * (low + v * (high - low))


@vectorised
def tint_of(depth, x, y, albedo, cos_sun, cos_lamp,  # type: ignore[no-untyped-def]
            of_sun, of_lamp, whole, soil, spread, place, lamp, words):
    """Fill in red and blue over green of each pixel of a band, as `sensor.Tint`.

    Titanium and iron vary in patches of metres to tens of metres; fresh soil, which is brighter,
    is less red. What has been reflected by the ground before has its colour, too.

    Args:
        depth, x, y, albedo: (n,) as other loops fill them in.
        cos_sun, cos_lamp: (n,) cosines of the phase angles.
        of_sun, of_lamp, whole: (n,) radiance of the sun, of the lamp, of all.
        soil: Logarithms at 30 deg of phase, and their slopes (colours.py).
        spread: Of the patches; change with the logarithm of albedo.
        place: Where the patches of this world lie [m].
        lamp: Light of the lamp over that of the sun, logarithms.
        words: (n,) uint32.
    """
    s = np.empty(9 * _PAGE, np.float32)
    moved_x, moved_y = place[0], place[1]
    for c in range(len(depth) // _N):
        i = c * _N
        if not any_positive(depth, i):
            continue
        for j in range(_N):
            s[_PATCHES + j] = _ZERO
            s[_X + j], s[_Y + j] = (x[i + j] + moved_x) * _ACROSS, (y[i + j] + moved_y) * _ACROSS
        _add_patches(s, _WIDE)
        for j in range(_N):
            s[_X + j], s[_Y + j] = ((y[i + j] + moved_y) * _ALONG + _MOVED,
                                    (x[i + j] + moved_x) * _ALONG + _MOVED)
        _add_patches(s, _NARROW)
        for j in range(_N):
            s[_FRESH + j] = _LOG_2 * log2(max(albedo[i + j], _DARKEST))
        for j in range(_N):
            light = max(whole[i + j], _LEAST)
            s[_SUN + j], s[_LIT + j] = of_sun[i + j] / light, of_lamp[i + j] / light
        for j in range(_N):
            sun, lit = s[_SUN + j], s[_LIT + j]
            cosine = (cos_sun[i + j] * sun + cos_lamp[i + j] * lit) / max(sun + lit, _LEAST_SHARE)
            s[_PHASE + j] = np.sqrt(max(_HALF - _HALF * cosine, _ZERO)) - _AT_30_DEG
        for n in range(2):
            own, slope, light = soil[n], soil[2 + n], lamp[n]
            patch, fresh = spread[n], spread[2 + n]
            for j in range(_N):
                direct = s[_SUN + j] + s[_LIT + j]
                s[_LOG + j] = (own + patch * s[_PATCHES + j] + fresh * s[_FRESH + j]
                               + slope * s[_PHASE + j] * direct + own * (_ONE - direct)
                               + light * s[_LIT + j])
            for j in range(_N):
                code = _QUARTER * exp2(_PER_LOG * s[_LOG + j])
                s[_LOG + j] = min(max(code, _ZERO), _CODES) + _HALF
            if n == 0:
                for j in range(_N):
                    s[_RED + j] = s[_LOG + j]
        for j in range(_N):
            words[i + j] = (np.uint32(np.int32(s[_RED + j]))
                            | np.uint32(np.uint32(np.int32(s[_LOG + j])) << np.uint32(16)))
