"""What several loops over pixels compute: compiled into each of them."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import inlined

CHUNK, COLUMNS = 128, 64    # pixels that a loop takes at a time: columns of two rows
# Numbers in a page of scratch memory: at a power of two pages push each other out of the cache.
PAGE = 144
# Counts of pixels begin with it: for a plain 0, Numba compiles all that takes the count once more.
NO_PIXELS = np.int64(0)

_ZERO, _HALF, _ONE, _FIVE = (np.float32(x) for x in (0.0, 0.5, 1.0, 5.0))
_DISC, _CUBE, _TINY = (np.float32(x) for x in (0.6366, 0.1366, 1e-6))
_OF_HALF = np.float32(2.0 ** 112)
# Of a map of the shape of the relief: steps of 1/2**17 m and 1/2**12.
_HEIGHTS, _STEEPS, _MIDDLE, _MOST = (np.float32(x) for x in (131072.0, 4096.0, 32768.0, 65535.0))


@inlined
def any_positive(values, start):  # type: ignore[no-untyped-def]
    """Return whether a chunk that begins at `start` has a number above 0."""
    count = 0
    for j in range(start, start + CHUNK):
        count += values[j] > _ZERO
    return count > 0


@inlined
def byte(word):  # type: ignore[no-untyped-def]
    """Return the lowest byte of a word."""
    return np.float32(np.int32(word & np.uint32(255)))


@inlined
def of_half(bits):  # type: ignore[no-untyped-def]
    """Return the number that the low 16 bits are as float16."""
    wide = ((bits & np.uint32(0x7fff)) << np.uint32(13)) | ((bits & np.uint32(0x8000))
                                                            << np.uint32(16))
    return np.uint32(wide).view(np.float32) * _OF_HALF


@inlined
def disc(angle, radius):  # type: ignore[no-untyped-def]
    """Return the share of a disc above a horizon that lies `angle` below its centre; error < 0.01.
    """
    x = min(max(angle / radius, -_ONE), _ONE)
    return _HALF + x * (_DISC - _CUBE * x * x)


@inlined
def wrapped(place, n, offset):  # type: ignore[no-untyped-def]
    """Return the texel before a place along a map that wraps around, the one after it, the share.

    Args:
        place: Over the extent of the map.
        n: Texels along it.
        offset: From a texel's first edge to where it is read, in texels.
    """
    # A division of whole numbers takes longer.
    u = (place - np.floor(place)) * np.float32(n) - offset
    column = np.floor(u)
    i = np.int64(column)
    i += n * (i < 0) - n * (i >= n)
    return i, (i + 1) * (i + 1 < n), u - column


@inlined
def shape_share(x, y, reach):  # type: ignore[no-untyped-def]
    """Return how far the relief has shape, 1 to 0, at a place from the middle of all cameras."""
    return min(max(_FIVE - _FIVE * np.sqrt(x * x + y * y) / max(reach, _TINY), _ZERO), _ONE)


@inlined
def packed_shape(height, steep):  # type: ignore[no-untyped-def]
    """Return a texel of a map of the shape of the relief: height [m], bound of the slopes around.
    """
    low = np.rint(min(max(height * _HEIGHTS + _MIDDLE, _ZERO), _MOST))
    high = np.rint(min(steep * _STEEPS, _MOST))
    return np.uint32(np.int32(low)) | (np.uint32(np.int32(high)) << np.uint32(16))


@inlined
def shape_at(x, y, shape, scale):  # type: ignore[no-untyped-def]
    """Return height and bound of the slopes around, of an (n, m) map that wraps around.

    Args:
        shape: Texels as `packed_shape` has them in the first n columns.
        scale: 1 / its extent [1/m].
    """
    n = len(shape)
    i, east, u = wrapped(x * scale, n, _HALF)
    j, north, v = wrapped(y * scale, n, _HALF)
    a, b, c, d = shape[j, i], shape[j, east], shape[north, i], shape[north, east]
    low, high = _low_word(a), _low_word(c)
    low += u * (_low_word(b) - low)
    high += u * (_low_word(d) - high)
    steep_low, steep_high = _high_word(a), _high_word(c)
    steep_low += u * (_high_word(b) - steep_low)
    steep_high += u * (_high_word(d) - steep_high)
    return ((low + v * (high - low) - _MIDDLE) / _HEIGHTS,
            (steep_low + v * (steep_high - steep_low)) / _STEEPS)


@inlined
def _low_word(word):  # type: ignore[no-untyped-def]
    return np.float32(np.int32(word & np.uint32(0xffff)))


@inlined
def _high_word(word):  # type: ignore[no-untyped-def]
    return np.float32(np.int32(word >> np.uint32(16)))
