"""The pass of the ground: first the depth of its meshes, then the light of each pixel."""

from __future__ import annotations

import dataclasses

import moderngl
import numpy as np

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering import texture_units
from lunar_rover_sim.rendering.chunk_tree import CHUNK, level_ranges, Selection
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.context import (clear_window, enable, load_program, release_all,
                                               set_uniform)
from lunar_rover_sim.rendering.crater_map import CraterMap, ROW
from lunar_rover_sim.rendering.ground_mesh import ChunkMesh, GridTexture, lattice
from lunar_rover_sim.rendering.projection import Projection, ViewVolume
from lunar_rover_sim.rendering.relief_brightness import LEVELS
from lunar_rover_sim.rendering.surface import Surface, ZONE
from lunar_rover_sim.rendering.track_map import DEFINES, TrackMap
from lunar_rover_sim.rendering.track_pass import TrackChoice, TrackPass
from lunar_rover_sim.rendering.view import Window
from lunar_rover_sim.world.model import World

_MESH_ERROR_M = 0.012     # of the coarse meshes within `exact_m`, on ground of usual roughness
_SHADERS: dict[str, dict[str, int]] = {
    'lit': {},
    'lit refined': {'REFINE': 1},
    'lit shaded': {'ROVER_SHADOW': 1},
    'lit refined shaded': {'REFINE': 1, 'ROVER_SHADOW': 1},
    'unlit': {'UNLIT': 1},
    'unlit refined': {'UNLIT': 1, 'REFINE': 1},
    'truth': {'TRUTH': 1},
    'truth far': {'TRUTH': 1, 'FAR': 1},
    'truth shaded': {'TRUTH': 1, 'ROVER_SHADOW': 1},
    'truth far shaded': {'TRUTH': 1, 'FAR': 1, 'ROVER_SHADOW': 1}}
_FRAGMENT = {name: 'ground_truth' if 'TRUTH' in defines else 'ground'
             for name, defines in _SHADERS.items()}
