"""The ground as GL meshes: chunks of the nested height grids, finer towards the camera.

A chunk is 8 x 8 cells of stride 1, 2, 4 ... samples. With distance its vertices move onto the
mesh of the next stride (as in Strugar's CDLOD, 2009), so that nothing pops and neighbours meet;
up to `full_resolution_m` the mesh is the surface that physics collides with, to the triangle.
Chunks at a change of stride have a skirt, which hides what rounding leaves open.
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.context import set_uniform
from lunar_rover_sim.world.grid import HeightGrid

if TYPE_CHECKING:
    import moderngl

CHUNK = 8
_NEAR_CELL_M = 0.05
_FIRST_SIDE = 16        # where the choice of chunks begins: this many of them along a side
_ROUNDING_M = 1e-3
_ROWS, _COLUMNS = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])    # of the parts of a chunk
_LOWER = 256            # added to the column of a vertex at the lower rim of a skirt


@dataclasses.dataclass(frozen=True)
class ViewVolume:
    """What decides which chunks are drawn.

    camera_m: (3,) position, world; planes: (p, 4) half-spaces, relative to the camera, that the
    view lies in: a n.x + d >= 0 for what may be seen; above_m: height above the ground
    """

    camera_m: Array
    planes: Array
    above_m: float


@dataclasses.dataclass(frozen=True)
class Selection:
    """Chunks to draw, nearest first.

    chunks: (m, 4) first column, first row, stride, range; boxes: (m, 2, 3) their least and
    greatest coordinates, world [m]; skirts: (s, 4) like chunks, for each of their sides that
    another mesh may adjoin; its number, 0 to 3, is the fraction of the stride in quarters
    """

    chunks: Array
    boxes: Array
    skirts: Array


class _Floor:
    """All chunks of one stride: what does not depend on the view."""

    def __init__(self, tree: ChunkTree, stride: int, low: NDArray[np.float32],
                 high: NDArray[np.float32]) -> None:
        self.stride = stride
        self.side = len(low)
        self.low, self.high = low, high
        # Along either axis.
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
        """Return (m, 4) chunks as in Selection."""
        chunks = np.empty((len(rows), 4))
        chunks[:, 0], chunks[:, 1] = columns * CHUNK * self.stride, rows * CHUNK * self.stride
        chunks[:, 2:] = self.stride, limit_m
        return chunks


class ChunkTree:
    """Chooses the chunks of one height grid."""

    def __init__(self, grid: HeightGrid, inner_half_m: float) -> None:
        self.cell_m = grid.cell_m
        self.n = grid.n
        self.inner_half_m = inner_half_m
        low, high = (_chunks(grid.heights_m, merge) for merge in (np.minimum, np.maximum))
        self._floors = [_Floor(self, 1, low, high)]
        while len(low) > 1:
            low, high = _blocks(low, 2, np.minimum), _blocks(high, 2, np.maximum)
            self._floors.append(_Floor(self, 2 * self._floors[-1].stride, low, high))

    @property
    def aligned(self) -> bool:
        """Whether the finer level inside this one ends where chunks end (or there is none)."""
        edge = 0.5 * (self.n - 1) - self.inner_half_m / self.cell_m
        return self.inner_half_m == 0.0 or abs(edge / CHUNK - round(edge / CHUNK)) < 1e-6

    @property
    def depth(self) -> int:
        """Number of strides: 1, 2, 4 ..."""
        return len(self._floors)

    def select(self, view: ViewVolume, ranges_m: NDArray[np.float64]) -> Selection:
        """Choose chunks for a view.

        ranges_m: (depth,) distance up to which each stride is fine enough, increasing.
        """
        normals, offsets = view.planes[:, :3].T, view.planes[:, 3]
        # Distances are compared by what is left of them over level ground.
        over = view.above_m**2
        chunks, boxes, skirts, near = [], [], [], []
        k = self._first_floor(view, ranges_m)
        rows, columns = (a.ravel() for a in np.indices(2 * (self._floors[k].side,)))
        while k >= 0:
            floor = self._floors[k]
            box = floor.boxes(rows, columns)
            middle, half = 0.5 * (box[:, 0] + box[:, 1]), 0.5 * (box[:, 1] - box[:, 0])
            middle -= view.camera_m
            seen = np.all(middle @ normals + half @ np.abs(normals) >= -offsets, axis=1)
            if self.inner_half_m:
                seen &= ~(floor.within[rows] & floor.within[columns])
            rows, columns = rows[seen], columns[seen]
            away, half = np.abs(middle[seen, :2]), half[seen, :2]
            nearest = (np.maximum(away - half, 0.0)**2).sum(axis=1)
            farthest = ((away + half)**2).sum(axis=1)
            finer = ranges_m[k - 1] if k else 0.0
            keep = nearest >= finer**2 - over
            if self.inner_half_m and k:
                keep &= ~(floor.meets[rows] & floor.meets[columns])
            limit = ranges_m[k] if k < self.depth - 1 else 1e9
            chunk = floor.chunks(rows[keep], columns[keep], limit)
            chunks.append(chunk)
            boxes.append(box[seen][keep])
            near.append(nearest[keep])
            # Both sides of a change of stride, or of grid: either edge may be rounded to lie above
            # the other.
            other = (farthest > (0.98 * limit)**2 - over) | floor.at_rim[rows] | \
                floor.at_rim[columns]
            if self.inner_half_m:
                other |= floor.touches[rows] & floor.touches[columns]
            if k:
                margin = 1.5 * CHUNK * floor.stride * self.cell_m
                other |= nearest < (finer + margin)**2 - over
            skirts.append(_rims(chunk, columns[keep], rows[keep], other[keep]))
            k -= 1
            rows = (2 * rows[~keep][:, None] + _ROWS).ravel()
            columns = (2 * columns[~keep][:, None] + _COLUMNS).ravel()
            inside = np.maximum(rows, columns) < self._floors[max(k, 0)].side
            rows, columns = rows[inside], columns[inside]
        order = np.argsort(np.concatenate(near), kind='stable')
        return Selection(np.concatenate(chunks)[order], np.concatenate(boxes)[order],
                         np.concatenate(skirts))

    def _first_floor(self, view: ViewVolume, ranges_m: NDArray[np.float64]) -> int:
        """Return the index of a floor above which no chunk could be kept."""
        half = 0.5 * (self.n - 1) * self.cell_m
        farthest = np.hypot(*(np.abs(view.camera_m[:2]) + half)) + view.above_m
        k = self.depth - 1
        while k and self._floors[k].side < _FIRST_SIDE and ranges_m[k - 1] > farthest:
            k -= 1
        return k


def _rims(chunks: Array, columns: NDArray[np.int64], rows: NDArray[np.int64],
          other: NDArray[np.bool_]) -> Array:
    """Return the skirts of chunks that `other` meshes may adjoin; see Selection."""
    if not other.any():
        return np.empty((0, 4))
    columns, rows = columns - columns.min() + 1, rows - rows.min() + 1
    taken = np.zeros((int(rows.max()) + 2, int(columns.max()) + 2), bool)
    taken[rows, columns] = True
    rims = []
    for side, (dx, dy) in enumerate(((-1, 0), (1, 0), (0, -1), (0, 1))):
        edge = chunks[other & ~taken[rows + dy, columns + dx]]
        edge[:, 2] += 0.25 * side
        rims.append(edge)
    return np.concatenate(rims)


class TerrainLevel:
    """GL objects of one height grid."""

    def __init__(self, context: moderngl.Context, grid: HeightGrid, inner_half_m: float) -> None:
        self.grid = grid
        self.inner_half_m = inner_half_m
        self.tree = ChunkTree(grid, inner_half_m)
        heights = np.ascontiguousarray(grid.heights_m, np.float32)
        self.heights = context.texture((grid.n, grid.n), 1, heights, dtype='f4')
        self.heights.filter = (context.NEAREST, context.NEAREST)
        self.heights.repeat_x = self.heights.repeat_y = False

    def bind(self, program: moderngl.Program) -> None:
        """Bind what the mesh of this level is made from."""
        self.heights.use(0)
        set_uniform(program, u_heights=0, u_lattice=lattice(self.grid), u_cell=self.grid.cell_m,
                    u_inner=self.inner_half_m)

    def release(self) -> None:
        """Release the GL objects."""
        self.heights.release()


def lattice(grid: HeightGrid) -> tuple[float, float, float, float]:
    """Return what shaders need to find a place in a grid: see u_lattice."""
    return 1.0 / grid.cell_m, 0.5 * (grid.n - 1), grid.n - 2.0, 1.0 / grid.n


class ChunkMesh:
    """The vertices that all chunks share, and one instance buffer."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        ij, faces, skirt = _mesh()
        self._vertices = context.buffer(ij.astype(np.float32).tobytes())
        self._faces = context.buffer(faces.astype(np.uint16).tobytes())
        self._skirt = context.buffer(skirt.astype(np.uint16).tobytes())
        self._instances = context.buffer(reserve=16 * 16384, dynamic=True)
        self._arrays: dict[tuple[int, bool], Any] = {}

    def draw(self, program: moderngl.Program, chunks: Array, *, skirt: bool = False) -> None:
        """Draw (m, 4) chunks, or their skirts."""
        if len(chunks) == 0:
            return
        data = chunks.astype(np.float32).tobytes()
        if len(data) > self._instances.size:
            self._instances.orphan(2 * len(data))
        self._instances.write(data)
        key = (program.glo, skirt)
        if key not in self._arrays:
            self._arrays[key] = self._context.vertex_array(
                program, [(self._vertices, '2f', 'a_ij'), (self._instances, '4f /i', 'i_chunk')],
                index_buffer=self._skirt if skirt else self._faces, index_element_size=2)
        self._arrays[key].render(instances=len(chunks))

    def release(self) -> None:
        """Release the GL objects."""
        for item in (*self._arrays.values(), self._vertices, self._faces, self._skirt,
                     self._instances):
            item.release()


