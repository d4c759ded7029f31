"""The shape of the relief below the grid near the cameras: a map that wraps around.

Depth is found by a ray's steps over these heights, and all that follows from depth sees one
ground. A block is filled in when it comes into view; blocks far apart share a place.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.image.rendering.projection import ViewVolume
from lunar_rover_sim.image.rendering.relief_rows import shape_of_block
from lunar_rover_sim.image.rendering.relief_tiles import FINER
from lunar_rover_sim.image.rendering.surface import Surface

F32 = NDArray[np.float32]

_TEXEL_M = 1.0 / 320.0      # that of the coarse tile
_BLOCK = 80                # texels along a side
_BLOCK_M = _BLOCK * _TEXEL_M
_BLOCKS = 22                # of the map, along a side: twice the most of `detail.relief_shape_m`
_BESIDE = 16                # texels: rows of an odd number of cache lines, for the cache's sake
_LIFT_M = 1.0               # most that ground within reach is above or below that at the camera


class ReliefShape(NamedTuple):
    """The map, and how compiled loops read it.

    Attributes:
        shape: As for `ground.cast`.
        numbers: `relief` there.
        reach_m: Distance up to which relief has shape.
    """

    shape: NDArray[np.uint32]
    numbers: F32
    reach_m: float


NO_RELIEF = ReliefShape(np.zeros((0, 0), np.uint32), np.ones(3, np.float32), 0.0)


class ReliefMap:
    """The map of heights, and what brings it up to date.

    Attributes:
        shape: For compiled loops.
    """

    def __init__(self, surface: Surface, reach_m: float) -> None:
        """Allocate the map, before `enter`; surface: has the tiles."""
        self._surface = surface
        tiles = surface.tiles
        side = _BLOCK * _BLOCKS
        # Texels of the fine tile are smaller than those of the map.
        self._tiles = [np.stack([_halved(part, times) for part in (tile.heights, tile.rises)],
                                axis=-1)
                       for tile, times in ((tiles.coarse, 0), (tiles.fine, FINER))]
        most_m = float(tiles.coarse.heights.max() + tiles.fine.heights.max())
        self.shape = ReliefShape(np.zeros((side, side + _BESIDE), np.uint32), np.array(
            [1.0 / (_BLOCKS * _BLOCK_M), most_m, 0.0], np.float32), reach_m)

    def enter(self, grid: HeightGrid) -> None:
        """Lie on the ground of another window, whose frame has another place in the site."""
        self.shape.numbers[2] = grid.half_extent_m - grid.cell_m
        self._drawn: NDArray[np.int64] = np.full((_BLOCKS, _BLOCKS, 2), np.iinfo(np.int64).max)

    def update(self, volume: ViewVolume, before: Callable[[], None]) -> None:
        """Fill in the blocks within reach that a view shows and that are not there yet.

        Args:
            before: Called before anything changes.
        """
        reach_m = self.shape.reach_m
        first = np.floor((volume.centre_m[:2] - reach_m) / _BLOCK_M).astype(np.int64)
        end = np.floor((volume.centre_m[:2] + reach_m) / _BLOCK_M).astype(np.int64) + 1
        y, x = np.mgrid[first[1]:end[1], first[0]:end[0]]
        blocks = np.stack([x.ravel(), y.ravel()], axis=-1)
        rows, columns = blocks[:, 1] % _BLOCKS, blocks[:, 0] % _BLOCKS
        stale = np.any(self._drawn[rows, columns] != blocks, axis=1)
        if not stale.any():
            return
        ground_m = volume.centre_m[2] - volume.above_m
        boxes = np.empty((len(blocks), 2, 3))
        boxes[:, 0, :2], boxes[:, 1, :2] = (blocks - 0.1) * _BLOCK_M, (blocks + 1.1) * _BLOCK_M
        boxes[:, 0, 2], boxes[:, 1, 2] = ground_m - _LIFT_M, ground_m + _LIFT_M
        new = np.flatnonzero(stale & volume.sees(boxes))
        if len(new):
            before()
            self._drawn[rows[new], columns[new]] = blocks[new]
            for block in blocks[new]:
                self._fill(block)

    def _fill(self, block: NDArray[np.int64]) -> None:
        texels = self._surface.texels
        corner = (block * _BLOCK_M).astype(np.float32)
        x, y = block % _BLOCKS * _BLOCK
        shape_of_block(corner[0], corner[1], np.float32(_TEXEL_M), texels.tile, texels.zone,
                       *texels.coarse, *self._tiles,
                       self.shape.shape[y:y + _BLOCK, x:x + _BLOCK])


def _halved(values: F32, times: int) -> F32:
    """Return the means of squares of 2**times values along a side."""
    n, side = len(values) >> times, 1 << times
    return np.asarray(values.reshape(n, side, n, side).mean(axis=(1, 3)), np.float32)
