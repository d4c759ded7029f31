"""Heights of the untouched ground on the samples of the overlay."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.frames import Array
from lunar_rover_sim.regolith.overlay import CELL_M, pieces, TILE, TileKey
from lunar_rover_sim.world.grid import HeightGrid

MOST_TILES = 64     # tiles in the cache, 13 kB each; the prints of a rover lie on a few


def base_heights(ground: HeightGrid, ix: int, iy: int, nx: int, ny: int) -> Array:
    """Return the (ny, nx) heights [m] of the untouched ground on samples; NaN beyond it."""
    x, y = np.meshgrid((ix + np.arange(nx)) * CELL_M, (iy + np.arange(ny)) * CELL_M)
    heights: Array = ground.height_at(np.stack([x, y], axis=-1))
    return heights


class FineGround:
    """The untouched ground, which is read again and again where a rover walks."""

    def __init__(self, grid: HeightGrid) -> None:
        self._grid = grid
        self._tiles: dict[TileKey, Array] = {}

    def heights(self, ix: int, iy: int, nx: int, ny: int) -> Array:
        """Return the same as `base_heights`, from tiles in a cache."""
        heights = np.empty((ny, nx))
        for key, there, here in pieces(ix, iy, nx, ny):
            heights[here] = self._tile(key)[there]
        return heights

    def _tile(self, key: TileKey) -> Array:
        tile = self._tiles.get(key)
        if tile is None:
            if len(self._tiles) >= MOST_TILES:
                del self._tiles[next(iter(self._tiles))]
            tile = base_heights(self._grid, key[0] * TILE, key[1] * TILE, TILE, TILE)
            self._tiles[key] = tile
        return tile
