"""Which parts of the ground are drawn: chunks of the nested height grids, finer near the camera.

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

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.projection import ViewVolume
from lunar_rover_sim.world.grid import HeightGrid

CHUNK = 8               # cells along a side of a chunk
_NEAR_CELL_M = 0.05
_FIRST_SIDE = 16        # the choice of chunks begins with this many of them along a side
_ROUNDING_M = 1e-3
_ROWS, _COLUMNS = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])    # of the parts of a chunk


@dataclasses.dataclass(frozen=True)
class Selection:
    """Chunks to draw, nearest first.

    chunks: (m, 4) first column, first row, stride, and the distance that the stride is used up
        to [m]
    boxes: (m, 2, 3) least and greatest coordinates of each chunk, world frame [m]
    skirts: (s, 4) like chunks, one row for each side of a chunk that may adjoin another mesh; the
        number of the side, 0 to 3, is the fraction of the stride, in quarters
    rims: (s,) index of the chunk that each skirt belongs to
    """

    chunks: Array
    boxes: Array
    skirts: Array
    rims: NDArray[np.int64]

    def within(self, volume: ViewVolume) -> Selection:
        """Return what of it is in a view from the same place."""
        seen = _seen(*_relative(self.boxes, volume), volume)
        kept = seen[self.rims]
        new = np.cumsum(seen) - 1
        return Selection(self.chunks[seen], self.boxes[seen], self.skirts[kept],
                         new[self.rims[kept]])


class _Stride:
    """All chunks of one stride, as far as they do not depend on the view."""

    def __init__(self, tree: ChunkTree, stride: int, low: NDArray[np.float32],
                 high: NDArray[np.float32]) -> None:
        self.stride = stride
        self.side = len(low)
        self.low, self.high = low, high
        # The following are the same along both axes.
        first = CHUNK * stride * np.arange(self.side)
        ends = np.stack([first, np.minimum(first + CHUNK * stride, tree.n - 1)])
        self.ends = (ends - 0.5 * (tree.n - 1)) * tree.cell_m
        inner, outer = tree.inner_half_m, 0.5 * (tree.n - 1) * tree.cell_m - _ROUNDING_M
        self.within = (self.ends[0] >= -inner) & (self.ends[1] <= inner)
        self.meets = (self.ends[0] < inner) & (self.ends[1] > -inner)
        self.touches = ((self.ends[0] < inner + _ROUNDING_M)
                        & (self.ends[1] > -inner - _ROUNDING_M))
        self.at_rim = (self.ends[0] < -outer) | (self.ends[1] > outer)

    def boxes(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Array:
        """Return (m, 2, 3) least and greatest coordinates of chunks, world [m]."""
        boxes = np.empty((len(rows), 2, 3))
        for end, bound in enumerate((self.low, self.high)):
            boxes[:, end, 0] = self.ends[end, columns]
            boxes[:, end, 1] = self.ends[end, rows]
            boxes[:, end, 2] = bound[rows, columns]
        return boxes

    def chunks(self, rows: NDArray[np.int64], columns: NDArray[np.int64],
               limit_m: float) -> Array:
        """Return (m, 4) chunks as in Selection; limit_m: their range."""
        chunks = np.empty((len(rows), 4))
        chunks[:, 0], chunks[:, 1] = columns * CHUNK * self.stride, rows * CHUNK * self.stride
        chunks[:, 2:] = self.stride, limit_m
        return chunks


class ChunkTree:
    """Chooses the chunks of one height grid.

    inner_half_m: half extent of the finer grid that covers the middle of this one; 0 for none [m]
    """

    def __init__(self, grid: HeightGrid, inner_half_m: float) -> None:
        self.cell_m = grid.cell_m
        self.n = grid.n
        self.inner_half_m = inner_half_m
        low, high = (_chunks(grid.heights_m, merge) for merge in (np.minimum, np.maximum))
        self._strides = [_Stride(self, 1, low, high)]
        while len(low) > 1:
            low, high = _blocks(low, 2, np.minimum), _blocks(high, 2, np.maximum)
            self._strides.append(_Stride(self, 2 * self._strides[-1].stride, low, high))

    @property
    def aligned(self) -> bool:
        """Whether the finer grid ends at the edges of chunks, or there is none."""
        edge = 0.5 * (self.n - 1) - self.inner_half_m / self.cell_m
        return self.inner_half_m == 0.0 or abs(edge / CHUNK - round(edge / CHUNK)) < 1e-6

    @property
    def depth(self) -> int:
        """Number of strides: 1, 2, 4 ..."""
        return len(self._strides)

    def select(self, volume: ViewVolume, ranges_m: NDArray[np.float64]) -> Selection:
        """Choose the chunks for a view.

        ranges_m: (depth,) distance up to which each stride is fine enough, increasing [m]
        """
        # Horizontal distances are compared, squared: the height is subtracted from the ranges.
        over = volume.above_m**2
        chunks, boxes, skirts, rims, near = [], [], [], [], []
        count = 0
        k = self._first_stride(volume, ranges_m)
        rows, columns = (a.ravel() for a in np.indices(2 * (self._strides[k].side,)))
        while k >= 0:
            level = self._strides[k]
            box = level.boxes(rows, columns)
            middle, half = _relative(box, volume)
            seen = _seen(middle, half, volume)
            if self.inner_half_m:
                seen &= ~(level.within[rows] & level.within[columns])
            rows, columns = rows[seen], columns[seen]
            away, half = np.abs(middle[seen, :2]), half[seen, :2]
            nearest = (np.maximum(away - half, 0.0)**2).sum(axis=1)
            farthest = ((away + half)**2).sum(axis=1)
            finer = ranges_m[k - 1] if k else 0.0
            keep = nearest >= finer**2 - over
            if self.inner_half_m and k:
                keep &= ~(level.meets[rows] & level.meets[columns])
            limit = ranges_m[k] if k < self.depth - 1 else 1e9
            chunk = level.chunks(rows[keep], columns[keep], limit)
            chunks.append(chunk)
            boxes.append(box[seen][keep])
            near.append(nearest[keep])
            # Both sides of a change of stride or of grid have skirts: rounding may lift either
            # edge above the other.
            other = (farthest > (0.98 * limit)**2 - over) | level.at_rim[rows] | \
                level.at_rim[columns]
            if self.inner_half_m:
                other |= level.touches[rows] & level.touches[columns]
            if k:
                margin = 1.5 * CHUNK * level.stride * self.cell_m
                other |= nearest < (finer + margin)**2 - over
            edges, of = _rims(chunk, columns[keep], rows[keep], other[keep])
            skirts.append(edges)
            rims.append(count + of)
            count += len(chunk)
            k -= 1
            rows = (2 * rows[~keep][:, None] + _ROWS).ravel()
            columns = (2 * columns[~keep][:, None] + _COLUMNS).ravel()
            inside = np.maximum(rows, columns) < self._strides[max(k, 0)].side
            rows, columns = rows[inside], columns[inside]
        order = np.argsort(np.concatenate(near), kind='stable')
        place = np.empty(count, np.int64)
        place[order] = np.arange(count)
        return Selection(np.concatenate(chunks)[order], np.concatenate(boxes)[order],
                         np.concatenate(skirts), place[np.concatenate(rims)])

    def _first_stride(self, volume: ViewVolume, ranges_m: NDArray[np.float64]) -> int:
        """Return the index of the coarsest stride of which any chunk could be kept."""
        half = 0.5 * (self.n - 1) * self.cell_m
        farthest = np.hypot(*(np.abs(volume.centre_m[:2]) + half)) + volume.above_m
        k = self.depth - 1
        while k and self._strides[k].side < _FIRST_SIDE and ranges_m[k - 1] > farthest:
            k -= 1
        return k


def _relative(boxes: Array, volume: ViewVolume) -> tuple[Array, Array]:
    """Return the middles of boxes relative to a view's centre, and their half sizes."""
    middle, half = 0.5 * (boxes[:, 0] + boxes[:, 1]), 0.5 * (boxes[:, 1] - boxes[:, 0])
    return middle - volume.centre_m, half


def _seen(middle: Array, half: Array, volume: ViewVolume) -> NDArray[np.bool_]:
    """Return which boxes may reach into a view."""
    normals, offsets = volume.planes[:, :3].T, volume.planes[:, 3]
    return np.all(middle @ normals + half @ np.abs(normals) >= -offsets, axis=1)


def _rims(chunks: Array, columns: NDArray[np.int64], rows: NDArray[np.int64],
          other: NDArray[np.bool_]) -> tuple[Array, NDArray[np.int64]]:
    """Return the skirts of chunks that may adjoin `other` meshes, and whose each is."""
    if not other.any():
        return np.empty((0, 4)), np.empty(0, np.int64)
    columns, rows = columns - columns.min() + 1, rows - rows.min() + 1
    taken = np.zeros((int(rows.max()) + 2, int(columns.max()) + 2), bool)
    taken[rows, columns] = True
    rims, of = [], []
    for side, (dx, dy) in enumerate(((-1, 0), (1, 0), (0, -1), (0, 1))):
        of.append(np.flatnonzero(other & ~taken[rows + dy, columns + dx]))
        edge = chunks[of[-1]]
        edge[:, 2] += 0.25 * side
        rims.append(edge)
    return np.concatenate(rims), np.concatenate(of)


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
