"""Chunks of the ground to draw, of the nested height grids, finer near the camera.

A chunk is 8 x 8 cells of stride 1, 2, 4 ... samples. With distance its vertices move onto the
mesh of the next stride (as in CDLOD: Strugar, "Continuous Distance-Dependent Level of Detail for
Rendering Heightmaps", 2009), so that nothing pops and neighbours meet. Up to `full_resolution_m`
the mesh is the surface that physics collides with, to the triangle. Chunks at a change of stride
have a skirt, which hides the gaps that rounding leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.compiled import compiled
from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.projection import ViewVolume
from lunar_rover_sim.world.grid import HeightGrid

CHUNK = 8               # cells along a side of a chunk
_NEAR_CELL_M = 0.05
_FIRST_SIDE = 16        # the choice of chunks begins with this many of them along a side
_ROUNDING_M = 1e-3


@dataclasses.dataclass(frozen=True)
class Selection:
    """Chunks to draw, nearest first.

    Attributes:
        chunks: (m, 4) first column, first row, stride, and the distance that the stride is used up
            to [m].
        boxes: (m, 2, 3) least and greatest coordinates of each chunk, world frame [m].
        skirts: (s, 4) like chunks, one row for each side of a chunk that may adjoin another mesh;
            the number of the side, 0 to 3, is the fraction of the stride, in quarters.
        rims: (s,) index of the chunk that each skirt belongs to.
    """

    chunks: Array
    boxes: Array
    skirts: Array
    rims: NDArray[np.int64]

    def within(self, volume: ViewVolume) -> Selection:
        """Return what of it is in a view from the same place."""
        seen = volume.sees(self.boxes)
        kept = seen[self.rims]
        new = np.cumsum(seen) - 1
        return Selection(self.chunks[seen], self.boxes[seen], self.skirts[kept],
                         new[self.rims[kept]])


class ChunkTree:
    """Chooses the chunks of one height grid.

    Attributes:
        inner_half_m: Half extent of the finer grid that covers the middle of this one; 0 for none
            [m].
    """

    def __init__(self, grid: HeightGrid, inner_half_m: float) -> None:
        self.cell_m = grid.cell_m
        self.n = grid.n
        self.inner_half_m = inner_half_m
        low, high = (_chunks(grid.heights_m, merge) for merge in (np.minimum, np.maximum))
        bounds = [(low, high)]
        while len(low) > 1:
            low, high = _blocks(low, 2, np.minimum), _blocks(high, 2, np.maximum)
            bounds.append((low, high))
        # Of all strides, one after the other: chunks along a side; least and greatest heights.
        self._sides = np.array([len(low) for low, _ in bounds])
        self._low, self._high = (np.concatenate([pair[k].ravel() for pair in bounds])
                                 for k in range(2))

    @property
    def aligned(self) -> bool:
        """Whether the finer grid ends at the edges of chunks, or there is none."""
        edge = 0.5 * (self.n - 1) - self.inner_half_m / self.cell_m
        return self.inner_half_m == 0.0 or abs(edge / CHUNK - round(edge / CHUNK)) < 1e-6

    @property
    def depth(self) -> int:
        """Number of strides: 1, 2, 4 ..."""
        return len(self._sides)

    def select(self, volume: ViewVolume, ranges_m: NDArray[np.float64]) -> Selection:
        """Choose the chunks for a view.

        Args:
            ranges_m: (depth,) distance up to which each stride is fine enough, increasing [m].
        """
        found, skirts, rims = _select(
            self._first_stride(volume, ranges_m), self._sides, self._low, self._high, self.n,
            self.cell_m, self.inner_half_m, np.array([*volume.centre_m, volume.above_m]),
            volume.planes, ranges_m)
        return Selection(found[:, :4], found[:, 4:10].reshape(-1, 2, 3), skirts, rims)

    def _first_stride(self, volume: ViewVolume, ranges_m: NDArray[np.float64]) -> int:
        """Return the index of the coarsest stride of which any chunk could be kept."""
        half = 0.5 * (self.n - 1) * self.cell_m
        farthest = np.hypot(*(np.abs(volume.centre_m[:2]) + half)) + volume.above_m
        k = self.depth - 1
        while k and self._sides[k] < _FIRST_SIDE and ranges_m[k - 1] > farthest:
            k -= 1
        return k


@compiled
def _select(k, sides, low, high, n, cell,  # type: ignore[no-untyped-def]
            inner, view, planes, ranges):
    """Return (m, 11) chunks, boxes and squared distance, nearest first, then skirts and rims.

    They are those of `Selection`. k: the first stride; view: its centre and height; the rest as in
    `ChunkTree`
    """
    # Horizontal distances are compared, squared: the height is subtracted from the ranges.
    over, half_n = view[3]**2, 0.5 * (n - 1)
    outer, none = half_n * cell - _ROUNDING_M, 0
    found, count = np.empty((512, 11)), 0
    skirts, rims, edges = np.empty((512, 4)), np.empty(512, np.int64), 0
    places = np.empty((sides[k]**2, 2), np.int64)
    for f in range(len(places)):
        places[f, 0], places[f, 1] = f // sides[k], f % sides[k]
    middle, half, least, most = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    while k >= 0:
        side, stride, base, first = sides[k], 1 << k, (sides[:k]**2).sum(), count
        finer = ranges[k - 1] if k else 0.0
        limit = ranges[k] if k < len(sides) - 1 else 1e9
        margin = 1.5 * CHUNK * stride * cell
        taken = np.zeros((side + 2, side + 2), np.bool_)
        other = np.zeros(len(places), np.bool_)
        following, coming = np.empty((4 * len(places), 2), np.int64), 0
        for f in range(len(places)):
            row, column = places[f]
            for axis, index in ((0, column), (1, row)):
                start = CHUNK * stride * index
                least[axis] = (start - half_n) * cell
                most[axis] = (min(start + CHUNK * stride, n - 1) - half_n) * cell
            least[2], most[2] = low[base + row * side + column], high[base + row * side + column]
            for axis in range(3):
                middle[axis] = 0.5 * (least[axis] + most[axis]) - view[axis]
                half[axis] = 0.5 * (most[axis] - least[axis])
            seen = inner == 0.0 or min(least[0], least[1]) < -inner or max(most[0],
                                                                           most[1]) > inner
            for p in range(len(planes) if seen else none):
                reach = planes[p, 3]
                for axis in range(3):
                    reach += middle[axis] * planes[p, axis] + half[axis] * abs(planes[p, axis])
                seen = seen and reach >= 0.0
            if not seen:
                continue
            nearest = farthest = 0.0
            for axis in range(2):
                nearest += max(abs(middle[axis]) - half[axis], 0.0)**2
                farthest += (abs(middle[axis]) + half[axis])**2
            into = inner - max(least[0], least[1], -most[0], -most[1])     # the finer grid
            if nearest < finer**2 - over or (inner > 0.0 and k and into > 0.0):
                for part in range(4):
                    below, right = 2 * row + part // 2, 2 * column + part % 2
                    if max(below, right) < sides[max(k - 1, 0)]:
                        following[coming, 0], following[coming, 1] = below, right
                        coming += 1
                continue
            # Both sides of a change of stride or of grid have skirts: rounding may lift either
            # edge above the other.
            other[count - first] = (
                farthest > (0.98 * limit)**2 - over or (inner > 0.0 and into > -_ROUNDING_M)
                or min(least[0], least[1]) < -outer or max(most[0], most[1]) > outer
                or (k and nearest < (finer + margin)**2 - over))
            if count == len(found):
                found = np.concatenate((found, found))
            found[count, 0], found[count, 1] = column * CHUNK * stride, row * CHUNK * stride
            found[count, 2], found[count, 3] = stride, limit
            found[count, 4:7], found[count, 7:10], found[count, 10] = least, most, nearest
            taken[row + 1, column + 1] = True
            count += 1
        for part in range(4):
            dx, dy = ((-1, 0), (1, 0), (0, -1), (0, 1))[part]
            for f in range(first, count):
                column, row = int(found[f, 0]) // (CHUNK * stride), int(found[f, 1]) // (
                    CHUNK * stride)
                if other[f - first] and not taken[row + dy + 1, column + dx + 1]:
                    if edges == len(rims):
                        skirts, rims = np.concatenate((skirts, skirts)), np.concatenate((rims,
                                                                                         rims))
                    skirts[edges], rims[edges] = found[f, :4], f
                    skirts[edges, 2] += 0.25 * part
                    edges += 1
        k -= 1
        places = following[:coming]
    order = np.argsort(found[:count, 10], kind='mergesort')
    place = np.empty(count, np.int64)
    place[order] = np.arange(count)
    return found[order], skirts[:edges], place[rims[:edges]]


def _chunks(z: NDArray[np.float32], merge: np.ufunc) -> NDArray[np.float32]:
    """Merge the samples of each chunk, including those that it shares with its neighbours."""
    return _strips(_strips(z, merge).T, merge).T


def _strips(z: NDArray[np.float32], merge: np.ufunc) -> NDArray[np.float32]:
    # Whole rows are merged at once: reductions along rows of 16 take twenty times as long.
    last = len(z) - 1
    return np.array([merge.reduce(z[k:min(k + CHUNK, last) + 1], axis=0)
                     for k in range(0, last, CHUNK)])


def _blocks(z: NDArray[np.float32], size: int, merge: np.ufunc) -> NDArray[np.float32]:
    count = -(-z.shape[0] // size)
    pad = count * size - z.shape[0]
    if pad:
        z = np.pad(z, ((0, pad), (0, pad)), mode='edge')
    return merge.reduce(merge.reduce(z.reshape(count, size, count, size), axis=3), axis=1)


def level_ranges(trees: Sequence[ChunkTree], detail: DetailConfig) -> list[Array]:
    """Return, for each tree, the (depth,) distances up to which its strides are used [m]."""
    cells = [tree.cell_m * 2.0**np.arange(tree.depth) for tree in trees]
    every = np.unique(np.round(np.concatenate(cells), 9)).astype(np.float64)
    reach = ranges(every, detail.full_resolution_m, detail.cells_per_distance)
    return [np.interp(c, every, reach) for c in cells]


def ranges(cells_m: NDArray[np.float64], full_resolution_m: float,
           cells_per_distance: float) -> NDArray[np.float64]:
    """Return the distance up to which each cell size is used [m].

    The finest is used up to `full_resolution_m`. A coarser one is used up to `cells_per_distance`
    times its cell, and less than that for large cells, but at least 1.3 times as far as the next
    finer one.
    """
    result = np.empty(len(cells_m))
    for k, cell in enumerate(cells_m):
        reach = cell * cells_per_distance * min(1.0, (cell / _NEAR_CELL_M)**-0.13)
        result[k] = max(reach, full_resolution_m if k == 0 else 1.3 * result[k - 1])
    return result
