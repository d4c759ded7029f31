"""How far rays may advance over the ground without meeting it: a pyramid of heights.

Level k has blocks of 2^k x 2^k cells. It holds the greatest height, of ground and rocks, and the
least, of the ground, over a block and the eight around it: from anywhere in the block a ray may
advance by the side of a block in x and in y, as long as it stays above the one; below the other
one it has met the ground. After Tevs, Ihrke and Seidel, "Maximum mipmaps for fast, accurate, and
scalable dynamic height field rendering", I3D 2008, whose blocks have no neighbours.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.lidar.rock_hulls import RockHulls
from lunar_rover_sim.world.grid import HeightGrid

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

_LEAST_BLOCKS = 4           # along the side of the coarsest level
_AROUND = np.ones((3, 3), np.uint8)


class HeightPyramid:
    """The pyramid of one grid with the rocks on it.

    Bounds are pairs: greatest height, and the negative of the least height [m].

    bounds: (m, 2) of all levels; first: where each level begins; stride: entries of its rows
    cells: (n - 1, n - 1, 2) bounds of each cell alone
    rock_list: rocks by cell; rock_first: (cells + 1,) where those of a cell begin. A rock is
        listed in each cell that it stands over.
    """

    def __init__(self, grid: HeightGrid, hulls: RockHulls) -> None:
        self.grid = grid
        # A plain array: one that is mapped from a file takes ten times as long to index.
        self.heights_m = z = np.asarray(grid.heights_m)
        both = np.stack([z, -z], axis=-1)
        self.cells: F32 = np.maximum(np.maximum(both[:-1, :-1], both[1:, :-1]),
                                     np.maximum(both[:-1, 1:], both[1:, 1:]))
        self._list_rocks(hulls)
        sides = [grid.n - 1]
        while sides[-1] > _LEAST_BLOCKS:
            sides.append(-(-sides[-1] // 2))
        # One more row and column: rounding may put a ray on the far edge of the grid.
        self.stride: I32 = np.array(sides, np.int32) + 1
        sizes = self.stride.astype(np.int64) ** 2
        self.first: I32 = (np.cumsum(sizes) - sizes).astype(np.int32)
        self.bounds: F32 = np.empty((int(sizes.sum()), 2), np.float32)
        self._blocks = [self.cells]
        for side in sides[1:]:
            self._blocks.append(_halved(self._blocks[-1], side, side))
        for k, blocks in enumerate(self._blocks):
            level = self._level(k)
            level[:-1, :-1] = cv2.dilate(blocks, _AROUND)
            level[-1], level[:, -1] = level[-2], level[:, -2]

    @property
    def levels(self) -> int:
        """Number of levels."""
        return len(self.stride)

    def level_for(self, reach_m: Array) -> NDArray[np.int64]:
        """Return the finest levels whose blocks are at least so wide [m]."""
        level = np.ceil(np.log2(reach_m / self.grid.cell_m)).astype(np.int64)
        return np.clip(level, 0, self.levels - 1)

    def heights_around(self, x_m: Array, y_m: Array, level: NDArray[np.int64]) -> tuple[F32, F32]:
        """Return greatest and least heights [m] at least one block of a level around places."""
        half, cell = self.grid.half_extent_m, self.grid.cell_m
        ix = ((x_m + half) / cell).astype(np.int64) >> level
        iy = ((y_m + half) / cell).astype(np.int64) >> level
        found = self.bounds.take(self.first[level] + iy * self.stride[level] + ix, axis=0)
        return found[..., 0], -found[..., 1]

    def widen(self, x0: int, y0: int, x1: int, y1: int, rise_m: float, fall_m: float) -> None:
        """Widen the bounds of the cells from (x0, y0) to before (x1, y1).

        rise_m, fall_m: by how much the surface may now be above and below what it was [m]
        """
        self.cells[y0:y1, x0:x1] += np.array([rise_m, fall_m], np.float32)
        for k, blocks in enumerate(self._blocks):
            if k:
                x0, y0, x1, y1 = x0 // 2, y0 // 2, -(-x1 // 2), -(-y1 // 2)
                below = self._blocks[k - 1][2 * y0:2 * y1, 2 * x0:2 * x1]
                blocks[y0:y1, x0:x1] = _halved(below, y1 - y0, x1 - x0)
            side = len(blocks)
            a, b, c, d = max(x0 - 1, 0), min(x1 + 1, side), max(y0 - 1, 0), min(y1 + 1, side)
            e, f = max(a - 1, 0), max(c - 1, 0)
            grown = cv2.dilate(np.ascontiguousarray(blocks[f:d + 1, e:b + 1]), _AROUND)
            self._level(k)[c:d, a:b] = grown[c - f:d - f, a - e:b - e]

    def _level(self, k: int) -> F32:
        side = int(self.stride[k])
        return self.bounds[self.first[k]:self.first[k] + side * side].reshape(side, side, 2)

    def _list_rocks(self, hulls: RockHulls) -> None:
        """List the rocks by cell, and raise the bounds of the cells to their tops."""
        cell, half, n = self.grid.cell_m, self.grid.half_extent_m, self.grid.n - 1
        index: list[NDArray[np.int64]] = []
        rock: list[NDArray[np.int64]] = []
        place, reach = hulls.rocks.position_m, hulls.radius_m
        low = np.clip(np.floor((place[:, :2] - reach[:, None] + half) / cell), 0, n).astype(int)
        high = np.clip(np.floor((place[:, :2] + reach[:, None] + half) / cell) + 1, 0,
                       n).astype(int)
        for r in np.flatnonzero((low < high).all(axis=1)):
            (x0, y0), (x1, y1) = low[r], high[r]
            tops = hulls.tops(int(r), (np.arange(x0, x1) + 0.5) * cell - half,
                              (np.arange(y0, y1) + 0.5) * cell - half, 0.5 * cell)
            part = self.cells[y0:y1, x0:x1, 0]
            # Where the ground is above a rock everywhere in a cell, no ray meets the rock.
            over = tops > -self.cells[y0:y1, x0:x1, 1]
            np.maximum(part, tops, out=part, where=over)
            jy, jx = np.nonzero(over)
            index.append((jy + y0) * n + jx + x0)
            rock.append(np.full(len(jy), r))
        listed = np.concatenate(index) if index else np.zeros(0, np.int64)
        order = np.argsort(listed, kind='stable')
        self.rock_list = (np.concatenate(rock)[order] if rock
                          else np.zeros(0, np.int64)).astype(np.int32)
        self.rock_first: I32 = np.searchsorted(listed[order], np.arange(n * n + 1)
                                               ).astype(np.int32)


def _halved(blocks: F32, rows: int, columns: int) -> F32:
    """Return the greatest values of every 2 x 2 blocks."""
    even = np.full((2 * rows, 2 * columns, 2), -np.inf, np.float32)
    even[:blocks.shape[0], :blocks.shape[1]] = blocks
    across = np.maximum(even[:, ::2], even[:, 1::2])
    result: F32 = np.maximum(across[::2], across[1::2])
    return result