_WITH_TRACKS = tuple(name for name in _SHADERS if name != 'unlit')
_MESH_TRACKS = 0.85       # reach of the mesh of tracks, over that of the mesh at full resolution


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

    first, last: the first one, and the one after the last; middle: the first one below all coarse
    meshes; tracks, shaded, far: the first one, and the one after the last, that may show tracks,
    the rover's shadow, and ground beyond the finest grid
    """

    first: int = 0
    middle: int = 0
    last: int = 0
    tracks: tuple[int, int] = (0, 0)
    shaded: tuple[int, int] = (0, 0)
    far: tuple[int, int] = (0, 0)

    def parts(self, *, lit: bool) -> list[tuple[int, int, str]]:
        """Return spans of rows, first and one after the last, with what each needs.

        lit: whether light is computed, so that shadows matter
        """
        return self._cut({'refined': (self.first, self.middle),
                          'shaded': self.shaded if lit else (0, 0), 'tracks': self.tracks})

    def truth_parts(self) -> list[tuple[int, int, str]]:
        """Return the same for the truth of pixels."""
        return self._cut({'far': self.far, 'shaded': self.shaded, 'tracks': self.tracks})

    def _cut(self, spans: dict[str, tuple[int, int]]) -> list[tuple[int, int, str]]:
        cuts = sorted({self.first, self.last, *(row for span in spans.values() for row in span
                                                if self.first < row < self.last)})
        return [(top, bottom, ''.join(f' {name}' for name, (first, end) in spans.items()
                                      if first <= top < end))
                for top, bottom in zip(cuts, cuts[1:])]


class GroundPass:
    """Draws the nested height grids.

    programs: those that compute light or truth, for the constants of the light
    """

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
        # A level is 'outer' where its chunks overlap the finer level, which is then cut out.
        self._depth_programs = {
            'inner': load_program(context, 'terrain', 'terrain'),
            'outer': load_program(context, 'terrain', 'terrain', OUTER=1),
            'inner skirt': load_program(context, 'terrain', 'terrain', SKIRT=1, CHUNK=CHUNK),
            'outer skirt': load_program(context, 'terrain', 'terrain', OUTER=1, SKIRT=1,
                                        CHUNK=CHUNK)}
        self._programs = {
            name: load_program(context, 'screen', _FRAGMENT[name], LEVELS=len(world.levels),
                               RELIEF_LEVELS=LEVELS, ZONE=ZONE, CRATER_ROW=float(ROW),
                               **self._defines(name))
            for name in _SHADERS}
        self.programs = tuple(self._programs.values())
        self._screens = {name: context.vertex_array(program, [])
                         for name, program in self._programs.items()}
        self._tracks: TrackPass | None = None

    def _defines(self, name: str) -> dict[str, int]:
        """Return what the shader of the light or truth of pixels is compiled with."""
        lit = 'lit' in name.split()
        return {**_SHADERS[name], **({'LAMP': 1} if lit and self._lamp else {}),
                **({'SMOOTH': 1} if lit and self._detail.smooth_outlines else {})}

    def follow(self, tracks: TrackMap) -> None:
        """Draw tracks from now on; adds to `programs`."""
        context = self._context
        reach = _MESH_TRACKS * float(self._ranges[0][0])
        self._tracks = TrackPass(context, tracks, self._levels[0], reach)
        for kind in ('', ' skirt'):
            self._depth_programs[f'inner{kind} cut'] = load_program(
                context, 'terrain', 'terrain', CUT=1,
                **({'SKIRT': 1, 'CHUNK': CHUNK} if kind else {}))
        for name in _WITH_TRACKS:
            program = load_program(
                context, 'screen', _FRAGMENT[name], LEVELS=len(self._levels), RELIEF_LEVELS=LEVELS,
                ZONE=ZONE, CRATER_ROW=float(ROW), TRACKS=1, **DEFINES, **self._defines(name))
            self._programs[f'{name} tracks'] = program
            self._screens[f'{name} tracks'] = context.vertex_array(program, [])
        self.programs = tuple(self._programs.values())

    def choose(self, volume: ViewVolume, around: Chosen | None = None) -> Chosen:
        """Choose what to draw for a view.

        around: what was chosen for a view that contains this one, from the same place
        """
        if around is None:
            levels = [level.tree.select(volume, reach)
                      for level, reach in zip(self._levels, self._ranges)]
        else:
            levels = [selection.within(volume) for selection in around.levels]
        tracks = None if self._tracks is None else self._tracks.choose(volume, levels[0])
        return Chosen(levels, tracks)

    def draw_depth(self, chosen: Chosen) -> None:
        """Draw the depth of the chosen meshes into the framebuffer in use."""
        tracks = chosen.tracks
        for level, selection in zip(self._levels, chosen.levels):
            name, cut = 'inner' if level.tree.aligned else 'outer', ''
            chunks = selection.chunks
            if self._tracks is not None and tracks is not None and level is self._levels[0]:
                self._tracks.draw_blocks(tracks)
                cut = ' cut'
                self._draw_chunks('inner cut', level, chunks[tracks.cut])
                chunks = chunks[~tracks.cut]
            self._draw_chunks(name, level, chunks)
            self._draw_chunks(f'{name} skirt{cut}', level, selection.skirts)

    def _draw_chunks(self, name: str, level: GridTexture, chunks: Array) -> None:
        context, program = self._context, self._depth_programs[name]
        skirt = 'skirt' in name     # seen from both sides
        context.enable_only(context.DEPTH_TEST | (context.NOTHING if skirt else context.CULL_FACE))
        level.bind(program)
        if self._tracks is not None and 'cut' in name:
            self._tracks.bind_cut(program)
        self._mesh.draw(program, chunks, skirt=skirt)

    def rows(self, chosen: Chosen, projection: Projection, T_world_camera: Array,
             shaded: Array) -> GroundRows:
        """Return the rows that the ground covers, the same in both images of a rectified pair.

        shaded: (m, 2, 3) those of the chosen boxes that the rover's shadow may fall on
        """
        spans = [projection.covered_rows(selection.boxes, T_world_camera)
                 for selection in chosen.levels if len(selection.chunks)]
        if not spans:
            return GroundRows()
        first, last = min(s[0] for s in spans), max(s[1] for s in spans)
        finest = chosen.levels[0]
        coarse = finest.boxes[finest.chunks[:, 2] > 1.0]
        middle = projection.covered_rows(coarse, T_world_camera)[1] if len(coarse) else first
        tracks = (0, 0)
        if chosen.tracks is not None:
            tracks = projection.covered_rows(chosen.tracks.boxes, T_world_camera)
        shadow = projection.covered_rows(shaded, T_world_camera) if len(shaded) else (0, 0)
        outer = spans[1:] if len(finest.chunks) else spans
        far = (min(s[0] for s in outer), max(s[1] for s in outer)) if outer else (0, 0)
        return GroundRows(first, max(first, middle), last, tracks, shadow, far)

    def draw(self, target: moderngl.Framebuffer, window: Window, rows: GroundRows,
             ground_depth: moderngl.Texture, *, lit: bool, add: bool = False) -> None:
        """Light the pixels that the meshes cover, or with `lit` false, only compute their depth.

        add: whether to add to the present radiance
        target: with the depth buffer that the meshes were drawn with; rows: see `rows`; where the
        meshes may be coarser than the grid, depth is refined first
        """
        # Depth rejects blocks of pixels of the sky before they are computed.
        enable(self._context, self._context.DEPTH_TEST, add=add)
        self._context.depth_func = '>'
        kind = 'lit' if lit else 'unlit'
        for top, bottom, needs in rows.parts(lit=lit):
            target.viewport = (window[0], window[1] + top, window[2], bottom - top)
            name = f'{kind}{needs}'
            self._draw_screen(name if name in self._programs else kind, ground_depth)
        self._context.depth_func = '<'

    def draw_truth(self, target: moderngl.Framebuffer, window: Window, rows: GroundRows,
                   depth: moderngl.Texture, craters: CraterMap | None) -> None:
        """Draw what is true of the ground, and zeros elsewhere.

        depth: of all that is seen; craters: None if the numbers of craters are not asked for
        """
        x, y, width, height = window
        for top, bottom in ((0, rows.first), (rows.last, height)):
            if top < bottom:
                clear_window(target, (x, y + top, width, bottom - top))
        target.use()
        self._context.enable_only(self._context.NOTHING)
        for top, bottom, needs in rows.truth_parts():
            target.viewport = (x, y + top, width, bottom - top)
            program = self._programs[f'truth{needs}']
            # Samplers of two kinds may not share a unit, used or not.
            set_uniform(program, u_crater_texel=(0.0, 0.0),
                        u_crater_cells=texture_units.CRATER_CELLS,
                        u_crater_list=texture_units.CRATER_LIST)
            if craters is not None:
                craters.bind(program)
            self._draw_screen(f'truth{needs}', depth)

    def _draw_screen(self, name: str, ground_depth: moderngl.Texture) -> None:
        program = self._programs[name]
        self._surface.bind(program)
        ground_depth.use(texture_units.GROUND_DEPTH)
        set_uniform(program, u_depth=texture_units.GROUND_DEPTH)
        if self._tracks is not None and name.endswith('tracks'):
            self._tracks.bind(program)
        if 'refined' in name:
            finest = self._levels[0]
            finest.heights.use(texture_units.HEIGHTS)
            set_uniform(program, u_heights=texture_units.HEIGHTS, u_lattice=lattice(finest.grid),
                        u_refine=(0.8 * self._ranges[0][0], self._detail.exact_m, _MESH_ERROR_M))
        self._screens[name].render(vertices=3)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self._screens.values(), *self.programs, *self._depth_programs.values(),
                    self._mesh, *self._levels)
        if self._tracks is not None:
            self._tracks.release()
