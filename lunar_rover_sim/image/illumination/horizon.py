"""Sunlit ground: boundaries of shadows over nested height grids.

This is done once per world and sun; the sun of a date moves in steps (`sun_of_date`). For every
sample of every level two numbers are kept, both measured along the central ray from the ground to
the sun:

- clearance_m: how far the ray passes above (negative: below) the relief that limits it, measured
  perpendicular to the ray;
- occluder_m: the distance to that relief.

Their quotient is the angle between the centre of the sun's disc and the horizon. Each of them
varies linearly across the edge of a shadow, so that the edge is crisp and straight between
samples. The penumbra of the disc follows from the quotient.

The shadow that falls from a point at horizontal distance t sunward reaches down to
S = h(t) - t tan e here. S obeys S(P) = max(h(P'), S(P')) - step tan e with P' one step sunward, so
one sweep away from the sun serves the whole grid. Stewart ("Fast Horizon Computation at All Points
of a Terrain With Visibility and Shading Applications", 1998) does the same per sector.
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.compiled import compiled, read_only
from lunar_rover_sim.ground.world.grid import HeightGrid

F32 = NDArray[np.float32]

# Sweeps run at the elevation of the sun and below it. The difference of their shadow heights gives
# the distance of the occluder.
_ELEVATION_OFFSETS_DEG = (-0.6, -0.3, 0.0)
_NOTHING = np.float32(-1e6)
_MAX_SWEEP_DEG = 80.0
_ROWS = 64


@dataclasses.dataclass(frozen=True)
class SunGeometry:
    """The direction to the sun, split as the sweep needs it."""

    azimuth_rad: float
    elevation_rad: float

    @classmethod
    def towards(cls, direction: ArrayLike) -> SunGeometry:
        """Return the geometry of a (3,) unit vector to the sun."""
        x, y, z = np.asarray(direction, dtype=float)
        return cls(float(np.arctan2(y, x)), float(np.arcsin(np.clip(z, -1.0, 1.0))))

    @property
    def sweep_rad(self) -> NDArray[np.float64]:
        """(3,) elevations of the sweeps; a very high sun is swept as if it stood lower."""
        top = min(self.elevation_rad, np.radians(_MAX_SWEEP_DEG))
        return top + np.radians(_ELEVATION_OFFSETS_DEG)

    @property
    def direction_xy(self) -> NDArray[np.float64]:
        """(2,) horizontal unit vector towards the sun."""
        return np.array([np.cos(self.azimuth_rad), np.sin(self.azimuth_rad)])


class ShadowLevel:
    """Shadow boundaries of one height grid.

    Attributes:
        shadow_m: (3, n, n) float32, for each sweep the height down to which the shadow of the
            relief towards the sun reaches at each sample; the sample itself casts none [m].
    """

    def __init__(self, grid: HeightGrid, sun: SunGeometry, outer: ShadowLevel | None,
                 heights_m: F32 | None = None,
                 origin_m: tuple[float, float] = (0.0, 0.0)) -> None:
        """Sweep a grid; origin_m: of its frame, in the site."""
        self.grid = grid
        self.sun = sun
        self.heights_m = grid.heights_m if heights_m is None else heights_m
        self.shadow_m = _sweep(self.heights_m, grid.cell_m, sun, outer, origin_m)

    def shadow_at(self, xy_m: ArrayLike, *, with_ground: bool = False) -> NDArray[np.floating]:
        """Return (3, ...) shadow heights [m] at (..., 2) positions, bilinear, clamped."""
        n = self.grid.n
        grid = np.asarray(xy_m, dtype=float) / self.grid.cell_m + 0.5 * (n - 1)
        grid = np.clip(grid, 0.0, n - 1.0)
        cell = np.minimum(grid.astype(int), n - 2)
        u, v = np.moveaxis(grid - cell, -1, 0)
        ix, iy = np.moveaxis(cell, -1, 0)

        def corner(dy: int, dx: int) -> NDArray[np.floating]:
            value = self.shadow_m[:, iy + dy, ix + dx]
            if with_ground:
                value = np.maximum(value, self.heights_m[iy + dy, ix + dx])
            return value
        return ((1 - v) * ((1 - u) * corner(0, 0) + u * corner(0, 1))
                + v * ((1 - u) * corner(1, 0) + u * corner(1, 1)))

    def clearance(self) -> tuple[F32, F32]:
        """Return (clearance_m, occluder_m), each (n, n) float32."""
        clearance, occluder = np.empty_like(self.heights_m), np.empty_like(self.heights_m)
        # A few rows at a time fit into the processor's cache.
        for first in range(0, len(self.heights_m), _ROWS):
            rows = slice(first, first + _ROWS)
            clearance[rows], occluder[rows] = split(self.heights_m[rows] - self.shadow_m[:, rows],
                                                    self.sun)
        return clearance, occluder

    def clearance_of(self, points_m: ArrayLike) -> tuple[F32, F32]:
        """Return (clearance_m, occluder_m) of (..., 3) points on or above the ground."""
        points = np.asarray(points_m, dtype=float)
        above = points[..., 2] - self.shadow_at(points[..., :2])
        return split(above.astype(np.float32), self.sun)


def split(above_m: F32, sun: SunGeometry) -> tuple[F32, F32]:
    """Turn (3, ...) heights above the three shadows into clearance and occluder distance [m].

    The height above the shadow is min over occluders of (h - h_t + t tan e): concave in tan e,
    with the horizontal distance t as slope, and zero where the sun would touch the horizon. The
    zero is extrapolated from the highest sweeps that are in shadow, since above it the nearest
    ground, not the horizon, limits the height.
    """
    above = np.ascontiguousarray(above_m.reshape(3, -1))
    clearance, occluder = _split(above, np.tan(sun.sweep_rad).astype(np.float32),
                                 np.float32(np.cos(sun.sweep_rad[2])),
                                 np.float32(sun.elevation_rad - sun.sweep_rad[2]))
    return clearance.reshape(above_m.shape[1:]), occluder.reshape(above_m.shape[1:])


@compiled
def _split(above_m: F32, tangent: F32, cosine: np.float32,
           lift: np.float32) -> tuple[F32, F32]:
    """Do the work of `split` for (3, m) heights; lift: angle of the sun above the sweep."""
    clearance, occluder = np.empty_like(above_m[0]), np.empty_like(above_m[0])
    fall, rise = tangent[1] - tangent[0], tangent[2] - tangent[1]
    for k in range(len(clearance)):
        low, middle, high = above_m[0, k], above_m[1, k], above_m[2, k]
        dark = high < 0.0
        away = (high - middle) / rise if dark else (middle - low) / fall
        away = min(max(away, np.float32(1e-3)), np.float32(5e4))
        clear = (high if dark else middle + rise * away) * cosine
        away /= cosine
        if lift > 0.0:      # a very high sun was swept lower than it stands: add the difference
            clear += lift * away
        # Where both are huge only the quotient matters: scale them to the range of half floats.
        scale = np.float32(100.0) / max(max(abs(clear), away * np.float32(0.02)),
                                        np.float32(100.0))
        clearance[k], occluder[k] = clear * scale, away * scale
    return clearance, occluder


def shadow_levels(levels: Sequence[HeightGrid], sun: SunGeometry,
                  origin_m: tuple[float, float] = (0.0, 0.0)) -> list[ShadowLevel]:
    """Return the shadow boundaries of nested grids (finest first), outer relief included.

    Args:
        origin_m: Of the frame of the grids, in the site: all its windows are swept along the same
            lines.
    """
    result: list[ShadowLevel] = []
    outer: ShadowLevel | None = None
    for grid in reversed(levels):
        outer = ShadowLevel(grid, sun, outer, origin_m=origin_m)
        result.insert(0, outer)
    return result


def _sweep(heights_m: F32, cell_m: float, sun: SunGeometry, outer: ShadowLevel | None,
           origin_m: tuple[float, float]) -> F32:
    """Return (3, n, n) shadow heights [m]; see the description of this module.

    The grid is turned so that the sun lies towards larger rows and not towards smaller columns;
    a line towards the sun then crosses every row, `shear` columns farther each time. Lines are a
    whole column apart, so that within a row all samples have the same fractional position: that
    of the row's place in the site.
    """
    sx, sy = sun.direction_xy
    swap = abs(sx) > abs(sy)
    along, across = (sx, sy) if swap else (sy, sx)
    z = np.asarray(cv2.transpose(heights_m) if swap else heights_m)
    flip_rows, flip_columns = along < 0.0, across < 0.0
    z = z[::-1] if flip_rows else z
    z = read_only(z[:, ::-1] if flip_columns else z, np.float32)
    shear = abs(across) / abs(along)
    # Straight or diagonal but for rounding: else a ray would miss the column that it lies on.
    if min(shear, 1.0 - shear) < 1e-9:
        shear = float(round(shear))
    n = z.shape[0]
    tangent = np.tan(sun.sweep_rad).astype(np.float32)[:, None]
    drop = np.float32(cell_m * np.hypot(1.0, shear)) * tangent
    first_row = round(origin_m[1 if not swap else 0] / cell_m) * (-1 if flip_rows else 1)
    phase = shear * first_row - np.floor(shear * first_row)
    offset = int(np.ceil(shear * (n - 1) + phase))
    lines = n + offset
    current = np.full((3, lines), _NOTHING, np.float32)
    if outer is not None:
        column = np.arange(lines) - offset
        with np.errstate(divide='ignore', invalid='ignore'):
            row = np.minimum(n - 1.0, np.floor((n - 1 - column - phase) / shear) if shear > 0.0
                             else np.full(lines, n - 1.0))
        entry = np.stack([row + 1.0, column + phase + shear * (row + 1.0)],
                         axis=-1) - 0.5 * (n - 1)
        entry[:, 0] *= -1.0 if flip_rows else 1.0
        entry[:, 1] *= -1.0 if flip_columns else 1.0
        xy = (entry if swap else entry[:, ::-1]) * cell_m
        current[:] = outer.shadow_at(xy, with_ground=True)
    rows = np.arange(n)
    along = shear * rows + phase
    whole = np.floor(along).astype(np.int64)
    result = _swept(z, current, drop[:, 0], offset - whole, (along - whole).astype(np.float32))
    for k in range(3):
        shadow = result[k, ::-1] if flip_rows else result[k]
        shadow = shadow[:, ::-1] if flip_columns else shadow
        result[k] = cv2.transpose(np.ascontiguousarray(shadow)) if swap else shadow
    return result


@compiled
def _swept(z: F32, current: F32, drop: F32, first: NDArray[np.int64], fraction: F32) -> F32:
    """Return (3, n, n) shadow heights of (n, n) heights that are turned towards the sun [m].

    Args:
        current: (3, lines) shadow heights at the row beyond the last one; changed.
        drop: (3,) fall of the shadows from row to row.
        first, fraction: (n,) for each row, the line whose sample lies in the first column, and how
            far beyond its middle.
    """
    n = len(z)
    result = np.empty((3, n, n), np.float32)
    for row in range(n - 1, -1, -1):
        part, ground = fraction[row], z[row]
        between = part > np.float32(1e-6)
        for k in range(3):
            out, fall = result[k, row], drop[k]
            line = current[k, first[row]:first[row] + n - int(between)]
            for j in range(len(line)):
                line[j] -= fall
            if between:
                out[0], out[n - 1] = line[0], line[n - 2]
                for j in range(1, n - 1):
                    out[j] = line[j] + part * (line[j - 1] - line[j])
                for j in range(n - 1):
                    line[j] = max(line[j], ground[j] + part * (ground[j + 1] - ground[j]))
            else:
                for j in range(n):
                    out[j] = line[j]
                    line[j] = max(line[j], ground[j])
    return result
