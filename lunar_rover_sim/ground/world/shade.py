"""Shading of height grids for maps: sunlight with cast shadows, slope, horizon."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
import scipy.ndimage

from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks


def shaded(heights_m: NDArray[np.float32], cell_m: float, azimuth_deg: float,
           elevation_deg: float) -> NDArray[np.float32]:
    """Return brightness 0..1 of a height grid seen from above, row 0 south.

    The reflectance is Lommel-Seeliger, and a point sun casts the shadows. Slopes that face the sun
    at twice its elevation are white.
    """
    sun = sun_direction(azimuth_deg, elevation_deg)
    dy, dx = np.gradient(heights_m, cell_m)
    cosine = (sun[2] - sun[0] * dx - sun[1] * dy) / np.sqrt(1.0 + dx * dx + dy * dy)
    cosine = np.clip(cosine, 0.0, None)
    lit = cosine / (cosine + 1.0)
    lit[shadow(heights_m, cell_m, azimuth_deg, elevation_deg)] = 0.0
    white = np.sin(np.radians(min(max(3.0 * elevation_deg, 10.0), 90.0)))
    return np.clip(lit * (white + 1.0) / white, 0.0, 1.0).astype(np.float32)


def shadow(heights_m: NDArray[np.float32], cell_m: float, azimuth_deg: float,
           elevation_deg: float) -> NDArray[np.bool_]:
    """Return where the relief hides a point sun."""
    return line_of_sight(heights_m, cell_m, azimuth_deg, elevation_deg) > heights_m


def line_of_sight(heights_m: NDArray[np.float32], cell_m: float, azimuth_deg: float,
                  elevation_deg: float, from_cells: float = 1.0) -> NDArray[np.float32]:
    """Return the height up to which relief hides a point sun, at each sample [m].

    The highest line of sight towards the sun is found over distances that double each time.

    Args:
        from_cells: Relief that is nearer is left out.
    """
    azimuth, rise = np.radians(azimuth_deg), np.tan(np.radians(elevation_deg)) * cell_m
    towards = np.array([np.sin(azimuth), np.cos(azimuth)])  # rows north, columns east
    nothing = float(heights_m.min()) - 1e6
    heights = np.asarray(heights_m, np.float32)
    reach = 1.0
    highest = scipy.ndimage.shift(heights, -towards * from_cells, order=1,
                                  cval=nothing) - from_cells * rise
    while reach < max(heights.shape):
        further = scipy.ndimage.shift(highest, -towards * reach, order=1, cval=nothing)
        np.maximum(highest, further - reach * rise, out=highest)
        reach *= 2.0
    return np.asarray(highest, np.float32)


def slope_deg(heights_m: NDArray[np.float32], cell_m: float) -> NDArray[np.float32]:
    """Return the slope [deg] at each sample."""
    dy, dx = np.gradient(heights_m, cell_m)
    return np.degrees(np.arctan(np.hypot(dx, dy))).astype(np.float32)


def rms_slope_deg(grid: HeightGrid, baseline_m: float) -> float:
    """Return the RMS slope [deg] over a baseline, along x and y."""
    lag = max(round(baseline_m / grid.cell_m), 1)
    h = grid.heights_m
    squared = 0.5 * (np.mean((h[:, lag:] - h[:, :-lag]) ** 2, dtype=float)
                     + np.mean((h[lag:] - h[:-lag]) ** 2, dtype=float))
    return float(np.degrees(np.arctan(np.sqrt(squared) / (lag * grid.cell_m))))


def with_rocks(world: World, stride: int = 1) -> NDArray[np.float32]:
    """Return the ground's heights, every `stride`-th sample, with rocks as domes upon it."""
    heights = np.array(world.ground.heights_m[::stride, ::stride])
    cell = world.ground.cell_m * stride
    first = np.array(world.ground.middle_m) / cell - 0.5 * (heights.shape[0] - 1)
    add_domes(heights, cell, first, world.rocks)
    return heights


def add_domes(heights_m: NDArray[np.float32], cell_m: float, first: ArrayLike,
              rocks: Rocks) -> None:
    """Raise heights where rocks lie on them, as domes; in place.

    Args:
        first: (2,) place of the sample [0, 0], x and y [cells].
    """
    position = rocks.position_m[:, :2] / cell_m - np.asarray(first, float)
    for (x0, y0), z, diameter in zip(position, rocks.position_m[:, 2], rocks.diameter_m):
        radius = 0.5 * diameter / cell_m
        if radius < 0.5:
            continue
        rows = slice(max(int(np.ceil(y0 - radius)), 0), max(int(y0 + radius) + 1, 0))
        columns = slice(max(int(np.ceil(x0 - radius)), 0), max(int(x0 + radius) + 1, 0))
        patch = heights_m[rows, columns]
        dy = (np.arange(rows.start, rows.start + patch.shape[0]) - y0) / radius
        dx = (np.arange(columns.start, columns.start + patch.shape[1]) - x0) / radius
        dome = np.sqrt(np.clip(1.0 - dx * dx - (dy * dy)[:, None], 0.0, None))
        top = z + 0.38 * diameter * dome
        patch[:] = np.where((dome > 0.0) & (top > patch), top, patch)


def horizon_deg(world: World, azimuth_deg: ArrayLike,
                height_m: float = 0.3) -> NDArray[np.float64]:
    """Return the elevation [deg] of the horizon, without rocks, seen from above the origin.

    Args:
        azimuth_deg: (n,) from east towards north.
        height_m: Of the viewpoint above the ground.
    """
    azimuth = np.radians(np.atleast_1d(np.asarray(azimuth_deg, float)))
    distance = np.geomspace(0.5, world.levels[-1].half_extent_m, 1500)
    along = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    height = world.height_at(along[:, None] * distance[:, None])
    viewpoint = float(world.height_at((0.0, 0.0))) + height_m
    return np.degrees(np.arctan(np.max((height - viewpoint) / distance, axis=1)))
