"""Measured terrain in a world: a tile of known heights, laid into the levels.

Within the tile the world has its heights at the scale of its pixels; beyond it the procedural
terrain continues without a step.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
import scipy.ndimage
import scipy.sparse

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world import levels, spline
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.fill import plate_fill
from lunar_rover_sim.ground.world.grid import Box
from lunar_rover_sim.ground.world.spline import Area

# A level whose cell is larger than this share of a pixel takes the heights of the tile unchanged;
# a finer one adds detail to them.
REFINED_BELOW = 1.0 / 3.0
PAD_PIXELS = spline.MARGIN + 1      # that a tile has around the box asked for
_BEYOND = 3             # pixels around a tile, in which its spline is still evaluated
_INVERSE_TAPS = 6       # of the filter from means to coefficients; its terms fall by 0.36 a pixel
CORRECTION_PIXELS = _INVERSE_TAPS + 4


@dataclasses.dataclass(frozen=True)
class Tile:
    """Heights on a rectangle of pixels, without gaps.

    Pixels are counted over all of the source, so that a pixel has one number in all windows.

    Attributes:
        heights_m: (ny, nx) float32 over the source's reference height, row 0 south.
        first: Number of the first pixel, x and y.
        phase: Place of the centre of pixel 0, x and y [pixels].
        step_m: Sides of a pixel, x and y.
        filled: Whether there are pixels without data, whose heights depend on the rectangle.
    """

    heights_m: NDArray[np.float32]
    first: tuple[int, int]
    phase: tuple[float, float]
    step_m: tuple[float, float]
    filled: bool = False

    @property
    def x_m(self) -> Array:
        """(nx,) ascending pixel centres, frame of the site [m]."""
        return self.centres(0)

    @property
    def y_m(self) -> Array:
        """(ny,) ascending pixel centres, frame of the site [m]."""
        return self.centres(1)

    @property
    def pixel_m(self) -> float:
        """The larger side of a pixel."""
        return max(self.step_m)

    def centres(self, k: int) -> Array:
        """Return `x_m` (0) or `y_m` (1)."""
        number = self.first[k] + np.arange(self.heights_m.shape[1 - k])
        return np.asarray((number + self.phase[k]) * self.step_m[k])

    def place(self, k: int, first: int, count: int, cell_m: float) -> Array:
        """Return where samples of a lattice lie along x (0) or y (1), counted in pixels from the
        first; the same fractions in all windows.
        """
        whole = (np.arange(first, first + count) * cell_m) / self.step_m[k] - self.phase[k]
        floor = np.floor(whole)
        return np.asarray((floor - self.first[k]) + (whole - floor))


class Source(Protocol):
    """A source of measured heights.

    Attributes:
        reference_m: The height that is zero in the tiles.
        report: Facts for the report of the world.
    """

    reference_m: float
    report: dict[str, Any]

    @property
    def pixel_m(self) -> float:
        """Native spacing of the heights [m]."""

    @property
    def area_m(self) -> Box:
        """The area covered."""

    def check_window(self, middle_m: tuple[float, float]) -> object:
        """Raise WorldError if the fine ground around a place is not within, or lacks heights."""

    def has_data(self, x_m: NDArray[np.float64],
                 y_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return where heights at and around samples are not missing.

        Args:
            x_m, y_m: (n,) and (m,), ascending, evenly spaced.

        Returns:
            (m, n); beyond the source as at its edge.
        """

    def tile(self, box_m: Box, cell_m: float) -> Tile | None:
        """Return the heights in a box and `PAD_PIXELS` around it; None if there are none.

        Args:
            cell_m: They are averaged to about this.

        Raises:
            WorldError: If it cannot be read.
        """

    def close(self) -> None:
        """Release the file."""


def lay(ground: Area, tile: Tile) -> bool:
    """Replace heights by those of the tile within it; continue the difference beyond it; in place.

    The difference continues as a plate under tension that is clamped to the tile, so that height
    and slope are continuous, and settles over a distance of about the size of the tile. What is
    within the tile does not depend on the rest.

    Returns:
        Whether all of the ground is within the tile.
    """
    rows, columns, known = _known(ground, tile)
    if known is None:
        return False
    heights = ground.values
    within = known.shape == heights.shape
    if not within:
        difference = np.zeros_like(heights)
        difference[rows, columns] = known - heights[rows, columns]
        size_m = min(n * side for n, side in zip(tile.heights_m.shape[::-1], tile.step_m))
        heights += _lead_out(difference, _axes(ground), rows, columns, tile.pixel_m, 0.5 * size_m)
    heights[rows, columns] = known
    return within


def _known(ground: Area, tile: Tile) -> tuple[slice, slice, NDArray[np.float32] | None]:
    """Return the rows and columns within the tile, and its spline there; None if it is too small.
    """
    nothing = slice(0, 0)
    if min(tile.heights_m.shape) < 2:
        return nothing, nothing, None
    places, parts = [], []
    for k in (0, 1):
        place = tile.place(k, ground.first[k], ground.values.shape[1 - k], ground.cell_m)
        last = tile.heights_m.shape[1 - k] - 1
        inside = np.flatnonzero((place >= -1e-9) & (place <= last + 1e-9))
        if len(inside) < 2:
            return nothing, nothing, None
        parts.append(slice(int(inside[0]), int(inside[-1]) + 1))
        places.append(place[parts[k]])
    # At the ends of the source the curvature is zero; elsewhere the tile is wider than needed.
    pad = spline.TAPS + _BEYOND
    padded = np.pad(np.asarray(tile.heights_m, np.float64), pad, mode='reflect',
                    reflect_type='odd')
    known = spline.evaluated(spline.coefficients(padded), places[0] + _BEYOND,
                             places[1] + _BEYOND)
    return parts[1], parts[0], known


