"""The ground as GL meshes: heights of each grid, and the vertices that all chunks share."""

from __future__ import annotations

from typing import NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering import texture_units
from lunar_rover_sim.rendering.chunk_tree import CHUNK, ChunkTree
from lunar_rover_sim.rendering.context import release_all, set_uniform
from lunar_rover_sim.rendering.relief_map import ReliefShape
from lunar_rover_sim.world.grid import HeightGrid

_LOWER = 256            # added to the column of a vertex at the lower rim of a skirt


class GridTexture:
    """The heights of one grid on the GPU, and the choice of its chunks.

    Attributes:
        inner_half_m: Half extent of the finer grid that covers the middle of this one; 0 for none
            [m].
    """

    def __init__(self, context: moderngl.Context, grid: HeightGrid, inner_half_m: float) -> None:
        self.grid = grid
        self.inner_half_m = inner_half_m
        self.tree = ChunkTree(grid, inner_half_m)
        heights = np.ascontiguousarray(grid.heights_m, np.float32)
        self._heights = context.texture((grid.n, grid.n), 1, heights, dtype='f4')
        self._heights.filter = (context.NEAREST, context.NEAREST)
        self._heights.repeat_x = self._heights.repeat_y = False

    def bind(self, program: moderngl.Program) -> None:
        """Bind the heights for a program that draws chunks of this grid."""
        self._heights.use(texture_units.HEIGHTS)
        set_uniform(program, u_heights=texture_units.HEIGHTS, u_lattice=lattice(self.grid),
                    u_cell=self.grid.cell_m, u_inner=self.inner_half_m)

    def release(self) -> None:
        """Release the GL objects."""
        self._heights.release()


class GroundShape(NamedTuple):
    """The finest grid, and what lies on it, for `surface_rows`.

    Attributes:
        heights, lattice: Of the grid.
        bounds: Of the depths at which meshes are coarser than it.
        relief: None where it has no shape.
    """

    heights: NDArray[np.float32]
    lattice: NDArray[np.float32]
    bounds: NDArray[np.float32]
    relief: ReliefShape | None


def lattice(grid: HeightGrid) -> tuple[float, float, float, float]:
    """Return the constants of a grid that shaders look heights up with; see u_lattice there."""
    return 1.0 / grid.cell_m, 0.5 * (grid.n - 1), grid.n - 2.0, 1.0 / grid.n


class ChunkMesh:
    """The vertices that all chunks share, and one buffer of instances."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        ij, faces, skirt = _mesh()
        self._vertices = context.buffer(ij.astype(np.float32).tobytes())
        self._faces = context.buffer(faces.astype(np.uint16).tobytes())
        self._skirt = context.buffer(skirt.astype(np.uint16).tobytes())
        self._instances = context.buffer(reserve=16 * 16384, dynamic=True)
        self._arrays: dict[tuple[int, bool], moderngl.VertexArray] = {}

    def draw(self, program: moderngl.Program, chunks: Array, *, skirt: bool = False) -> None:
        """Draw (m, 4) chunks or skirts, as in `chunk_tree.Selection`."""
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
        release_all(*self._arrays.values(), self._vertices, self._faces, self._skirt,
                    self._instances)


def _mesh() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return (v, 2) vertices, and the vertex indices of the triangles of a chunk and of a skirt.

    Cells are split along the diagonal from (ix, iy) to (ix + 1, iy + 1), as in `HeightGrid`.
    """
    side = CHUNK + 1
    j, i = np.indices((side, side))
    top = np.column_stack([i.ravel(), j.ravel()])
    corner = (np.arange(CHUNK)[:, None] * side + np.arange(CHUNK)).ravel()
    faces = np.stack([corner, corner + 1, corner + side + 1,
                      corner, corner + side + 1, corner + side], axis=-1).ravel()
    # The skirt is one strip. The shader lays it along one of the four sides.
    line = np.arange(side)
    strip = np.concatenate([np.column_stack([line, 0 * line]),
                            np.column_stack([line + _LOWER, 0 * line])])
    a, b = len(top) + line[:-1], len(top) + line[1:]
    skirt = np.stack([a, b, b + side, a, b + side, a + side], axis=-1).ravel()
    vertices = np.concatenate([top, strip])
    return vertices, faces, skirt
