"""Measured terrain in a world: a tile of known heights, laid into the levels.

Within the tile the world has its heights at the scale of its pixels; beyond it the procedural
terrain continues without a step.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
import scipy.sparse

from lunar_rover_sim.ground.world import levels
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.fill import plate_fill
from lunar_rover_sim.ground.world.relief import smoothstep

# A level whose cell is larger than this share of a pixel takes the heights of the tile unchanged;
# a finer one adds detail to them.
REFINED_BELOW = 1.0 / 3.0


@dataclasses.dataclass(frozen=True)
class Tile:
    """Heights on a rectangle of pixels, without gaps.

    Attributes:
        heights_m: (ny, nx) float32 over the source's reference height, row 0 south.
        x_m: (nx,) ascending pixel centres, world frame.
        y_m: (ny,) ascending pixel centres, world frame.
        pixel_m: The larger side of a pixel.
    """

    heights_m: NDArray[np.float32]
    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    pixel_m: float


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
    def area_m(self) -> tuple[float, float, float, float]:
        """The area covered: x low, x high, y low, y high [m]."""

    def tile(self, half_extent_m: float, cell_m: float) -> Tile | None:
        """Return the heights in [-h, h]^2, averaged to about a cell; None if there are none.

        Raises:
            WorldError: If it cannot be read.
        """

    def close(self) -> None:
        """Release the file."""


def lay(heights: NDArray[np.float32], cell_m: float, tile: Tile, keep_m: float) -> None:
    """Replace heights by those of the tile within its area; continue the difference beyond it.

    The difference continues as a plate under tension that is clamped to the tile, so that height
    and slope are continuous, and settles over a distance of about the size of the tile. At an edge
    of the tile within the level, but outside [-keep, keep]^2, detail finer than a pixel is blended
    over several pixels.
    """
    axis = levels.axis_m(heights.shape[0], cell_m)
    rows, columns = _covered(axis, tile.y_m), _covered(axis, tile.x_m)
    if rows.stop - rows.start < 2 or columns.stop - columns.start < 2:
        return
    known = levels.spline(tile.y_m, tile.x_m, tile.heights_m, axis[rows], axis[columns])
    trust = (_trust(axis, tile.y_m, tile.pixel_m, keep_m)[:, None]
             * _trust(axis, tile.x_m, tile.pixel_m, keep_m))
    if not (trust >= 1.0).all():
        difference = np.zeros_like(heights)
        difference[rows, columns] = known - heights[rows, columns]
        size_m = min(tile.x_m[-1] - tile.x_m[0], tile.y_m[-1] - tile.y_m[0])
        heights += _lead_out(difference, axis, rows, columns, tile.pixel_m, 0.5 * size_m)
    inner = trust[rows, columns]
    heights[rows, columns] += inner * (known - heights[rows, columns])


def _lead_out(difference: NDArray, axis: NDArray, rows: slice, columns: slice, pixel_m: float,
              length_m: float) -> NDArray[np.float32]:
    """Return a difference that is known on some rows and columns, continued over the level.

    Solved on a grid of pixels, 128 at most from the middle to the border.
    """
    cell_m = axis[1] - axis[0]
    step = max(pixel_m, axis[-1] / 128.0)
    count = int(np.ceil(axis[-1] / step)) + 1
    coarse = np.arange(-count, count + 1) * step
    covered = np.zeros(len(axis))
    means, inside = [], []
    for part in (rows, columns):
        covered[:] = 0.0
        covered[part] = 1.0
        low = np.maximum(axis - cell_m / 2, coarse[:, None] - step / 2)
        high = np.minimum(axis + cell_m / 2, coarse[:, None] + step / 2)
        share = (np.maximum(high - low, 0.0) / step).astype(np.float32)
        means.append(scipy.sparse.csr_matrix(share))
        inside.append((share * covered).sum(axis=1))
    filled = np.outer(inside[0], inside[1])
    mean = _mean_over(difference, *means) / np.maximum(filled, 1e-6)
    led = plate_fill(mean.astype(np.float32), filled > 0.5, (step / max(length_m, step)) ** 2)
    return levels.spline(coarse, coarse, led, axis, axis)


def restore(heights: NDArray[np.float32], cell_m: float, tile: Tile, keep_m: float,
            rounds: int = 4) -> None:
    """Remove from the heights the change that detail has made at the scale of the tile.

    Afterwards the mean over each pixel equals its height in the tile, except where `lay` blends.
    """
    axis = levels.axis_m(heights.shape[0], cell_m)
    rows, row_mean = _means(axis, cell_m, tile.y_m)
    columns, column_mean = _means(axis, cell_m, tile.x_m)
    if len(rows) < 2 or len(columns) < 2:
        return
    y, x = tile.y_m[rows], tile.x_m[columns]
    wanted = tile.heights_m[rows[:, None], columns]
    fade = (_trust(axis, tile.y_m, tile.pixel_m, keep_m)[:, None]
            * _trust(axis, tile.x_m, tile.pixel_m, keep_m))
    for _ in range(rounds):
        off = _mean_over(heights, row_mean, column_mean) - wanted
        heights -= levels.spline(y, x, off, axis, axis) * fade


def _trust(axis: NDArray, centres: NDArray, pixel_m: float, keep_m: float) -> NDArray[np.float32]:
    """Return the weight of the tile along one axis: 1 within, falling to 0 at its edges.

    There is no fall where the tile extends beyond the axis, or its edge is too near what to keep.
    """
    weight = np.ones(len(axis))
    for inside, edge in ((axis - centres[0], -centres[0]), (centres[-1] - axis, centres[-1])):
        band = float(np.clip(edge - keep_m, 0.0, 4.0 * pixel_m))
        if edge >= axis[-1]:
            continue
        weight *= smoothstep(inside / band) if band > 0.0 else inside >= -1e-9
    return weight.astype(np.float32)


def _covered(axis: NDArray, centres: NDArray) -> slice:
    inside = np.flatnonzero((axis >= centres[0] - 1e-9) & (axis <= centres[-1] + 1e-9))
    return slice(int(inside[0]), int(inside[-1]) + 1) if len(inside) else slice(0, 0)


def _mean_over(values: NDArray, rows: scipy.sparse.csr_matrix,
               columns: scipy.sparse.csr_matrix) -> NDArray[np.float32]:
    """Return the means of values over the pixels whose matrices are given."""
    return np.ascontiguousarray((columns @ np.ascontiguousarray((rows @ values).T)).T)


def _means(axis: NDArray, cell_m: float,
           centres: NDArray) -> tuple[NDArray[np.int64], scipy.sparse.csr_matrix]:
    """Return the pixels that lie completely within the axis, and the matrix of their means."""
    pixel = centres[1] - centres[0] if len(centres) > 1 else np.inf
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