def _mesh() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return vertices and the triangles of a chunk and of its skirt.

    Cells are split along the diagonal from (ix, iy) to (ix + 1, iy + 1), as `HeightGrid` is.
    """
    side = CHUNK + 1
    j, i = np.indices((side, side))
    top = np.column_stack([i.ravel(), j.ravel()])
    corner = (np.arange(CHUNK)[:, None] * side + np.arange(CHUNK)).ravel()
    faces = np.stack([corner, corner + 1, corner + side + 1,
                      corner, corner + side + 1, corner + side], axis=-1).ravel()
    # The skirt is one strip, which the shader lays along one of the four sides.
    line = np.arange(side)
    strip = np.concatenate([np.column_stack([line, 0 * line]),
                            np.column_stack([line + _LOWER, 0 * line])])
    a, b = len(top) + line[:-1], len(top) + line[1:]
    skirt = np.stack([a, b, b + side, a, b + side, a + side], axis=-1).ravel()
    vertices = np.concatenate([top, strip])
    return vertices, faces, skirt


def _chunks(z: NDArray[np.float32], merge: np.ufunc) -> NDArray[np.float32]:
    """Merge the samples of each chunk, those that it shares with the next ones included."""
    return _strips(_strips(z, merge).T, merge).T


def _strips(z: NDArray[np.float32], merge: np.ufunc) -> NDArray[np.float32]:
    # Whole rows at once: reductions along rows of 16 take twenty times as long.
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
    """Return, for each tree, the (depth,) distances up to which each of its strides is used."""
    cells = [tree.cell_m * 2.0**np.arange(tree.depth) for tree in trees]
    every = np.unique(np.round(np.concatenate(cells), 9)).astype(np.float64)
    reach = ranges(every, detail.full_resolution_m, detail.cells_per_distance)
    return [np.interp(c, every, reach) for c in cells]


def ranges(cells_m: NDArray[np.float64], full_resolution_m: float,
           cells_per_distance: float) -> NDArray[np.float64]:
    """Return the distance up to which each cell size is used.

    The finest reaches `full_resolution_m`; a coarser one as far as its distance divided by its
    cell is less than `cells_per_distance` (less and less of it beyond the near field), but each
    at least 1.3 times as far as the last.
    """
    result = np.empty(len(cells_m))
    for k, cell in enumerate(cells_m):
        reach = cell * cells_per_distance * min(1.0, (cell / _NEAR_CELL_M)**-0.13)
        result[k] = max(reach, full_resolution_m if k == 0 else 1.3 * result[k - 1])
    return result
