"""Random numbers of places and of things: the same whatever else is drawn, and in which order.

Those of a place come from Philox (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3",
SC 2011), whose key is the seed with the purpose, and whose counter is the place. Those of a thing
come from its own key, by a mixing function (SplitMix64; Steele et al., OOPSLA 2014).
"""

from __future__ import annotations

from collections.abc import Callable
import functools
import hashlib

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array

KEY_BITS = 52           # of the key of a thing: double precision holds it
_NORMAL_TERMS = 12      # of the sum of uniform numbers that stands for a normal one
_STEP = np.uint64(0x9E3779B97F4A7C15)
_MIX = ((np.uint64(30), np.uint64(0xBF58476D1CE4E5B9)),
        (np.uint64(27), np.uint64(0x94D049BB133111EB)))

Keys = NDArray[np.uint64]


@functools.lru_cache(maxsize=256)
def _word(purpose: str) -> int:
    return int.from_bytes(hashlib.blake2b(purpose.encode(), digest_size=8).digest(), 'little')


def generator(seed: int, purpose: str, x: int, y: int) -> np.random.Generator:
    """Return the random numbers of a place.

    Args:
        seed: Of the site.
        purpose: What is drawn there; each has numbers of its own.
        x, y: Whole numbers of the place, of any sign.
    """
    key = np.array([seed & 0xFFFFFFFFFFFFFFFF, _word(purpose)], np.uint64)
    # Philox counts in the first word.
    counter = np.array([0, 0, x & 0xFFFFFFFFFFFFFFFF, y & 0xFFFFFFFFFFFFFFFF], np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=counter))


def blocks(seed: int, purpose: str, first: tuple[int, int], shape: tuple[int, int],
           side: int = 256) -> NDArray[np.float32]:
    """Return white noise, uniform in [0, 1), on a rectangle of a lattice without ends.

    Args:
        first: Column and row of the lattice at which it begins.
        shape: Rows and columns.
        side: Of the blocks that are drawn; each gives other noise.
    """
    return of_blocks(first, shape, side, lambda x, y: generator(seed, purpose, x, y).random(
        (side, side), np.float32))


def of_blocks(first: tuple[int, int], shape: tuple[int, int], side: int,
              block: Callable[[int, int], NDArray[np.float32]]) -> NDArray[np.float32]:
    """Return the values on a rectangle of a lattice that is made of square blocks.

    Args:
        first, shape: As of `blocks`.
        side: Of the blocks.
        block: Returns block (x, y), which begins at `side` times its number.
    """
    (left, low), (rows, columns) = first, shape
    values = np.empty(shape, np.float32)
    for y in range(low // side, (low + rows - 1) // side + 1):
        for x in range(left // side, (left + columns - 1) // side + 1):
            a, b = max(low, y * side), min(low + rows, (y + 1) * side)
            c, d = max(left, x * side), min(left + columns, (x + 1) * side)
            values[a - low:b - low, c - left:d - left] = block(x, y)[
                a - y * side:b - y * side, c - x * side:d - x * side]
    return values


def keys(octave: int, x: int, y: int, count: int) -> Keys:
    """Return the keys of the things of one kind on a tile, (count,) whole numbers below 2^52.

    They are mixed, so that two things of a site of a million have one key once in ten thousand
    sites.

    Args:
        octave: Number of the kind of things.
        x, y: Of the tile.
    """
    place = np.array([octave, x, y], np.int64).view(np.uint64)
    state = np.zeros((), np.uint64)
    for part in place:
        state = _mixed(state ^ part)
    found = _mixed(state ^ np.arange(count, dtype=np.uint64)) >> np.uint64(64 - KEY_BITS)
    return np.asarray(found, np.uint64)


def uniforms(of: Keys, purpose: str, count: int) -> Array:
    """Return (m, count) numbers of things, uniform in [0, 1), on all machines alike."""
    with np.errstate(over='ignore'):
        state = _mixed(np.asarray(of, np.uint64) ^ np.uint64(_word(purpose)))
        words = _mixed(state[:, None] + _STEP * np.arange(1, count + 1, dtype=np.uint64))
    return np.asarray((words >> np.uint64(11)) * 2.0**-53)


def normals(of: Keys, purpose: str, count: int) -> Array:
    """Return (m, count) numbers of things, normal to within 0.002 of their distribution.

    Each is a sum of twelve uniform ones, of variance 1, which all machines round alike.
    """
    terms = uniforms(of, purpose, count * _NORMAL_TERMS)
    total = np.zeros((len(terms), count))
    for k in range(_NORMAL_TERMS):
        total += terms[:, k * count:(k + 1) * count]
    return total - 0.5 * _NORMAL_TERMS


def _mixed(state: NDArray[np.uint64]) -> NDArray[np.uint64]:
    with np.errstate(over='ignore'):
        state = state + _STEP
        for shift, factor in _MIX:
            state = (state ^ (state >> shift)) * factor
        return state ^ (state >> np.uint64(31))
