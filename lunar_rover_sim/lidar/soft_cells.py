"""Ground that the rover has changed, for rays: the samples of the overlay over the grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.lidar.height_pyramid import HeightPyramid
from lunar_rover_sim.lidar.ray_arrays import SoftArrays
from lunar_rover_sim.regolith.overlay import CELL_M, Overlay, TILE

_TILE_M = TILE * CELL_M
_FIRST_TILES = 16           # for which there is memory at first
_MARGIN_M = 1e-6            # far more than rounding, far less than matters


class SoftCells:
    """What an overlay has changed of the ground of a pyramid."""

    def __init__(self, pyramid: HeightPyramid, overlay: Overlay) -> None:
        self._pyramid, self._overlay, self._seen = pyramid, overlay, 0
        self._rise_m = np.zeros((pyramid.side, pyramid.side))
        self._corner = int(np.floor(-pyramid.grid.half_extent_m / _TILE_M)) - 2
        count = 2 * -self._corner + 1
        # Tile → its place among the samples; 0 is one without changes.
        self._slots: NDArray[np.int32] = np.zeros((count, count), np.int32)
        self._used = 1
        self._samples = np.zeros((_FIRST_TILES, TILE + 1, TILE + 1), np.float32)

    @property
    def arrays(self) -> SoftArrays:
        """The same for rays, until the next update."""
        return SoftArrays(self._rise_m, self._slots, self._corner, self._samples, CELL_M)

    @staticmethod
    def nothing() -> SoftArrays:
        """Return ground on which nothing has changed."""
        return SoftArrays(np.zeros((0, 0)), np.zeros((1, 1), np.int32), 0,
                          np.zeros((1, TILE + 1, TILE + 1), np.float32), CELL_M)

    def update(self) -> None:
        """Take over what the overlay has changed since the last call."""
        if self._overlay.writes == self._seen:
            return
        shown: set[tuple[int, int]] = set()
        for tx, ty in self._overlay.tiles_since(self._seen):
            shown.update(((tx, ty), (tx - 1, ty), (tx, ty - 1), (tx - 1, ty - 1)))
            height, _ = self._overlay.window(tx * TILE, ty * TILE, TILE, TILE)
            # Interpolation reaches one sample beyond the tile.
            (x0, x1), (y0, y1) = (self._pyramid.blocks_between((t * TILE - 1) * CELL_M,
                                                               (t + 1) * TILE * CELL_M)
                                  for t in (tx, ty))
            if x0 < x1 and y0 < y1:
                rows, columns = slice(y0, y1), slice(x0, x1)
                rise, part = max(float(height.max()), 0.0), self._rise_m[rows, columns]
                np.maximum(part, rise + _MARGIN_M, out=part)
                self._pyramid.raise_ground(rows, columns, rise)
        for tx, ty in shown:
            height, _ = self._overlay.window(tx * TILE, ty * TILE, TILE + 1, TILE + 1)
            slot = self._slot(tx - self._corner, ty - self._corner)
            self._samples[slot] = height
        self._seen = self._overlay.writes

    def _slot(self, x: int, y: int) -> int:
        """Return the place of the samples of a tile."""
        if not self._slots[y, x]:
            if self._used == len(self._samples):
                self._samples = np.concatenate([self._samples, np.zeros_like(self._samples)])
            self._slots[y, x] = self._used
            self._used += 1
        return int(self._slots[y, x])
