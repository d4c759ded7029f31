"""The nest of height levels: sizes, interpolation from coarse to fine, seams without cracks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.ground.world.config import LEVEL_RATIO, WorldConfig
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.relief import smoothstep
from lunar_rover_sim.ground.world.spline import summed, weights

_RECALL = 40  # samples after which the filter has forgotten the ends: pole^40 = 1e-23
_PAD = 8     # samples added around a grid before it is filtered
FADE_CELLS = 60  # width of the band in which a level's detail fades out: 1.5 m of 2.5 cm cells


def plan(config: WorldConfig) -> list[tuple[int, float]]:
    """Return (samples, cell [m]) of each level, finest first.

    Cells grow by the level ratio until the surroundings are covered; each level is at least twice
    as wide as the one within it, and its samples include the corners of that one.
    """
    levels = [(config.samples, config.cell_m)]
    n, cell = levels[0]
    while 0.5 * (n - 1) * cell < config.surroundings.extent_m:
        least = max(config.surroundings.samples, 2 * (n - 1) // LEVEL_RATIO + 1)
        step = 2 * LEVEL_RATIO
        n, cell = -(-(least - 1) // step) * step + 1, cell * LEVEL_RATIO
        levels.append((n, cell))
    return levels


def axis_m(n: int, cell_m: float) -> NDArray[np.float64]:
    """Return the (n,) coordinates of the samples along x or y."""
    return (np.arange(n, dtype=np.float64) - 0.5 * (n - 1)) * cell_m


def spline(y_m: NDArray, x_m: NDArray, values: NDArray, y_at: NDArray,
           x_at: NDArray) -> NDArray[np.float32]:
    """Return the bicubic spline through values (y, x) at the grid of y_at and x_at.

    y_m and x_m ascend in even steps; beyond their ends the surface is extrapolated as constant,
    and at the ends its curvature is zero. Linear algebra libraries are not used, because their
    results depend on the number of threads.
    """
    padded = np.pad(np.asarray(values, np.float64), _PAD, mode='reflect', reflect_type='odd')
    across = _coefficients(padded)
    coefficients = _coefficients(np.ascontiguousarray(across.T)).T.astype(np.float32, order='C')
    return summed(coefficients, *_taps(y_m, y_at), *_taps(x_m, x_at))


def _coefficients(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the coefficients of cubic B-splines through the values along the first axis.

    The recursion of Unser et al., "B-spline signal processing: Part II", IEEE Trans. Signal
    Processing 41 (2), 1993, with mirrored ends; line by line, so that no library decides in which
    order it is summed.
    """
    pole = math.sqrt(3.0) - 2.0
    result = 6.0 * values
    last = len(result) - 1
    weight, first = 1.0, result[0].copy()
    for k in range(1, _RECALL):
        weight *= pole
        first += weight * result[last - abs(last - k % (2 * last))]
    result[0] = first
    for k in range(1, last + 1):
        result[k] += pole * result[k - 1]
    result[last] = pole / (pole * pole - 1.0) * (result[last] + pole * result[last - 1])
    for k in range(last - 1, -1, -1):
        result[k] = pole * (result[k + 1] - result[k])
    return result


def _taps(at: NDArray, to: NDArray) -> tuple[NDArray[np.int64], list[NDArray[np.float32]]]:
    """Return the first of four B-spline coefficients at each target, and the four weights."""
    step = (at[-1] - at[0]) / (len(at) - 1) if len(at) > 1 else 1.0
    place = np.clip((np.asarray(to, np.float64) - at[0]) / step, 0.0, len(at) - 1.0)
    first = np.minimum(np.floor(place), max(len(at) - 2, 0)).astype(np.int64)
    return first + _PAD - 1, weights(place - first)


def fade(n: int) -> NDArray[np.float32]:
    """Return the (n,) weight of a level's detail along one axis: 0 at the border, 1 within."""
    edge = np.minimum(np.arange(n), np.arange(n)[::-1])
    return smoothstep(edge / min(FADE_CELLS, (n - 1) / 4)).astype(np.float32)


def fit_border(heights: NDArray[np.float32], cell_m: float, parent: HeightGrid) -> None:
    """Fade a level into its parent's triangulated surface, which it equals at its border."""
    n = heights.shape[0]
    band = min(FADE_CELLS, (n - 1) // 4) + 1
    axis = axis_m(n, cell_m)
    weight = fade(n)
    for rows, columns in ((slice(0, band), slice(0, n)), (slice(n - band, n), slice(0, n)),
                          (slice(band, n - band), slice(0, band)),
                          (slice(band, n - band), slice(n - band, n))):
        xy = np.stack(np.meshgrid(axis[columns], axis[rows]), axis=-1)
        coarse = parent.height_at(xy)
        w = weight[rows, None] * weight[columns]
        heights[rows, columns] = coarse + w * (heights[rows, columns] - coarse)


def close_seam(heights: NDArray[np.float32], cell_m: float, parent: HeightGrid) -> None:
    """Set the outermost samples to the parent's triangulated surface; in place."""
    axis = axis_m(heights.shape[0], cell_m)
    for edge in (0, -1):
        heights[edge] = parent.height_at(np.stack([axis, np.full_like(axis, axis[edge])], -1))
        heights[:, edge] = parent.height_at(np.stack([np.full_like(axis, axis[edge]), axis], -1))


def embed(parent: NDArray[np.float32], child: NDArray[np.float32]) -> None:
    """Put a finer level's heights into the parent's samples strictly within it; in place."""
    inner = child[::LEVEL_RATIO, ::LEVEL_RATIO]
    start = (parent.shape[0] - inner.shape[0]) // 2
    stop = start + inner.shape[0]
    parent[start + 1:stop - 1, start + 1:stop - 1] = inner[1:-1, 1:-1]
