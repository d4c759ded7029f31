"""Rays on ground that the rover has changed: the samples of the overlay over the grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.lidar.height_pyramid import HeightPyramid
from lunar_rover_sim.regolith.overlay import CELL_M, Overlay, TILE

_TILE_M = TILE * CELL_M
_STEP_M = 0.5 * CELL_M      # between the places at which a ray is compared with the ground
_HALVINGS = 4               # of what lies between two such places, before it is taken as straight
_ROUND_M = 0.01             # bounds of heights are widened by whole steps, so that this is rare


class SoftCells:
    """The cells that an overlay has changed, and where rays meet them.

    touched: (n - 1, n - 1) whether a cell of the grid is changed
    """

    def __init__(self, pyramid: HeightPyramid, overlay: Overlay) -> None:
        self._pyramid, self._overlay, self._seen = pyramid, overlay, 0
        n = pyramid.grid.n
        self.touched: NDArray[np.bool_] = np.zeros((n - 1, n - 1), bool)
        self._widened: dict[tuple[int, int], tuple[float, float]] = {}
        half = pyramid.grid.half_extent_m
        self._origin = int(np.floor(-half / _TILE_M)) - 1
        count = 2 * -self._origin + 1
        # Tile → its place among the samples; 0 is one without changes.
        self._slots: NDArray[np.int32] = np.zeros((count, count), np.int32)
        self._samples = np.zeros((1, TILE, TILE), np.float32)

    def update(self) -> None:
        """Take over what the overlay has changed since the last call."""
        if self._overlay.writes == self._seen:
            return
        for key in self._overlay.tiles_since(self._seen):
            height, _ = self._overlay.window(key[0] * TILE, key[1] * TILE, TILE, TILE)
            x, y = key[0] - self._origin, key[1] - self._origin
            if not self._slots[y, x]:
                self._slots[y, x] = len(self._samples)
                self._samples = np.concatenate([self._samples, np.zeros_like(self._samples[:1])])
            self._samples[self._slots[y, x]] = height
            self._widen(key, float(height.max()), float(-height.min()))
        self._seen = self._overlay.writes

    def _widen(self, key: tuple[int, int], rise_m: float, fall_m: float) -> None:
        """Make the bounds over a tile hold; interpolation reaches one sample beyond it."""
        grid = self._pyramid.grid
        low, high = ((np.array([key, key]) + [[0, 0], [1, 1]]) * TILE
                     + [[-1, -1], [0, 0]]) * CELL_M
        x0, y0 = np.clip(np.floor((low + grid.half_extent_m) / grid.cell_m), 0, grid.n - 1)
        x1, y1 = np.clip(np.ceil((high + grid.half_extent_m) / grid.cell_m), 0, grid.n - 1)
        x0, y0, x1, y1 = int(x0), int(y0), int(x1), int(y1)
        if x0 >= x1 or y0 >= y1:
            return
        self.touched[y0:y1, x0:x1] = True
        had = self._widened.get(key, (0.0, 0.0))
        need = (max(had[0], _ROUND_M * np.ceil(rise_m / _ROUND_M)),
                max(had[1], _ROUND_M * np.ceil(fall_m / _ROUND_M)))
        if need != had:
            self._pyramid.widen(x0, y0, x1, y1, need[0] - had[0], need[1] - had[1])
            self._widened[key] = need

    def heights(self, xy_m: Array) -> Array:
        """Return the heights [m] of the changed ground at (..., 2) places [m]."""
        return self._pyramid.grid.height_at(xy_m) + self._change(xy_m)

    def meet(self, o: Array, d: Array, enter: Array, leave: Array) -> tuple[Array, Array]:
        """Return where rays meet the ground between two distances each, inf where not.

        o, d: (m, 3) origins and directions; enter, leave: (m,) [m]. Also returns (m, 3) outward
        unit normals.
        """
        distance, normal = np.full(len(o), np.inf), np.zeros((len(o), 3))
        if not len(o):
            return distance, normal
        across = np.hypot(d[:, 0], d[:, 1])
        places = int(np.ceil((np.minimum(leave - enter, 1.0) * across).max() / _STEP_M)) + 2
        t = enter[:, None] + (leave - enter)[:, None] * np.linspace(0.0, 1.0, places)
        xy = o[:, None, :2] + t[..., None] * d[:, None, :2]
        gap = o[:, None, 2] + t * d[:, None, 2] - self.heights(xy)
        below = gap <= 0.0
        k = below.argmax(axis=1)
        hit = np.flatnonzero(below.any(axis=1) & ((k > 0) | (gap[:, 0] > -_STEP_M)))
        k = k[hit]
        before = np.maximum(k - 1, 0)
        g0, g1, t0, t1 = gap[hit, before], gap[hit, k], t[hit, before], t[hit, k]
        for _ in range(_HALVINGS):
            t2 = 0.5 * (t0 + t1)
            g2 = o[hit, 2] + t2 * d[hit, 2] - self.heights(o[hit, :2] + t2[:, None] * d[hit, :2])
            under = g2 <= 0.0
            t0, g0 = np.where(under, t0, t2), np.where(under, g0, g2)
            t1, g1 = np.where(under, t2, t1), np.where(under, g2, g1)
        share = np.where(g0 > g1, np.clip(g0, 0.0, None) / np.maximum(g0 - g1, 1e-12), 0.0)
        distance[hit] = np.where(k > 0, t0 + share * (t1 - t0), t1)
        spot = o[hit, :2] + distance[hit, None] * d[hit, :2]
        slopes = [(self.heights(spot + e) - self.heights(spot - e)) / (2.0 * _STEP_M)
                  for e in (np.array([_STEP_M, 0.0]), np.array([0.0, _STEP_M]))]
        n = np.stack([-slopes[0], -slopes[1], np.ones(len(hit))], axis=-1)
        normal[hit] = np.nan_to_num(n / np.linalg.norm(n, axis=1, keepdims=True))
        return distance, normal

    def _change(self, xy_m: Array) -> Array:
        """Return the height change [m], bilinear between samples."""
        place = np.asarray(xy_m, float) / CELL_M
        low = np.floor(place)
        u, v = np.moveaxis(place - low, -1, 0)
        ix, iy = np.moveaxis(low.astype(np.int64), -1, 0)
        result = np.zeros(u.shape)
        last = len(self._slots) - 1
        for i, j, weight in ((0, 0, (1 - u) * (1 - v)), (1, 0, u * (1 - v)),
                             (0, 1, (1 - u) * v), (1, 1, u * v)):
            tx, jx = np.divmod(ix + i, TILE)
            ty, jy = np.divmod(iy + j, TILE)
            slot = self._slots[np.clip(ty - self._origin, 0, last),
                               np.clip(tx - self._origin, 0, last)]
            result += weight * self._samples[slot, jy, jx]
        return result
