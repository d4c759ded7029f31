"""The world that rays are cast on, as arrays that compiled code reads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.compiled import read_only
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz
from lunar_rover_sim.ground.regolith.overlay import CELL_M, Overlay, TILE
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.rocks import Rocks, RockShape
from lunar_rover_sim.image.lidar.ray_march import SMALL


class LevelArrays(NamedTuple):
    """One level of the world.

    Attributes:
        heights_m: (n, n) samples.
        cell_m: Between them.
        tops_m: Greatest heights of ground and rocks over all blocks.
        first: Where the blocks of a size begin.
        side: How many blocks of a size make a row.
        rock_first: (blocks + 1,) where the rocks of the smallest blocks begin in rock_list.
    """

    heights_m: NDArray[np.float32]
    cell_m: float
    tops_m: NDArray[np.float32]
    first: NDArray[np.int64]
    side: NDArray[np.int64]
    rock_first: NDArray[np.int32]
    rock_list: NDArray[np.int32]


class RockArrays(NamedTuple):
    """Rocks as convex hulls, one or several each.

    Attributes:
        position_m: (m, 3).
        radius_m: (m,) of balls around them.
        R_world_rock: (m, 3, 3).
        diameter_m: (m,).
        shape: (m,).
        planes: (p, 4) n . x = d of all pieces of shapes, of diameter 1.
        plane_first: (pieces + 1,).
        piece_first: (shapes + 1,).
    """

    position_m: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    R_world_rock: NDArray[np.float64]
    diameter_m: NDArray[np.float64]
    shape: NDArray[np.int32]
    planes: NDArray[np.float64]
    plane_first: NDArray[np.int64]
    piece_first: NDArray[np.int64]


class SoftArrays(NamedTuple):
    """Changes of the heights of the finest level, in square tiles of samples.

    Attributes:
        rise_m: (side, side) more than a smallest block has risen anywhere [m], 0 where it does not
            differ; (0, 0) where nothing does.
        slot: (tiles, tiles) number of a tile in change_m.
        corner: Tile of slot[0, 0].
        change_m: (k, tile + 1, tile + 1) [m], with the first samples of the next tiles.
        sample_m: Between samples, the first one at the origin.
    """

    rise_m: NDArray[np.float64]
    slot: NDArray[np.int32]
    corner: int
    change_m: NDArray[np.float32]
    sample_m: float


F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

_WIDTH = 1 << SMALL         # of a smallest block in cells, and of others in those before


class HeightPyramid:
    """The blocks of one grid with the rocks on it.

    Attributes:
        arrays: For rays; its tops may rise.
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


_MERGED = 1e-5              # normals and offsets of faces that count as one plane


