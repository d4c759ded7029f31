"""The pass of the ground: depth of its meshes, of the ground itself, then the light of pixels."""

from __future__ import annotations

from collections.abc import Iterable
import dataclasses
from typing import Any

import moderngl
import numpy as np

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering import texture_units
from lunar_rover_sim.rendering.chunk_tree import CHUNK, level_ranges, Selection
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.context import enable, load_program, release_all, set_uniform
from lunar_rover_sim.rendering.crater_map import CraterMap, ROW
from lunar_rover_sim.rendering.ground_mesh import ChunkMesh, GridTexture, lattice
from lunar_rover_sim.rendering.projection import Projection, ViewVolume
from lunar_rover_sim.rendering.relief_brightness import LEVELS
from lunar_rover_sim.rendering.relief_map import ReliefMap
from lunar_rover_sim.rendering.surface import Surface, ZONE
from lunar_rover_sim.rendering.track_map import DEFINES, TrackMap
from lunar_rover_sim.rendering.track_pass import TrackChoice, TrackPass
from lunar_rover_sim.rendering.view import Window
from lunar_rover_sim.world.model import World

_MESH_ERROR_M = 0.012     # of the coarse meshes within `exact_m`, on ground of usual roughness
_EXACT_MARGIN = 1.05      # of `exact_m`: skirts hang out of the boxes of their chunks
_RELAXED = 1.5            # length of a step over the relief, over what its bounds of slopes allow
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
class PixelKind:
    """What a program of pixels computes: depth of the ground itself, or else light or truth of it.

    Attributes:
        refined: Where meshes are coarser than the grid.
        shaded: Where the shadow of the rover may fall.
        tracks: Where there may be any.
    """

    surface: bool = False
    refined: bool = False
    lit: bool = False
    shaded: bool = False
    truth: bool = False
    tracks: bool = False

    @property
    def defines(self) -> dict[str, Any]:
        """Those of its shaders."""
        truth = {'TRUTH': 1, 'CRATER_ROW': float(ROW)}
        return {**({} if self.lit or self.surface else {'UNLIT': 1}),
                **({'REFINE': 1} if self.refined else {}),
                **({'ROVER_SHADOW': 1} if self.shaded else {}),
                **(truth if self.truth else {}),
                **({'TRACKS': 1, **DEFINES} if self.tracks else {})}


