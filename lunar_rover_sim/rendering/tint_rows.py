"""The colour of pixels of the ground, as shaders/tint.glsl has it for rocks."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.compiled import inlined, vectorised
from lunar_rover_sim.rendering.row_math import any_positive, CHUNK, exp2, log2, PAGE

_N, _PAGE = CHUNK, PAGE
_PATCHES, _FRESH, _SUN, _LIT, _PHASE, _LOG = (k * _PAGE for k in range(6))

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
def _patch_value(x, y):  # type: ignore[no-untyped-def]
    """Return the value between the corners of a lattice, -1 to 1."""
    column, row = np.floor(x), np.floor(y)
    u, v = x - column, y - row
    i, j, one = np.int32(column), np.int32(row), np.int32(1)
    east, north = np.int32(i + one), np.int32(j + one)
    u, v = u * u * (_THREE - u - u), v * v * (_THREE - v - v)
    low, high = _corner_value(i, j), _corner_value(i, north)
    low += u * (_corner_value(east, j) - low)
    high += u * (_corner_value(east, north) - high)
    return low + v * (high - low)


@vectorised
def tint_of(depth, x, y, albedo, cos_sun, cos_lamp,  # type: ignore[no-untyped-def]
            of_sun, of_lamp, whole, soil, spread, place, lamp, red, blue):
    """Fill in red and blue over green of each pixel of a band, as `mosaic.TINT_ONE` stores them.

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
        red, blue: (n,) uint16.
    """
    s = np.empty(6 * _PAGE, np.float32)
    moved_x, moved_y = place[0], place[1]
    for c in range(len(depth) // _N):
        i = c * _N
        if not any_positive(depth, i):
            continue
        for j in range(_N):
            p, q = x[i + j] + moved_x, y[i + j] + moved_y
            s[_PATCHES + j] = _WIDE * _patch_value(p * _ACROSS, q * _ACROSS)
        for j in range(_N):
            p, q = x[i + j] + moved_x, y[i + j] + moved_y
            s[_PATCHES + j] += _NARROW * _patch_value(q * _ALONG + _MOVED, p * _ALONG + _MOVED)
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
            out = blue if n else red
            for j in range(_N):
                out[i + j] = np.uint16(np.int32(s[_LOG + j]))
