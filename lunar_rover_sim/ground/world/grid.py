"""A square height grid, at its place in the site, with the triangles of MuJoCo."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Box = tuple[float, float, float, float]     # least and greatest x, then y, site frame [m]

_FRACTIONS = 4096.0     # of a cell, at which a sample may lie


def box_around(middle_m: tuple[float, float], half_m: float) -> Box:
    """Return the square around a place."""
    x, y = middle_m
    return x - half_m, x + half_m, y - half_m, y + half_m


def widened(box: Box, by_m: float) -> Box:
    """Return a box with a margin on all sides."""
    return box[0] - by_m, box[1] + by_m, box[2] - by_m, box[3] + by_m


@dataclasses.dataclass(frozen=True)
class HeightGrid:
    """Heights on a square grid.

    The surface is made of two triangles per cell, split along the diagonal from (ix, iy) to (ix +
    1, iy + 1). MuJoCo's height field collides with them, and the renderer draws them.

    Attributes:
        heights_m: (n, n) float32, read-only; row 0 is south (least y), column 0 west (least x):
            sample [iy, ix] lies at x = (ix - (n - 1) / 2) cell_m + middle_m[0], and y alike.
        cell_m: Distance between neighbouring samples [m].
        middle_m: Place of the middle, site frame [m]. It is a multiple of the cell, so that the
            samples of all windows of a site lie on one lattice.
    """

    heights_m: NDArray[np.float32]
    cell_m: float
    middle_m: tuple[float, float] = (0.0, 0.0)

    @property
    def n(self) -> int:
        """Samples along one side."""
        return self.heights_m.shape[0]

    @property
    def half_extent_m(self) -> float:
        """Half the side length: the grid covers [-h, h] around its middle in x and in y."""
        return 0.5 * (self.n - 1) * self.cell_m

    @property
    def box_m(self) -> Box:
        """Least and greatest x, then y, site frame [m]."""
        return box_around(self.middle_m, self.half_extent_m)

    @functools.cached_property
    def first(self) -> tuple[float, float]:
        """Place of sample [0, 0] on the lattice of the site, x and y [cells].

        Whole numbers if n is odd, and halves if it is even.
        """
        half = 0.5 * (self.n - 1)
        # Of a cell that is wider than the step of windows, the middle may be a fraction.
        x, y = (round(m / self.cell_m * _FRACTIONS) / _FRACTIONS - half for m in self.middle_m)
        return x, y

    def contains(self, xy_m: ArrayLike) -> NDArray[np.bool_]:
        """Return, for (..., 2) positions [m], site frame, whether they lie on the grid."""
        inside = np.abs(np.asarray(xy_m) - self.middle_m) <= self.half_extent_m
        return np.asarray(inside[..., 0] & inside[..., 1])

    def height_at(self, xy_m: ArrayLike) -> NDArray[np.float64]:
        """Return the height [m] of the triangulated surface at (..., 2) positions [m], site frame.

        Positions outside the grid are NaN. All grids that share samples give the same bits.
        """
        xy = np.asarray(xy_m, dtype=float)
        first = np.array(self.first)
        whole = np.floor(first)
        place = xy / self.cell_m - (first - whole)
        corner = np.floor(place)
        cell = np.clip(np.nan_to_num(corner - whole), 0, self.n - 2)
        u, v = np.moveaxis(place - (cell + whole), -1, 0)
        ix, iy = np.moveaxis(cell.astype(int), -1, 0)
        z = self.heights_m
        z00, z11 = z[iy, ix].astype(float), z[iy + 1, ix + 1].astype(float)
        # Below the diagonal the third corner is south-east, above it north-west.
        lower = u >= v
        third = np.where(lower, z[iy, ix + 1], z[iy + 1, ix]).astype(float)
        height = np.where(lower, z00 + u * (third - z00) + v * (z11 - third),
                          z00 + v * (third - z00) + u * (z11 - third))
        return np.where(self.contains(xy), height, np.nan)

    def height_at_point(self, x_m: float, y_m: float) -> float:
        """Return what `height_at` returns for one position; a fast path without arrays."""
        return height_of_triangles(x_m, y_m, self.heights_m, self.cell_m, *self.first)


def height_of_triangles(x: float, y: float, heights: NDArray[Any], cell_m: float, first_x: float,
                        first_y: float) -> float:
    """Return the height of the triangles at a position; NaN beyond them.

    Soil's law compiles it.

    Args:
        x, y: Position, site frame [m].
        first_x, first_y: `HeightGrid.first`.
    """
    last = heights.shape[0] - 1
    whole_x, whole_y = math.floor(first_x), math.floor(first_y)
    # Fractions come before the window's place is subtracted, so that all windows give one result.
    gx, gy = x / cell_m - (first_x - whole_x), y / cell_m - (first_y - whole_y)
    # Written so that NaN is outside, too.
    if not (whole_x <= gx <= whole_x + last and whole_y <= gy <= whole_y + last):
        return math.nan
    ix = min(int(math.floor(gx)) - whole_x, last - 1)
    iy = min(int(math.floor(gy)) - whole_y, last - 1)
    u, v = gx - (ix + whole_x), gy - (iy + whole_y)
    z00, z11 = float(heights[iy, ix]), float(heights[iy + 1, ix + 1])
    if u >= v:
        corner = float(heights[iy, ix + 1])
        return z00 + u * (corner - z00) + v * (z11 - corner)
    corner = float(heights[iy + 1, ix])
    return z00 + v * (corner - z00) + u * (z11 - corner)


# The slope that one lattice step makes over a cell is at most 2^-11, 0.5 mrad.
_STEPS_PER_CELL = 2.0**11
ALBEDO_STEP = 2.0**-18  # lattice of the albedo factor


def height_step_m(cell_m: float) -> float:
    """Return the lattice of the heights of a level, a power of two [m]: 2^-17 m for 2.5 cm."""
    return 2.0 ** math.floor(math.log2(cell_m)) / _STEPS_PER_CELL


def on_lattice(values: ArrayLike, step: float) -> NDArray[np.float64]:
    """Return values, rounded to multiples of a step, which is a power of two, as float64."""
    result = np.array(values, np.float64)
    round_to(result, step)
    return result


def round_to(values: NDArray[np.floating[Any]], step: float) -> None:
    """Round values to multiples of a step, which is a power of two; in place."""
    values *= 1.0 / step
    np.rint(values, out=values)
    values *= step


def significant(values: ArrayLike) -> NDArray[np.float64]:
    """Return values, rounded to the 24 significant bits of single precision, as float64."""
    return np.asarray(values, np.float64).astype(np.float32).astype(np.float64)


def part_of(x: float, y: float, reach: float, first: tuple[int, int],
            shape: tuple[int, ...]) -> tuple[slice, slice] | None:
    """Return the rows and columns of an area within reach of a place; None if there are none.

    Args:
        x, y: On the lattice of the site [cells].
        reach: In cells.
        first: Column and row on that lattice at which the area begins.
        shape: Its rows and columns.
    """
    parts = []
    for at, begin, size in ((y, first[1], shape[0]), (x, first[0], shape[1])):
        low = max(math.ceil(at - reach), begin)
        high = min(math.floor(at + reach) + 1, begin + size)
        if low >= high:
            return None
        parts.append(slice(low - begin, high - begin))
    return parts[0], parts[1]