_KINDS = (PixelKind(surface=True), PixelKind(surface=True, refined=True), PixelKind(),
          PixelKind(lit=True), PixelKind(lit=True, shaded=True))


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
        own: The same of those where the ground has a depth of its own, not that of its meshes.
        refined, tracks, shaded: The same of those where meshes are coarser than the grid, and of
            those that may show tracks and the rover's shadow.
    """

    first: int = 0
    last: int = 0
    own: tuple[int, int] = (0, 0)
    refined: tuple[int, int] = (0, 0)
    tracks: tuple[int, int] = (0, 0)
    shaded: tuple[int, int] = (0, 0)

    def parts(self, *needs: str) -> list[tuple[int, int, dict[str, bool]]]:
        """Return spans of rows, first and one after the last, with which needs each has.

        needs: of `PixelKind`: 'refined', 'shaded', 'tracks'
        """
        spans = {name: getattr(self, name) for name in needs}
        cuts = sorted({self.first, self.last, *(row for span in spans.values() for row in span
                                                if self.first < row < self.last)})
        return [(top, bottom, {name: first <= top < end for name, (first, end) in spans.items()})
                for top, bottom in zip(cuts, cuts[1:])]


class GroundPass:
    """Draws the nested height grids: depth of meshes, then light and truth of pixels."""

    def __init__(self, context: moderngl.Context, world: World, detail: DetailConfig,
                 surface: Surface, lamp: bool) -> None:
        """Make meshes and programs; surface: textures to light with; lamp: whether there is one.
        """
        self._context, self._detail, self._surface = context, detail, surface
        self._lamp = lamp
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
        self._programs: dict[PixelKind, moderngl.Program] = {}
        self._screens: dict[PixelKind, moderngl.VertexArray] = {}
        reach = 0.0 if surface.tiles.flat else detail.relief_shape_m
        self._relief = (ReliefMap(context, surface, self._levels[0], reach) if reach > 0.0
                        else None)
        self._load(_KINDS)
        self._tracks: TrackPass | None = None

    @property
    def programs(self) -> tuple[moderngl.Program, ...]:
        """Those that compute light or truth, for the constants of the light."""
        return tuple(self._programs.values())

    def _load_meshes(self, kinds: Iterable[MeshKind]) -> None:
        for kind in kinds:
            self._mesh_programs[kind] = load_program(self._context, 'terrain', 'terrain',
                                                     **kind.defines)

    def _load(self, kinds: Iterable[PixelKind]) -> None:
        """Compile programs of pixels."""
        for kind in kinds:
            relief = {'RELIEF': 1, 'RELAXED': _RELAXED} if self._relief is not None else {}
            if kind.surface:
                program = load_program(self._context, 'screen', 'surface', **relief,
                                       **kind.defines)
            else:
                # Painted relief casts no shadow under the lamp: the camera beside it would see
                # dark places where it should see the lit faces before them.
                light = {**({'LAMP': 1} if self._lamp else {}),
                         **({'SMOOTH': 1} if self._detail.smooth_outlines else {})}
                program = load_program(self._context, 'screen', 'ground',
                                       LEVELS=len(self._levels), RELIEF_LEVELS=LEVELS, ZONE=ZONE,
                                       **relief, **kind.defines, **(light if kind.lit else {}))
            # Samplers of two kinds may not share a unit, used or not.
            set_uniform(program, u_crater_cells=texture_units.CRATER_CELLS,
                        u_crater_list=texture_units.CRATER_LIST)
            self._programs[kind] = program
            self._screens[kind] = self._context.vertex_array(program, [])

    def prepare_truth(self) -> None:
        """Be able to draw truth from now on; adds to `programs`."""
        self._load([dataclasses.replace(kind, truth=True) for kind in self._programs
                    if not kind.surface])

    def follow(self, tracks: TrackMap) -> None:
        """Draw tracks from now on; adds to `programs`."""
        reach = _MESH_TRACKS * float(self._ranges[0][0])
        self._tracks = TrackPass(self._context, tracks, self._levels[0], reach)
        self._load_meshes(MeshKind(skirt=skirt, cut=True) for skirt in (False, True))
        self._load([dataclasses.replace(kind, tracks=True) for kind in self._programs])

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

    def update(self, volume: ViewVolume) -> None:
        """Bring the shape of the relief below the grid up to date for a view."""
        if self._relief is not None:
            self._relief.update(volume)

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
        # Blocks of 2 x 2 pixels, which derivatives are of, see one texture.
        own = ((first, last) if self._relief is not None
               else (refined[0] // 2 * 2, (refined[1] + 1) // 2 * 2))
        tracks = (0, 0)
        if chosen.tracks is not None:
            tracks = projection.covered_rows(chosen.tracks.boxes, T_world_camera)
        shadow = projection.covered_rows(shaded, T_world_camera) if len(shaded) else (0, 0)
        return GroundRows(first, last, own, refined, tracks, shadow)

    def _not_beyond_exact(self, boxes: Array, T_world_camera: Array) -> Array:
        """Return those of (m, 2, 3) boxes in which rays may be intersected with the ground."""
        ahead = ((boxes - T_world_camera[:3, 3]) * T_world_camera[:3, 2]).min(axis=1).sum(axis=1)
        return boxes[ahead < _EXACT_MARGIN * self._detail.exact_m]

    def draw_surface(self, target: moderngl.Framebuffer, window: Window, rows: GroundRows,
                     mesh_depth: moderngl.Texture) -> None:
        """Draw the depth of the ground itself, where it is not that of its meshes.

        Args:
            target: With the depth buffer that the meshes were drawn with.
            rows: See `rows`.
        """
        context = self._context
        # Without relief the depth buffer stays that of the meshes: writing it takes time.
        context.enable_only(context.NOTHING if self._relief is None else context.DEPTH_TEST)
        context.depth_func = '1'
        target.use()
        for top, bottom, needs in rows.parts('own', 'refined', 'tracks'):
            if not needs.pop('own'):
                continue
            target.viewport = (window[0], window[1] + top, window[2], bottom - top)
            self._draw_screen(PixelKind(surface=True, **needs), mesh_depth)
        context.depth_func = '<'

    def draw(self, target: moderngl.Framebuffer, window: Window, rows: GroundRows,
             mesh_depth: moderngl.Texture, ground_depth: moderngl.Texture, *, lit: bool,
             add: bool = False, truth: bool = False, craters: CraterMap | None = None) -> None:
        """Light the pixels that the meshes cover, or with `lit` false, only compute their depth.

        Args:
            add: Whether to add to the present radiance.
            target: With the depth buffer that the meshes were drawn with.
            rows: See `rows`.
            mesh_depth, ground_depth: Of the meshes; of the ground itself, where `draw_surface` has
                drawn it.
            truth: Whether to draw that too, into the attachments of `TruthTargets`; that of light
                needs `lit`.
            craters: None if their numbers are not asked for.
        """
        # Depth rejects blocks of pixels of the sky before they are computed.
        enable(self._context, self._context.DEPTH_TEST, add=add)
        self._context.depth_func = '>'
        for top, bottom, needs in rows.parts(*(('shaded',) if lit else ()), 'own', 'tracks'):
            target.viewport = (window[0], window[1] + top, window[2], bottom - top)
            depth = ground_depth if needs.pop('own') else mesh_depth
            kind = PixelKind(lit=lit, truth=truth, **needs)
            if truth:
                set_uniform(self._programs[kind], u_crater_texel=(0.0, 0.0))
                if craters is not None:
                    craters.bind(self._programs[kind])
            self._draw_screen(kind, depth)
        self._context.depth_func = '<'

    def _draw_screen(self, kind: PixelKind, depth: moderngl.Texture) -> None:
        program = self._programs[kind]
        if not kind.surface:
            self._surface.bind(program)
        if self._relief is not None:
            self._relief.bind(program)
        depth.use(texture_units.GROUND_DEPTH)
        set_uniform(program, u_depth=texture_units.GROUND_DEPTH)
        if self._tracks is not None and kind.tracks:
            self._tracks.bind(program)
        if kind.refined:
            finest = self._levels[0]
            finest.heights.use(texture_units.HEIGHTS)
            set_uniform(program, u_heights=texture_units.HEIGHTS, u_lattice=lattice(finest.grid),
                        u_refine=(0.8 * self._ranges[0][0], self._detail.exact_m, _MESH_ERROR_M))
        self._screens[kind].render(vertices=3)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self._screens.values(), *self.programs, *self._mesh_programs.values(),
                    self._mesh, *self._levels, *([self._relief] if self._relief else []))
        if self._tracks is not None:
            self._tracks.release()