class RockHulls:
    """The planes of all rocks.

    Args:
        rocks: The rocks of a world.

    Attributes:
        radius_m: (m,) of balls around their centroids.
        arrays: For rays.
    """

    NOWHERE_M = -1e6        # height of what is not there

    def __init__(self, rocks: Rocks, shapes: tuple[RockShape, ...]) -> None:
        self.rocks = rocks
        self._planes = [[_planes(piece) for piece in shape.convex()] for shape in shapes]
        reach = np.array([np.linalg.norm(s.vertices, axis=1).max() for s in shapes] or [1.0])
        self._R = (matrix_from_wxyz(rocks.orientation_wxyz) if len(rocks)
                   else np.zeros((0, 3, 3)))
        self.radius_m: Array = reach[rocks.shape] * rocks.diameter_m
        pieces = [planes for shape in self._planes for planes in shape]
        self.arrays = RockArrays(
            position_m=read_only(rocks.position_m, float), radius_m=self.radius_m,
            R_world_rock=np.ascontiguousarray(self._R), diameter_m=rocks.diameter_m,
            shape=read_only(rocks.shape, np.int32),
            planes=np.concatenate([np.zeros((0, 4)), *pieces]),
            plane_first=np.cumsum([0, *map(len, pieces)]),
            piece_first=np.cumsum([0, *map(len, self._planes)]))

    def tops(self, rock: int, x_m: Array, y_m: Array, half_m: float) -> Array:
        """Return an upper bound of a rock's height [m] over square cells, NOWHERE_M beside it.

        Args:
            x_m: (c,) centres of the cells.
            y_m: (r,) centres of the cells.
            half_m: Half their side; the result is (r, c).
        """
        return np.asarray(np.max([self._tops_of(planes, rock, x_m, y_m, half_m)
                                  for planes in self._planes[self.rocks.shape[rock]]], axis=0))

    def _tops_of(self, planes: Array, rock: int, x_m: Array, y_m: Array, half_m: float) -> Array:
        rocks = self.rocks
        N = planes[:, :3] @ self._R[rock].T
        D = planes[:, 3] * self.arrays.diameter_m[rock] + N @ rocks.position_m[rock]
        # Over a cell, the part of n . x that x and y can take away at most.
        slack = half_m * np.abs(N[:, :2]).sum(axis=1)
        level = (N[:, 0, None, None] * x_m + N[:, 1, None, None] * y_m[:, None])
        room = D[:, None, None] - level + slack[:, None, None]
        with np.errstate(divide='ignore', invalid='ignore'):
            height = room / N[:, 2, None, None]
        above = N[:, 2] > 1e-9
        below = N[:, 2] < -1e-9
        top = height[above].min(axis=0)
        foot = height[below].max(axis=0) if below.any() else np.full(top.shape, -np.inf)
        beside = (room[~above & ~below] < 0.0).any(axis=0) | (foot > top)
        return np.where(beside, self.NOWHERE_M, top)


def _planes(shape: RockShape) -> Array:
    """Return (p, 4) planes n . x = d of a convex shape, each once."""
    corners = shape.vertices[shape.faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    normal, corners = normal[length > 0.0] / length[length > 0.0, None], corners[length > 0.0]
    plane = np.column_stack([normal, np.einsum('ij,ij->i', normal, corners[:, 0])])
    _, first = np.unique(np.round(plane / _MERGED), axis=0, return_index=True)
    return plane[np.sort(first)]


_TILE_M = TILE * CELL_M
_FIRST_TILES = 16           # for which there is memory at first
_MARGIN_M = 1e-6            # far more than rounding, far less than matters


class SoftCells:
    """What an overlay has changed of the ground of a pyramid."""

    def __init__(self, pyramid: HeightPyramid, overlay: Overlay,
                 middle_m: ArrayLike = (0.0, 0.0)) -> None:
        """Take over what is there at the first update.

        Args:
            middle_m: (2,) of the pyramid, in the frame of the overlay, a multiple of its samples.
        """
        self._pyramid, self._overlay, self._seen = pyramid, overlay, 0
        # Samples and tiles count from the middle of the pyramid here.
        self._first = np.rint(np.asarray(middle_m) / CELL_M).astype(int)
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
            x, y = (t * TILE - int(first) for t, first in zip((tx, ty), self._first))
            # Interpolation reaches one sample beyond the tile.
            (x0, x1), (y0, y1) = (self._pyramid.blocks_between((s - 1) * CELL_M,
                                                               (s + TILE) * CELL_M)
                                  for s in (x, y))
            if not (x0 < x1 and y0 < y1):
                continue
            shown.update((i, j) for i in range((x - 1) // TILE, (x + TILE - 1) // TILE + 1)
                         for j in range((y - 1) // TILE, (y + TILE - 1) // TILE + 1))
            height, _ = self._overlay.window(tx * TILE, ty * TILE, TILE, TILE)
            rows, columns = slice(y0, y1), slice(x0, x1)
            rise, part = max(float(height.max()), 0.0), self._rise_m[rows, columns]
            np.maximum(part, rise + _MARGIN_M, out=part)
            self._pyramid.raise_ground(rows, columns, rise)
        for tx, ty in shown:
            x, y = (t * TILE + int(first) for t, first in zip((tx, ty), self._first))
            height, _ = self._overlay.window(x, y, TILE + 1, TILE + 1)
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
