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

from lunar_rover_sim.camera.config import DetailConfig
from lunar_rover_sim.camera.context import set_uniform
from lunar_rover_sim.frames import Array
from lunar_rover_sim.world.grid import HeightGrid

if TYPE_CHECKING:
    import moderngl

CHUNK = 8
_NEAR_CELL_M = 0.05
_LOWER = 256  # added to the column of a vertex at the lower rim of a skirt


@dataclasses.dataclass(frozen=True)
class View:
    """What decides which chunks are drawn.

    camera_m: (3,) position, world; planes: (p, 4) half-spaces, relative to the camera, that the
    view lies in: a n.x + d >= 0 for what may be seen; above_m: height above the ground
    """

    camera_m: Array
    planes: Array
    above_m: float


class ChunkTree:
    """Chooses the chunks of one height grid."""

    def __init__(self, grid: HeightGrid, inner_half_m: float) -> None:
        self.cell_m = grid.cell_m
        self.n = grid.n
        self._inner_half_m = inner_half_m
        self._low: list[NDArray[np.float32]] = []
        self._high: list[NDArray[np.float32]] = []
        self._low.append(_chunks(grid.heights_m, np.minimum))
        self._high.append(_chunks(grid.heights_m, np.maximum))
        while self._low[-1].shape[0] > 1:
            self._low.append(_blocks(self._low[-1], 2, np.minimum))
            self._high.append(_blocks(self._high[-1], 2, np.maximum))

    @property
    def aligned(self) -> bool:
        """Whether the finer level inside this one ends where chunks end (or there is none)."""
        edge = 0.5 * (self.n - 1) - self._inner_half_m / self.cell_m
        return self._inner_half_m == 0.0 or abs(edge / CHUNK - round(edge / CHUNK)) < 1e-6

    @property
    def depth(self) -> int:
        """Number of strides: 1, 2, 4 ..."""
        return len(self._low)

    def boxes(self, chunks: Array) -> Array:
        """Return (m, 2, 3) corners of least and greatest coordinates of chunks, world [m]."""
        size = (chunks[:, 2] * CHUNK).astype(int)
        columns, rows = (chunks[:, :2] / size[:, None]).astype(int).T
        x, y = self._bounds(columns, size), self._bounds(rows, size)
        k = np.round(np.log2(chunks[:, 2])).astype(int)
        z = np.empty((2, len(chunks)))
        for level in np.unique(k):
            of = k == level
            z[0, of] = self._low[level][rows[of], columns[of]]
            z[1, of] = self._high[level][rows[of], columns[of]]
        return np.stack([np.stack([x[i], y[i], z[i]], axis=-1) for i in (0, 1)], axis=1)

    def select(self, view: View, ranges_m: NDArray[np.float64]) -> tuple[Array, Array]:
        """Return (chunks, skirts): (m, 4) first column, first row, stride, range; near first.

        ranges_m: (depth,) distance up to which each stride is fine enough, increasing.
        """
        top = self._low[-1].shape[0]
        rows, columns = (a.ravel() for a in np.indices((top, top)))
        chunks, distances, skirts = [], [], []
        for k in range(self.depth - 1, -1, -1):
            size = CHUNK << k
            edges = np.stack([*self._bounds(columns, size), *self._bounds(rows, size)])
            seen = self._seen(edges, self._low[k][rows, columns], self._high[k][rows, columns],
                              view)
            rows, columns, edges = rows[seen], columns[seen], edges[:, seen]
            near, far = _distances(edges, view)
            split = near < ranges_m[k - 1] if k else np.zeros(len(rows), bool)
            if k:
                split |= self._meets_inner(edges)
            keep = ~split
            limit = ranges_m[k] if k < self.depth - 1 else 1e9
            chunk = np.column_stack([columns[keep] * size, rows[keep] * size,
                                     np.full(keep.sum(), 1 << k), np.full(keep.sum(), limit)])
            chunks.append(chunk)
            distances.append(near[keep])
            # Both sides of a change of stride, or of grid: either edge may be rounded to lie above
            # the other.
            other = (far > 0.98 * limit) | self._at_rim(edges)
            if k:
                other |= near < ranges_m[k - 1] + 1.5 * size * self.cell_m
            skirts.append(self._rims(chunk, columns[keep], rows[keep], other[keep]))
            rows = (2 * rows[split][:, None] + [0, 0, 1, 1]).ravel()
            columns = (2 * columns[split][:, None] + [0, 1, 0, 1]).ravel()
            if k:
                inside = (rows < self._low[k - 1].shape[0]) & (columns < self._low[k - 1].shape[0])
                rows, columns = rows[inside], columns[inside]
        order = np.argsort(np.concatenate(distances), kind='stable')
        return np.concatenate(chunks)[order], np.concatenate(skirts)

    def _rims(self, chunk: Array, columns: NDArray[np.int64], rows: NDArray[np.int64],
              outer: NDArray[np.bool_]) -> Array:
        """Return (m, 4) like chunks: sides that another stride may adjoin.

        The number of the side, 0 to 3, is the fraction of the stride in quarters.
        """
        if len(chunk) == 0:
            return chunk
        taken = np.zeros((int(rows.max()) + 3, int(columns.max()) + 3), bool)
        taken[rows + 1, columns + 1] = True
        rims = []
        for side, (dx, dy) in enumerate(((-1, 0), (1, 0), (0, -1), (0, 1))):
            edge = chunk[outer & ~taken[rows + 1 + dy, columns + 1 + dx]]
            edge[:, 2] += 0.25 * side
            rims.append(edge)
        return np.concatenate(rims)

    def _bounds(self, index: NDArray[np.int64],
                size: int | NDArray[np.int64]) -> tuple[Array, Array]:
        low = np.minimum(index * size, self.n - 1)
        high = np.minimum(low + size, self.n - 1)
        middle = 0.5 * (self.n - 1)
        return (low - middle) * self.cell_m, (high - middle) * self.cell_m

    def _at_rim(self, edges: Array) -> NDArray[np.bool_]:
        """Return which chunks lie at the rim of this grid or of the finer one inside it."""
        half = 0.5 * (self.n - 1) * self.cell_m - 1e-3
        return np.any(np.abs(edges) > half, axis=0) | self._meets_inner(edges, 1e-3)

    def _meets_inner(self, edges: Array, margin_m: float = 0.0) -> NDArray[np.bool_]:
        """Return which chunks overlap the finer grid, if there is one, and a margin around it."""
        if self._inner_half_m == 0.0:
            return np.zeros(edges.shape[1], bool)
        h = self._inner_half_m + margin_m
        return np.all((edges[::2] < h) & (edges[1::2] > -h), axis=0)

    def _seen(self, edges: Array, low: NDArray[np.float32], high: NDArray[np.float32],
              view: View) -> NDArray[np.bool_]:
        """Return which chunks are not empty, not within the finer grid, and may be in view."""
        x0, x1, y0, y1 = edges
        seen = (x1 > x0) & (y1 > y0)
        h = self._inner_half_m
        if h > 0.0:
            seen &= ~((x0 >= -h) & (x1 <= h) & (y0 >= -h) & (y1 <= h))
        ends = np.array([[x0, y0, low], [x1, y1, high]])
        middle = 0.5 * (ends[0] + ends[1]) - view.camera_m[:, None]
        normals = view.planes[:, :3]
        reach = normals @ middle + np.abs(normals) @ (0.5 * (ends[1] - ends[0]))
        return seen & np.all(reach + view.planes[:, 3:] >= 0.0, axis=0)


def _distances(edges: Array, view: View) -> tuple[Array, Array]:
    """Return nearest and farthest distance of chunks (4, m) x0, x1, y0, y1 from the camera."""
    ahead, behind = edges[::2] - view.camera_m[:2, None], view.camera_m[:2, None] - edges[1::2]
    nearest = np.maximum(np.maximum(ahead, behind), 0.0)
    farthest = np.maximum(-ahead, -behind)
    above = view.above_m**2
    return (np.sqrt((nearest**2).sum(axis=0) + above), np.sqrt((farthest**2).sum(axis=0) + above))


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
