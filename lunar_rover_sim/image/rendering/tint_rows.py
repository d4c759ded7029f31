"""The colour of pixels: of the ground, of rocks, and of the rover."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import compiled, inlined, vectorised
from lunar_rover_sim.base.fast_math import exp2, log2
from lunar_rover_sim.image.rendering.row_math import any_positive, CHUNK, PAGE

_N, _PAGE = CHUNK, PAGE
_PATCHES, _FRESH, _SUN, _LIT, _PHASE, _LOG, _RED, _X, _Y = (k * _PAGE for k in range(9))

_ZERO, _HALF, _ONE, _THREE = (np.float32(x) for x in (0.0, 0.5, 1.0, 3.0))
_ACROSS, _ALONG = np.float32(1.0 / 23.0), np.float32(1.0 / 5.0)
_MOVED, _WIDE, _NARROW = np.float32(7.5), np.float32(1.92), np.float32(1.33)
_DARKEST, _LEAST, _LEAST_SHARE = (np.float32(x) for x in (0.2, 1e-9, 1e-3))
_LOG_2, _PER_LOG, _AT_30_DEG = (np.float32(x) for x in (np.log(2.0), 1.0 / np.log(2.0), 0.258819))
_OF_FRESH = np.float32(0.4)      # of what albedo changes of soil, in rocks
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


@inlined
def _phase(of_sun, of_lamp, cos_sun, cos_lamp):  # type: ignore[no-untyped-def]
    """Return the sine of half the phase angle, over that at which colours hold.

    Args:
        of_sun, of_lamp: Shares of the light.
        cos_sun, cos_lamp: Cosines of their phase angles.
    """
    cosine = (cos_sun * of_sun + cos_lamp * of_lamp) / max(of_sun + of_lamp, _LEAST_SHARE)
    return np.sqrt(max(_HALF - _HALF * cosine, _ZERO)) - _AT_30_DEG


@inlined
def _seen(own, soil, slope, lamp, of_sun, of_lamp, phase):  # type: ignore[no-untyped-def]
    """Return the logarithm of red or blue over green of a surface with the tint `own`.

    It reddens with the phase angle. What has been reflected by the ground before has its colour,
    too.
    """
    direct = of_sun + of_lamp
    return own + slope * phase * direct + soil * (_ONE - direct) + lamp * of_lamp


@inlined
def _code(log):  # type: ignore[no-untyped-def]
    """Return a tint as it is stored, before the rest is cut off."""
    return min(max(_QUARTER * exp2(_PER_LOG * log), _ZERO), _CODES) + _HALF


@inlined
def _word(red, blue):  # type: ignore[no-untyped-def]
    """Return both codes as one number."""
    return np.uint32(np.int32(red)) | np.uint32(np.uint32(np.int32(blue)) << np.uint32(16))


@vectorised
def tint_of(at, albedo, cos_sun, cos_lamp,  # type: ignore[no-untyped-def]
            of_sun, of_lamp, whole, soil, spread, place, lamp, words):
    """Fill in red and blue over green of each pixel of a band, as `sensor.Tint`.

    Titanium and iron vary in patches of metres to tens of metres; fresh soil, which is brighter,
    is less red. What has been reflected by the ground before has its colour, too.

    Args:
        at, albedo: As other loops fill them in.
        cos_sun, cos_lamp: (n,) cosines of the phase angles.
        of_sun, of_lamp, whole: (n,) radiance of the sun, of the lamp, of all.
        soil: Logarithms at 30 deg of phase, and their slopes (colours.py).
        spread: Of the patches; change with the logarithm of albedo.
        place: Where the patches of this world lie [m].
        lamp: Light of the lamp over that of the sun, logarithms.
        words: (n,) uint32.
    """
    depth, x, y = at[0], at[1], at[2]
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
            s[_PHASE + j] = _phase(sun, lit, cos_sun[i + j], cos_lamp[i + j])
        for n in range(2):
            own, slope, light = soil[n], soil[2 + n], lamp[n]
            patch, fresh = spread[n], spread[2 + n]
            for j in range(_N):
                tint = own + patch * s[_PATCHES + j] + fresh * s[_FRESH + j]
                s[_LOG + j] = _seen(tint, own, slope, light, s[_SUN + j], s[_LIT + j],
                                    s[_PHASE + j])
            for j in range(_N):
                s[_LOG + j] = _code(s[_LOG + j])
            if n == 0:
                for j in range(_N):
                    s[_RED + j] = s[_LOG + j]
        for j in range(_N):
            words[i + j] = _word(s[_RED + j], s[_LOG + j])


@compiled
def tint_of_rocks(albedo, soil, cos_sun, cos_lamp,  # type: ignore[no-untyped-def]
                  of_sun, of_lamp, whole, rock, ground, spread, lamp, words):
    """Fill in red and blue over green of each pixel of rocks, as `sensor.Tint`.

    Args:
        albedo, soil: (n,) factor; share of soil.
        cos_sun to whole: As for `tint_of`.
        rock: Logarithms at 30 deg of phase.
        ground, spread, lamp: As `soil`, `spread` and `lamp` there.
    """
    for k in range(len(words)):
        light = max(whole[k], _LEAST)
        sun, lit = of_sun[k] / light, of_lamp[k] / light
        phase = _phase(sun, lit, cos_sun[k], cos_lamp[k])
        fresh = _OF_FRESH * _LOG_2 * log2(max(albedo[k], _DARKEST))
        red = rock[0] + soil[k] * (ground[0] - rock[0]) + spread[2] * fresh
        blue = rock[1] + soil[k] * (ground[1] - rock[1]) + spread[3] * fresh
        words[k] = _word(_code(_seen(red, ground[0], ground[2], lamp[0], sun, lit, phase)),
                         _code(_seen(blue, ground[1], ground[3], lamp[1], sun, lit, phase)))


@compiled
def tint_of_rover(numbers, parts, light, ground, lamp, words):  # type: ignore[no-untyped-def]
    """Fill in red and blue over green of each pixel of the rover, as `sensor.Tint`.

    Args:
        numbers, parts: As for `object_rows.light_rover`, which fills in `light`.
        ground, lamp: As `soil` and `lamp` of `tint_of`.
    """
    for k in range(len(words)):
        whole = max(light[0, k], _LEAST)
        own, of_ground, of_lamp = (_ONE - light[1, k] / whole, light[2, k] / whole,
                                   light[3, k] / whole)
        part = parts[numbers[k]]
        words[k] = _word(_code(part[2] * own + ground[0] * of_ground + lamp[0] * of_lamp),
                         _code(part[3] * own + ground[1] * of_ground + lamp[1] * of_lamp))
