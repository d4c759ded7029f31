"""The pass of the ground: depth of its meshes, and what arrays need to find the ground itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import dataclasses
from typing import Any

import moderngl
import numpy as np

from lunar_rover_sim.compiled import read_only
from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.chunk_tree import CHUNK, level_ranges, Selection
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.context import load_program, release_all
from lunar_rover_sim.rendering.ground_mesh import ChunkMesh, GridTexture, GroundShape, lattice
from lunar_rover_sim.rendering.projection import Projection, ViewVolume
from lunar_rover_sim.rendering.relief_map import ReliefMap
from lunar_rover_sim.rendering.surface import Surface
from lunar_rover_sim.rendering.track_map import TrackMap
from lunar_rover_sim.rendering.track_pass import TrackChoice, TrackPass
from lunar_rover_sim.world.model import World

_MESH_ERROR_M = 0.012     # of the coarse meshes within `exact_m`, on ground of usual roughness
_EXACT_MARGIN = 1.05      # of `exact_m`: skirts hang out of the boxes of their chunks
_MESH_TRACKS = 0.85       # reach of the mesh of tracks, over that of the mesh at full resolution


@dataclasses.dataclass(frozen=True)
class MeshKind:
    """What a program of meshes draws.

    Attributes:
        outer: A level whose chunks overlap the finer level, which is cut out.
        skirt: Skirts.
        cut: What the blocks of tracks leave.
    """

    outer: bool = False
    skirt: bool = False
    cut: bool = False

    @property
    def defines(self) -> dict[str, Any]:
        """Those of its shaders."""
        return {**({'OUTER': 1} if self.outer else {}), **({'CUT': 1} if self.cut else {}),
                **({'SKIRT': 1, 'CHUNK': CHUNK} if self.skirt else {})}


@dataclasses.dataclass(frozen=True)
class Chosen:
    """What a view shows of the ground: chunks of each level, and tracks if any are known."""

    levels: list[Selection]
    tracks: TrackChoice | None = None

    @property
    def boxes(self) -> Array:
        """(m, 2, 3) least and greatest coordinates of all chunks, world frame [m]."""
        return np.concatenate([selection.boxes for selection in self.levels])


@dataclasses.dataclass(frozen=True)
class GroundRows:
    """The rows of an image that the ground covers.

    Attributes:
        first, last: The first one, and the one after the last.
        refined, tracks, shaded: The same of those where meshes are coarser than the grid, and of
            those that may show tracks and the rover's shadow.
    """

    first: int = 0
    last: int = 0
    refined: tuple[int, int] = (0, 0)
    tracks: tuple[int, int] = (0, 0)
    shaded: tuple[int, int] = (0, 0)


class GroundPass:
    """Draws the depth of the nested height grids.

    Attributes:
        shape: The ground itself.
    """

    def __init__(self, context: moderngl.Context, world: World, detail: DetailConfig,
                 surface: Surface) -> None:
        """Make meshes and programs; surface: has the relief below the grid."""
        self._context, self._detail = context, detail
        self._levels: list[GridTexture] = []
        inner = 0.0
        for grid in world.levels:
            self._levels.append(GridTexture(context, grid, inner))
            inner = grid.half_extent_m
        self._mesh = ChunkMesh(context)
        self._ranges = level_ranges([level.tree for level in self._levels], detail)
        self._mesh_programs: dict[MeshKind, moderngl.Program] = {}
        self._load_meshes(MeshKind(outer, skirt) for outer in (False, True)
                          for skirt in (False, True))
        finest = world.levels[0]
        numbers = np.array(lattice(finest), np.float32)
        reach = 0.0 if surface.tiles.flat else detail.relief_shape_m
        self._relief = ReliefMap(surface, finest, numbers, reach) if reach > 0.0 else None
        self.shape = GroundShape(
            read_only(finest.heights_m, np.float32), numbers,
            np.array([0.8 * self._ranges[0][0], detail.exact_m, _MESH_ERROR_M], np.float32),
            None if self._relief is None else self._relief.shape)
        self._tracks: TrackPass | None = None

    def _load_meshes(self, kinds: Iterable[MeshKind]) -> None:
        for kind in kinds:
            self._mesh_programs[kind] = load_program(self._context, 'terrain', 'terrain',
                                                     **kind.defines)

    def follow(self, tracks: TrackMap) -> None:
        """Draw tracks from now on."""
        reach = _MESH_TRACKS * float(self._ranges[0][0])
        self._tracks = TrackPass(self._context, tracks, self._levels[0], reach)
        self._load_meshes(MeshKind(skirt=skirt, cut=True) for skirt in (False, True))

    def choose(self, volume: ViewVolume, around: Chosen | None = None) -> Chosen:
        """Choose what to draw for a view.

        Args:
            around: What was chosen for a view that contains this one, from the same place.
        """
        if around is None:
            levels = [level.tree.select(volume, reach)
                      for level, reach in zip(self._levels, self._ranges)]
        else:
            levels = [selection.within(volume) for selection in around.levels]
        tracks = None if self._tracks is None else self._tracks.choose(volume, levels[0])
        return Chosen(levels, tracks)

    def update(self, volume: ViewVolume, before: Callable[[], None]) -> None:
        """Bring the shape of the relief below the grid up to date for a view.

        Args:
            before: Called before anything changes.
        """
        if self._relief is not None:
            self._relief.update(volume, before)

    def draw_depth(self, chosen: Chosen) -> None:
        """Draw the depth of the chosen meshes into the framebuffer in use."""
        tracks = chosen.tracks
        for level, selection in zip(self._levels, chosen.levels):
            outer, cut, chunks = not level.tree.aligned, False, selection.chunks
            if self._tracks is not None and tracks is not None and level is self._levels[0]:
                self._tracks.draw_blocks(tracks)
                cut = True
                self._draw_chunks(MeshKind(cut=True), level, chunks[tracks.cut])
                chunks = chunks[~tracks.cut]
            self._draw_chunks(MeshKind(outer), level, chunks)
            self._draw_chunks(MeshKind(outer, skirt=True, cut=cut), level, selection.skirts)

    def _draw_chunks(self, kind: MeshKind, level: GridTexture, chunks: Array) -> None:
        context, program = self._context, self._mesh_programs[kind]
        # Skirts are seen from both sides.
        context.enable_only(context.DEPTH_TEST | (context.NOTHING if kind.skirt
                                                  else context.CULL_FACE))
        level.bind(program)
        if self._tracks is not None and kind.cut:
            self._tracks.bind_cut(program)
        self._mesh.draw(program, chunks, skirt=kind.skirt)

    def rows(self, chosen: Chosen, projection: Projection, T_world_camera: Array,
             shaded: Array) -> GroundRows:
        """Return the rows that the ground covers, the same in both images of a rectified pair.

        Args:
            shaded: (m, 2, 3) those of the chosen boxes that the rover's shadow may fall on.
        """
        spans = [projection.covered_rows(selection.boxes, T_world_camera)
                 for selection in chosen.levels if len(selection.chunks)]
        if not spans:
            return GroundRows()
        first, last = min(s[0] for s in spans), max(s[1] for s in spans)
        finest = chosen.levels[0]
        coarse = finest.boxes[finest.chunks[:, 2] > 1.0]
        middle = projection.covered_rows(coarse, T_world_camera)[1] if len(coarse) else first
        near = self._not_beyond_exact(chosen.boxes, T_world_camera)
        top = projection.covered_rows(near, T_world_camera)[0] if len(near) else middle
        refined = (max(first, top), max(first, middle))
        tracks = (0, 0)
        if chosen.tracks is not None:
            tracks = projection.covered_rows(chosen.tracks.boxes, T_world_camera)
        shadow = projection.covered_rows(shaded, T_world_camera) if len(shaded) else (0, 0)
        return GroundRows(first, last, refined, tracks, shadow)

    def _not_beyond_exact(self, boxes: Array, T_world_camera: Array) -> Array:
        """Return those of (m, 2, 3) boxes in which rays may be intersected with the ground."""
        ahead = ((boxes - T_world_camera[:3, 3]) * T_world_camera[:3, 2]).min(axis=1).sum(axis=1)
        return boxes[ahead < _EXACT_MARGIN * self._detail.exact_m]

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self._mesh_programs.values(), self._mesh, *self._levels)
        if self._tracks is not None:
            self._tracks.release()
