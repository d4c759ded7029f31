"""What several loops over pixels compute: compiled into each of them."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.compiled import inlined

CHUNK, COLUMNS = 128, 64    # pixels that a loop takes at a time: columns of two rows
# Numbers in a page of scratch memory: at a power of two pages push each other out of the cache.
PAGE = 144

_ZERO, _HALF, _ONE, _FIVE = (np.float32(x) for x in (0.0, 0.5, 1.0, 5.0))
_DISC, _CUBE, _TINY = (np.float32(x) for x in (0.6366, 0.1366, 1e-6))
_OF_HALF = np.float32(2.0 ** 112)
_L1, _L2, _L3, _L4, _L5, _L6 = (np.float32(x) for x in (
    1.44253477, -0.7180334, 0.45715712, -0.27733943, 0.12147073, -0.02579153))
_MANTISSA, _UNIT, _BIAS = np.int32(0x7fffff), np.int32(0x3f800000), np.int32(127)


@inlined
def any_positive(values, start):  # type: ignore[no-untyped-def]
    """Return whether a chunk that begins at `start` has a number above 0."""
    count = 0
    for j in range(start, start + CHUNK):
        count += values[j] > _ZERO
    return count > 0


@inlined
def grid_cell(x, y, lattice):  # type: ignore[no-untyped-def]
    """Return column and row of the cell of the finest grid around a place, and its place in it.

    lattice: 1 / cell [1/m], half and last whole index of cells.
    """
    u, v = x * lattice[0] + lattice[1], y * lattice[0] + lattice[1]
    column = min(max(np.floor(u), _ZERO), lattice[2])
    row = min(max(np.floor(v), _ZERO), lattice[2])
    return np.int64(column), np.int64(row), u - column, v - row


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
def log2(value):  # type: ignore[no-untyped-def]
    """Return the logarithm of a positive number; error < 3e-6."""
    bits = np.float32(value).view(np.int32)
    m = np.int32((bits & _MANTISSA) | _UNIT).view(np.float32) - _ONE
    whole = np.float32((bits >> np.int32(23)) - _BIAS)
    return whole + m * (_L1 + m * (_L2 + m * (_L3 + m * (_L4 + m * (_L5 + m * _L6)))))


@inlined
def disc(angle, radius):  # type: ignore[no-untyped-def]
    """Return the share of a disc above a horizon that lies `angle` below its centre; error < 0.01.
    """
    x = min(max(angle / radius, -_ONE), _ONE)
    return _HALF + x * (_DISC - _CUBE * x * x)


@inlined
def shape_share(x, y, reach):  # type: ignore[no-untyped-def]
    """Return how far the relief has shape, 1 to 0, at a place from the middle of all cameras."""
    return min(max(_FIVE - _FIVE * np.sqrt(x * x + y * y) / max(reach, _TINY), _ZERO), _ONE)


@inlined
def shape_at(x, y, shape, scale):  # type: ignore[no-untyped-def]
    """Return height and bound of the slopes around, of an (n, n, 2) map that wraps around.

    scale: 1 / its extent [1/m].
    """
    n = len(shape)
    u, v = x * scale * np.float32(n) - _HALF, y * scale * np.float32(n) - _HALF
    column, row = np.floor(u), np.floor(v)
    u, v = u - column, v - row
    i, j = np.int64(column) % n, np.int64(row) % n
    east, north = (i + 1) % n, (j + 1) % n
    low = shape[j, i, 0] + u * (shape[j, east, 0] - shape[j, i, 0])
    high = shape[north, i, 0] + u * (shape[north, east, 0] - shape[north, i, 0])
    steep_low = shape[j, i, 1] + u * (shape[j, east, 1] - shape[j, i, 1])
    steep_high = shape[north, i, 1] + u * (shape[north, east, 1] - shape[north, i, 1])
    return low + v * (high - low), steep_low + v * (steep_high - steep_low)
