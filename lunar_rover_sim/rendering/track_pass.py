"""The pass of tracks: blocks of fine mesh near the cameras, cut out of the ground around them."""

from __future__ import annotations

import dataclasses

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering import texture_units
from lunar_rover_sim.rendering.chunk_tree import Selection
from lunar_rover_sim.rendering.context import load_program, release_all, set_uniform
from lunar_rover_sim.rendering.ground_mesh import GridTexture
from lunar_rover_sim.rendering.projection import ViewVolume
from lunar_rover_sim.rendering.track_map import DEFINES, NEAR_TILES, TILE_M, TrackMap
from lunar_rover_sim.rendering.track_texels import BLOCK, TILE

_FINE_M = 1.3               # blocks have the resolution of the overlay up to this distance
_STRIDES = (1, 2)           # beyond it every second sample is left out
_BLOCK_M = 0.5 * TILE_M
_BLOCKS = 2 * NEAR_TILES    # of the near window, along one side


@dataclasses.dataclass(frozen=True)
class TrackChoice:
    """Tracks that a view shows.

    Attributes:
        blocks: For each of the strides (m, 3) first samples and stride.
        wanted: (80, 80) which blocks of the near window are drawn, [iy, ix], wrapped around.
        cut: (chunks,) whether blocks are drawn over a chunk of the finest level.
        boxes: (n, 2, 3) of all tiles with tracks in view [m].
    """

    blocks: list[Array]
    wanted: NDArray[np.bool_]
    cut: NDArray[np.bool_]
    boxes: Array


class TrackPass:
    """Draws blocks of 10 x 10 cm."""

    def __init__(self, context: moderngl.Context, tracks: TrackMap, finest: GridTexture,
                 reach_m: float) -> None:
        """finest: the ground beneath; reach_m: distance up to which tracks are a mesh."""
        self._tracks, self._finest, self._reach_m = tracks, finest, reach_m
        self._program = load_program(context, 'tracks', 'terrain', **DEFINES)
        self._cut = context.texture((_BLOCKS, _BLOCKS), 1, dtype='f1', alignment=1)
        self._cut.filter = (context.NEAREST, context.NEAREST)
        self._context = context
        self._meshes = [_Mesh(context, self._program, BLOCK // stride) for stride in _STRIDES]

    def choose(self, volume: ViewVolume, finest: Selection) -> TrackChoice | None:
        """Choose what to draw for a view; finest: what it shows of the ground."""
        tracks = self._tracks
        seen = tracks.in_view(volume)
        if not seen.any():
            return None
        keys, flags = tracks.keys[seen & tracks.near], tracks.blocks[seen & tracks.near]
        k, j, i = np.nonzero(flags)
        blocks = np.stack([2 * keys[k, 0] + i, 2 * keys[k, 1] + j], axis=-1)
        away = np.linalg.norm((blocks + 0.5) * _BLOCK_M - volume.centre_m[:2], axis=-1)
        blocks, away = blocks[away < self._reach_m], away[away < self._reach_m]
        wanted = np.zeros((_BLOCKS, _BLOCKS), bool)
        wanted[blocks[:, 1] % _BLOCKS, blocks[:, 0] % _BLOCKS] = True
        fine = away < _FINE_M
        return TrackChoice([_instances(blocks[fine], _STRIDES[0]),
                            _instances(blocks[~fine], _STRIDES[1])], wanted,
                           self._cut_chunks(blocks, finest), tracks.boxes[seen])

    def draw_blocks(self, choice: TrackChoice) -> None:
        """Draw the depth of the blocks; what is drawn with `bind_cut` then leaves room for them.
        """
        self._cut.write(np.where(choice.wanted, 255, 0).astype(np.uint8))
        self._context.enable_only(self._context.DEPTH_TEST)
        self._finest.bind(self._program)
        self._tracks.bind(self._program)
        for mesh, instances in zip(self._meshes, choice.blocks):
            mesh.draw(instances)

    def bind_cut(self, program: moderngl.Program) -> None:
        """Bind where blocks have been drawn."""
        self._cut.use(texture_units.CUT)
        set_uniform(program, u_cut=texture_units.CUT, u_cut_scale=1.0 / (_BLOCKS * _BLOCK_M))

    def _cut_chunks(self, blocks: NDArray[np.int64], finest: Selection) -> NDArray[np.bool_]:
        """Return which chunks overlap any of the (m, 2) blocks."""
        if not len(blocks):
            return np.zeros(len(finest.chunks), bool)
        first = blocks.min(axis=0)
        size = blocks.max(axis=0) - first + 1
        taken = np.zeros((size[1] + 1, size[0] + 1), np.int64)
        taken[blocks[:, 1] - first[1] + 1, blocks[:, 0] - first[0] + 1] = 1
        count = taken.cumsum(axis=0).cumsum(axis=1)
        low = np.clip(np.floor(finest.boxes[:, 0, :2] / _BLOCK_M).astype(int) - first, 0, size)
        high = np.clip(np.ceil(finest.boxes[:, 1, :2] / _BLOCK_M).astype(int) - first, 0, size)
        inside: NDArray[np.bool_] = (
            count[high[:, 1], high[:, 0]] - count[low[:, 1], high[:, 0]]
            - count[high[:, 1], low[:, 0]] + count[low[:, 1], low[:, 0]]) > 0
        return inside

    def release(self) -> None:
        """Release the GL objects, but those of the map."""
        release_all(*self._meshes, self._program, self._cut)


class _Mesh:
    """The vertices of a block of `cells` x `cells` cells with its rim, and its instances."""

    def __init__(self, context: moderngl.Context, program: moderngl.Program, cells: int) -> None:
        self._program, self._cells = program, cells
        side = cells + 3
        j, i = np.indices((side, side))
        ij = np.column_stack([i.ravel(), j.ravel()]) - 1
        corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
        faces = np.stack([corner, corner + 1, corner + side + 1,
                          corner, corner + side + 1, corner + side], axis=-1).ravel()
        self._vertices = context.buffer(ij.astype(np.float32).tobytes())
        self._faces = context.buffer(faces.astype(np.uint16).tobytes())
        self._instances = context.buffer(reserve=12 * 256, dynamic=True)
        self._array = context.vertex_array(
            program, [(self._vertices, '2f', 'a_ij'), (self._instances, '3f /i', 'i_block')],
            index_buffer=self._faces, index_element_size=2)

    def draw(self, instances: Array) -> None:
        """Draw (m, 3) blocks."""
        if not len(instances):
            return
        data = instances.astype(np.float32).tobytes()
        if len(data) > self._instances.size:
            self._instances.orphan(2 * len(data))
        self._instances.write(data)
        set_uniform(self._program, u_cells=float(self._cells))
        self._array.render(instances=len(instances))

    def release(self) -> None:
        """Release the GL objects."""
        release_all(self._array, self._vertices, self._faces, self._instances)


def _instances(blocks: NDArray[np.int64], stride: int) -> Array:
    return np.column_stack([blocks * (TILE // 2), np.full(len(blocks), stride)])
