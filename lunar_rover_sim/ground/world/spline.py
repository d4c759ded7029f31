"""Cubic B-splines on lattices without ends: a value depends on what is near it, and on no border.

Heights of a rectangle of a lattice are an `Area`. What is computed from areas is the same, bit by
bit, wherever they overlap: sums have a fixed order, and places are whole numbers of the lattice.
"""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.grid import Box

F32 = NDArray[np.float32]

# Of the filter that gives coefficients, on either side: its terms fall by sqrt(3) - 2 a sample,
# to 7e-10.
TAPS = 16
MARGIN = TAPS + 3       # samples that a spline needs around the rectangle where it is evaluated
_POLE = math.sqrt(3.0) - 2.0
_STRIP = 64             # rows at once


@dataclasses.dataclass(frozen=True)
class Area:
    """Values on a rectangle of a lattice.

    Attributes:
        values: (rows, columns), row 0 south.
        first: Column and row of values[0, 0] on the lattice, whose sample (0, 0) is the origin of
            the site.
        cell_m: Pitch of the lattice [m].
    """

    values: NDArray[np.floating]
    first: tuple[int, int]
    cell_m: float

    def part(self, first: tuple[int, int], shape: tuple[int, int]) -> Area:
        """Return a rectangle within this one, not copied.

        Raises:
            ValueError: If it is not within.
        """
        column, row = first[0] - self.first[0], first[1] - self.first[1]
        values = self.values[row:row + shape[0], column:column + shape[1]]
        if min(row, column) < 0 or values.shape != shape:
            raise ValueError(f'{first} {shape} is not within {self.first} {self.values.shape}')
        return Area(values, first, self.cell_m)


def extended(known: Area | None, first: tuple[int, int], shape: tuple[int, int],
             make: Callable[[tuple[int, int], tuple[int, int]], F32]) -> F32:
    """Return values on a rectangle: those of a known area where it has them; the others are made.

    Args:
        known: Of the same lattice, or None.
        make: Takes `first` and `shape` of a part.
    """
    (left, low), (rows, columns) = first, shape
    right, high = left + columns, low + rows
    if known is None:
        return make(first, shape)
    x, y = known.first
    a, b = max(left, x), min(right, x + known.values.shape[1])
    c, d = max(low, y), min(high, y + known.values.shape[0])
    if a >= b or c >= d:
        return make(first, shape)
    values = np.empty(shape, np.float32)
    values[c - low:d - low, a - left:b - left] = known.values[c - y:d - y, a - x:b - x]
    for x0, x1, y0, y1 in ((left, right, low, c), (left, right, d, high), (left, a, c, d),
                           (b, right, c, d)):
        if x0 < x1 and y0 < y1:
            values[y0 - low:y1 - low, x0 - left:x1 - left] = make((x0, y0), (y1 - y0, x1 - x0))
    return values


def box_of(first: tuple[int, int], shape: tuple[int, int], cell_m: float) -> Box:
    """Return the box from the first to the last sample of a rectangle of a lattice."""
    (x, y), (rows, columns) = first, shape
    return x * cell_m, (x + columns - 1) * cell_m, y * cell_m, (y + rows - 1) * cell_m


def _filter() -> Array:
    """Return the coefficients' filter, (TAPS + 1,) from the middle on; its sum is 1."""
    half = np.array([6.0 * -_POLE / (1.0 - _POLE * _POLE) * _POLE**k for k in range(TAPS + 1)])
    return half / (half[0] + 2.0 * half[1:].sum())


_HALF = _filter()


def coefficients(values: NDArray[np.floating]) -> Array:
    """Return the coefficients of the spline through values, without `TAPS` at each border.

    The inverse filter of Unser et al., "B-spline signal processing: Part II", IEEE Trans. Signal
    Processing 41 (2), 1993, cut off.
    """
    result = np.asarray(values, np.float64)
    for axis in (0, 1):
        size = result.shape[axis] - 2 * TAPS

        def shifted(k: int) -> Array:
            part = slice(TAPS + k, TAPS + k + size)
            return result[part] if axis == 0 else result[:, part]
        total = _HALF[0] * shifted(0)
        pair = np.empty_like(total)
        for k in range(1, TAPS + 1):
            np.add(shifted(-k), shifted(k), out=pair)
            pair *= _HALF[k]
            total += pair
        result = total
    return result


def weights(t: NDArray[np.floating]) -> list[F32]:
    """Return the four weights of a cubic B-spline at fractions t of an interval."""
    # Products, not powers: those are not rounded alike everywhere.
    back, square, cube = 1.0 - t, t * t, t * t * t
    return [w.astype(np.float32) for w in (
        back * back * back / 6.0, (4.0 - 6.0 * square + 3.0 * cube) / 6.0,
        (1.0 + 3.0 * t + 3.0 * square - 3.0 * cube) / 6.0, cube / 6.0)]


def evaluated(coefficient: NDArray[np.floating], columns: Array, rows: Array) -> F32:
    """Return the spline (len(rows), len(columns)) at places, counted in samples of coefficients.

    Args:
        coefficient: (n, m), of which one is needed below a place and two above.
        columns, rows: Ascending.
    """
    row, column = np.floor(rows).astype(np.int64), np.floor(columns).astype(np.int64)
    return summed(coefficient.astype(np.float32), row - 1, weights(rows - row), column - 1,
                  weights(columns - column))


def summed(coefficient: F32, row: NDArray[np.int64], row_weights: list[F32],
           column: NDArray[np.int64], column_weights: list[F32]) -> F32:
    """Return the weighted sums of 4 x 4 coefficients, of which the first is at a row and a column.
    """
    result = np.empty((len(row), len(column)), np.float32)
    for start in range(0, len(row), _STRIP):
        strip = slice(start, start + _STRIP)
        line = row_weights[0][strip, None] * coefficient[row[strip]]
        for k in range(1, 4):
            line += row_weights[k][strip, None] * coefficient[row[strip] + k]
        part = result[strip]
        part[:] = np.take(line, column, axis=1) * column_weights[0]
        for k in range(1, 4):
            part += np.take(line, column + k, axis=1) * column_weights[k]
    return result


def needed(first: tuple[int, int], shape: tuple[int, int],
           ratio: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return where a coarse area begins, and its shape, that `refined` needs for a fine one."""
    begin = [f // ratio - MARGIN for f in first]
    end = [(f + n - 1) // ratio + MARGIN + 1 for f, n in zip(first, shape[::-1])]
    return (begin[0], begin[1]), (end[1] - begin[1], end[0] - begin[0])


def refined(coarse: Area, first: tuple[int, int], shape: tuple[int, int], ratio: int) -> F32:
    """Return the spline through an area at the samples of a lattice that is `ratio` times finer.

    Args:
        first, shape: Of the rectangle of the finer lattice.

    Raises:
        ValueError: If the area does not hold what is `needed`.
    """
    begin, size = needed(first, shape, ratio)
    coefficient = coefficients(coarse.part(begin, size).values)
    # Fractions come from whole numbers, so that all areas give one result.
    axes = []
    for f, n, b in zip(first, shape[::-1], begin):
        place = f + np.arange(n)
        axes.append(place // ratio - b - TAPS + (place % ratio) / ratio)
    return evaluated(coefficient, *axes)
