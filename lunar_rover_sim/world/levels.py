"""The nest of height levels: sizes, interpolation from coarse to fine, seams without cracks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from lunar_rover_sim.world.config import LEVEL_RATIO, WorldConfig
from lunar_rover_sim.world.grid import HeightGrid
from lunar_rover_sim.world.relief import smoothstep

_STRIP = 64  # rows interpolated at once
FADE_CELLS = 60  # width of the band in which a level's detail fades out: 1.5 m of 2.5 cm cells


def plan(config: WorldConfig) -> list[tuple[int, float]]:
    """Return (samples, cell [m]) of each level, finest first.

    Cells grow by the level ratio until the surroundings are covered; each level is at least twice
    as wide as the one within it, and its samples include the corners of that one.
    """
    levels = [(config.samples, config.cell_m)]
    while _half(*levels[-1]) < config.surroundings.extent_m:
        n, cell = levels[-1]
        least = max(config.surroundings.samples, 2 * (n - 1) // LEVEL_RATIO + 1)
        step = 2 * LEVEL_RATIO
        levels.append((-(-(least - 1) // step) * step + 1, cell * LEVEL_RATIO))
    return levels


def _half(n: int, cell_m: float) -> float:
    return 0.5 * (n - 1) * cell_m


def axis_m(n: int, cell_m: float) -> NDArray[np.float64]:
    """Return the (n,) coordinates of the samples along x or y."""
    return (np.arange(n, dtype=np.float64) - 0.5 * (n - 1)) * cell_m


def spline(y_m: NDArray, x_m: NDArray, values: NDArray, y_at: NDArray,
           x_at: NDArray) -> NDArray[np.float32]:
    """Return the bicubic spline through values (y, x) at the grid of y_at and x_at.

    Axes ascend; positions beyond the ends are extrapolated as constant.
    """
    columns = _Line(x_m, x_at)
    rows = _Line(y_m, y_at)
    coefficients = rows.solve @ np.asarray(values, np.float32) @ columns.solve.T
    result = np.empty((len(y_at), len(x_at)), np.float32)
    for start in range(0, len(y_at), _STRIP):
        strip = slice(start, start + _STRIP)
        line = sum(weight[strip, None] * coefficients[rows.first[strip] + k]
                   for k, weight in enumerate(rows.weights))
        part = result[strip]
        part[:] = 0.0
        for k, weight in enumerate(columns.weights):
            part += np.take(line, columns.first + k, axis=1) * weight
    return result


class _Line:
    """Interpolation along one axis.

    solve: (n, n) from samples to B-spline coefficients; first: (m,) the first coefficient that
    counts at each target; weights: one (m,) for it and for each that follows.
    """

    def __init__(self, at: NDArray, to: NDArray) -> None:
        at, to = np.asarray(at, np.float64), np.asarray(to, np.float64)
        degree = min(3, len(at) - 1)
        if degree < 1:
            self.solve = np.ones((1, 1), np.float32)
            self.first, self.weights = np.zeros(len(to), int), [np.ones(len(to), np.float32)]
            return
        through = make_interp_spline(at, np.eye(len(at)), k=degree)
        self.solve = through.c.astype(np.float32)
        design = BSpline.design_matrix(np.clip(to, at[0], at[-1]), through.t, degree)
        self.first = design.indices.reshape(len(to), degree + 1)[:, 0].astype(int)
        self.weights = list(design.data.reshape(len(to), degree + 1).T.astype(np.float32))


def refine(parent: HeightGrid, n: int, cell_m: float) -> NDArray[np.float32]:
    """Return the parent's heights, spline-interpolated to (n, n) samples of a finer level."""
    axis = axis_m(parent.n, parent.cell_m)
    fine = axis_m(n, cell_m)
    inside = np.flatnonzero(np.abs(axis) <= fine[-1] + 8.5 * parent.cell_m)
    part = slice(inside[0], inside[-1] + 1)
    return spline(axis[part], axis[part], parent.heights_m[part, part], fine, fine)


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
