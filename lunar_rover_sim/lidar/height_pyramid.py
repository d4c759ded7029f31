"""The greatest heights over blocks of ground, small and large ones: where rays may pass over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.compiled import read_only
from lunar_rover_sim.lidar.ray_arrays import LevelArrays
from lunar_rover_sim.lidar.ray_march import SMALL
from lunar_rover_sim.lidar.rock_hulls import RockHulls
from lunar_rover_sim.world.grid import HeightGrid

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

_WIDTH = 1 << SMALL         # of a smallest block in cells, and of others in those before


class HeightPyramid:
    """The blocks of one grid with the rocks on it.

    arrays: for rays; its tops may rise
    """

    def __init__(self, grid: HeightGrid, hulls: RockHulls) -> None:
        self.grid = grid
        self._ground_m = _greatest(_greatest_of_cells(np.asarray(grid.heights_m)))
        blocks = self._ground_m.copy()
        rock_first, rock_list = self._list_rocks(hulls, blocks)
        levels = [blocks]
        while len(levels) < 2 or len(levels[-1]) > 1:
            levels.append(_greatest(levels[-1]))
        side = np.array([len(level) for level in levels])
        self.arrays = LevelArrays(
            read_only(grid.heights_m, np.float32), float(grid.cell_m),
            np.concatenate([level.ravel() for level in levels]),
            np.cumsum(side * side) - side * side, side, rock_first, rock_list)

    @property
    def side(self) -> int:
        """Number of smallest blocks along a side."""
        return len(self._ground_m)

    @property
    def block_m(self) -> float:
        """Width of the smallest blocks [m]."""
        return _WIDTH * self.grid.cell_m

    def blocks_between(self, low_m: float, high_m: float) -> tuple[int, int]:
        """Return the first block between two coordinates [m], and the one after the last."""
        low, high = ((m + self.grid.half_extent_m) / self.block_m for m in (low_m, high_m))
        return max(int(np.floor(low)), 0), min(int(np.floor(high)) + 1, self.side)

    def raise_ground(self, rows: slice, columns: slice, rise_m: float) -> None:
        """Let tops hold for ground that is at most so much higher [m] than it was, over blocks."""
        top = self._ground_m[rows, columns] + np.float32(rise_m)
        x0, x1, y0, y1 = columns.start, columns.stop, rows.start, rows.stop
        for first, side in zip(self.arrays.first.tolist(), self.arrays.side.tolist()):
            tops = self.arrays.tops_m[first:first + side * side].reshape(side, side)
            part = tops[y0:y1, x0:x1]
            np.maximum(part, top, out=part)
            top = top.max()
            x0, x1, y0, y1 = x0 // _WIDTH, -(-x1 // _WIDTH), y0 // _WIDTH, -(-y1 // _WIDTH)

    def _list_rocks(self, hulls: RockHulls, blocks: F32) -> tuple[I32, I32]:
        """Raise blocks to the tops of rocks; return where the rocks of each begin, and rocks."""
        index = [np.zeros(0, np.int64)]
        rock = [np.zeros(0, np.int32)]
        half_m, block_m = self.grid.half_extent_m, self.block_m
        centre_m = np.linspace(0.5, self.side - 0.5, self.side) * block_m - half_m
        place, reach = hulls.rocks.position_m, hulls.radius_m
        for r in np.flatnonzero(np.abs(place[:, :2]).max(axis=1) - reach < half_m):
            (x0, x1), (y0, y1) = (self.blocks_between(middle - reach[r], middle + reach[r])
                                  for middle in place[r, :2])
            tops = hulls.tops(int(r), centre_m[x0:x1], centre_m[y0:y1], 0.5 * block_m)
            part = blocks[y0:y1, x0:x1]
            np.maximum(part, tops, out=part)
            jy, jx = np.nonzero(tops > hulls.NOWHERE_M)
            index.append((jy + y0) * self.side + jx + x0)
            rock.append(np.full(len(jy), r, np.int32))
        listed = np.concatenate(index)
        order = np.argsort(listed, kind='stable')
        first = np.searchsorted(listed[order], np.arange(self.side * self.side + 1))
        return first.astype(np.int32), np.concatenate(rock)[order]


def _greatest_of_cells(z: F32) -> F32:
    """Return the greatest heights of the corners of cells."""
    rows = np.maximum(z[:-1], z[1:])
    cells: F32 = np.maximum(rows[:, :-1], rows[:, 1:])
    return cells


def _greatest(blocks: F32) -> F32:
    """Return the greatest values of every _WIDTH x _WIDTH blocks."""
    side = -(-len(blocks) // _WIDTH)
    even = np.full((side * _WIDTH, side * _WIDTH), -np.inf, np.float32)
    even[:len(blocks), :len(blocks)] = blocks
    greatest: F32 = even.reshape(side, _WIDTH, side, _WIDTH).max(axis=(1, 3))
    return greatest
