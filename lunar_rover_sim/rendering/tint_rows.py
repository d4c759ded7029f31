"""The colour of pixels of the ground, as shaders/tint.glsl has it for rocks."""

from __future__ import annotations

import math

import numpy as np

from lunar_rover_sim.compiled import compiled

_ONE, _THREE = np.float32(1.0), np.float32(3.0)
_ACROSS, _ALONG = np.float32(1.0 / 23.0), np.float32(1.0 / 5.0)
_MOVED, _WIDE, _NARROW = np.float32(7.5), np.float32(1.92), np.float32(1.33)


@compiled
def _corner_value(i, j):  # type: ignore[no-untyped-def]
    """Return the random value of a corner of a lattice, -1 to 1."""
    h = np.uint32(np.uint32(i) * np.uint32(0x9e3779b9) + np.uint32(j) * np.uint32(0x85ebca6b))
    h = np.uint32(np.uint32(h ^ (h >> np.uint32(15))) * np.uint32(0x846ca68b))
    return np.float32((h ^ (h >> np.uint32(16))) & np.uint32(0xffff)) * np.float32(
        2.0 / 65535.0) - _ONE


@compiled
def _patch_value(x, y):  # type: ignore[no-untyped-def]
    """Return the value between the corners of a lattice, -1 to 1."""
    column, row = np.floor(x), np.floor(y)
    u, v = x - column, y - row
    i, j = np.int32(column), np.int32(row)
    u, v = u * u * (_THREE - u - u), v * v * (_THREE - v - v)
    one = np.int32(1)
    low, high = _corner_value(i, j), _corner_value(i, j + one)
    low += u * (_corner_value(i + one, j) - low)
    high += u * (_corner_value(i + one, j + one) - high)
    return low + v * (high - low)


@compiled
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
    for k in range(len(depth)):
        if depth[k] <= 0.0:
            continue
        p, q = x[k] + place[0], y[k] + place[1]
        patches = _WIDE * _patch_value(p * _ACROSS, q * _ACROSS) + _NARROW * _patch_value(
            q * _ALONG + _MOVED, p * _ALONG + _MOVED)
        fresh = math.log(max(albedo[k], 0.2))
        light = max(whole[k], 1e-9)
        sun, lit = of_sun[k] / light, of_lamp[k] / light
        direct = sun + lit
        cosine = (cos_sun[k] * sun + cos_lamp[k] * lit) / max(direct, 1e-3)
        phase = math.sqrt(max(0.5 - 0.5 * cosine, 0.0)) - 0.258819
        for n in range(2):
            log = (soil[n] + spread[n] * patches + spread[2 + n] * fresh
                   + soil[2 + n] * phase * direct + soil[n] * (1.0 - direct) + lamp[n] * lit)
            code = np.uint16(min(max(65535.0 * 0.25 * math.exp(log), 0.0), 65535.0) + 0.5)
            if n:
                blue[k] = code
            else:
                red[k] = code