def _axes(ground: Area) -> tuple[Array, Array]:
    """Return the places of columns and rows [m]."""
    x, y = ((first + np.arange(count)) * ground.cell_m
            for first, count in zip(ground.first, ground.values.shape[::-1]))
    return x, y


def _lead_out(difference: NDArray, axes: tuple[Array, Array], rows: slice, columns: slice,
              pixel_m: float, length_m: float) -> NDArray[np.float32]:
    """Return a difference that is known on some rows and columns, continued over the level.

    Solved on a grid of pixels, 128 at most from the middle to the border.
    """
    cell_m = axes[0][1] - axes[0][0]
    step = max(pixel_m, max(axis[-1] - axis[0] for axis in axes) / 256.0)
    coarse, means, inside = [], [], []
    for axis, part in zip(axes, (columns, rows)):
        count = int(np.ceil(0.5 * (axis[-1] - axis[0]) / step)) + 1
        coarse.append(0.5 * (axis[0] + axis[-1]) + np.arange(-count, count + 1) * step)
        covered = np.zeros(len(axis))
        covered[part] = 1.0
        low = np.maximum(axis - cell_m / 2, coarse[-1][:, None] - step / 2)
        high = np.minimum(axis + cell_m / 2, coarse[-1][:, None] + step / 2)
        share = (np.maximum(high - low, 0.0) / step).astype(np.float32)
        means.append(scipy.sparse.csr_matrix(share))
        inside.append((share * covered).sum(axis=1))
    filled = np.outer(inside[1], inside[0])
    mean = _mean_over(difference, means[1], means[0]) / np.maximum(filled, 1e-6)
    led = plate_fill(mean.astype(np.float32), filled > 0.5, (step / max(length_m, step)) ** 2)
    return levels.spline(coarse[1], coarse[0], led, axes[1], axes[0])


def correction(ground: Area, tile: Tile) -> NDArray[np.float32]:
    """Return what to add to the heights so that their mean over each pixel is that of the tile.

    It is a smooth surface, 0 where there are no pixels. Pixels that do not lie wholly within the
    ground count as right; so do not use it within `CORRECTION_PIXELS` of the border.
    """
    nothing = np.zeros_like(ground.values)
    if min(tile.heights_m.shape) < 2:
        return nothing
    y, row_mean = _means(ground, tile, 1)
    x, column_mean = _means(ground, tile, 0)
    if len(x) < 2 or len(y) < 2:
        return nothing
    off = tile.heights_m[y[:, None], x] - _mean_over(ground.values, row_mean, column_mean)
    pad = _INVERSE_TAPS + 2
    padded = np.pad(np.asarray(off, np.float64), pad)
    for axis in (0, 1):
        padded = scipy.ndimage.convolve1d(padded, _INVERSE, axis=axis, mode='constant')
    places = [np.clip(tile.place(k, ground.first[k], ground.values.shape[1 - k], ground.cell_m)
                      - pixels[0] + pad, 1.0, len(pixels) + 2.0 * pad - 3.0)
              for k, pixels in ((0, x), (1, y))]
    return spline.evaluated(padded, *places)


def _inverse() -> Array:
    """Return the filter from means over pixels to the coefficients of a cubic B-spline.

    The mean of a cubic B-spline over a pixel is a quartic one: 230, 76 and 1 of 384.
    """
    k = 2.0 * np.pi * np.arange(256) / 256.0
    means = (230.0 + 152.0 * np.cos(k) + 2.0 * np.cos(2.0 * k)) / 384.0
    half = np.real(np.fft.ifft(1.0 / means))[:_INVERSE_TAPS + 1]
    return np.concatenate([half[:0:-1], half])


_INVERSE = _inverse()


def _mean_over(values: NDArray, rows: scipy.sparse.csr_matrix,
               columns: scipy.sparse.csr_matrix) -> NDArray[np.float32]:
    """Return the means of values over the pixels whose matrices are given."""
    return np.ascontiguousarray((columns @ np.ascontiguousarray((rows @ values).T)).T)


def _means(ground: Area, tile: Tile, k: int) -> tuple[NDArray[np.int64], scipy.sparse.csr_matrix]:
    """Return the pixels that lie wholly within the ground along x (0) or y (1).

    And the matrix of the means over them.
    """
    axis, cell_m = _axes(ground)[k], ground.cell_m
    centres, pixel = tile.centres(k), tile.step_m[k]
    whole = np.flatnonzero((centres - pixel / 2 >= axis[0] - cell_m / 2)
                           & (centres + pixel / 2 <= axis[-1] + cell_m / 2))
    low = np.maximum(axis - cell_m / 2, centres[whole, None] - pixel / 2)
    high = np.minimum(axis + cell_m / 2, centres[whole, None] + pixel / 2)
    mean = (np.maximum(high - low, 0.0) / pixel).astype(np.float32)
    return whole, scipy.sparse.csr_matrix(mean)


def below_its_scale(craters: Craters, source: Source) -> Craters:
    """Return the craters without those in the area of a source that it would resolve."""
    x_low, x_high, y_low, y_high = source.area_m
    x, y = craters.position_m.T
    apart = np.hypot(np.maximum(np.maximum(x_low - x, x - x_high), 0.0),
                     np.maximum(np.maximum(y_low - y, y - y_high), 0.0))
    return craters.select((craters.diameter_m <= source.pixel_m)
                          | (apart > 1.3 * craters.diameter_m))
