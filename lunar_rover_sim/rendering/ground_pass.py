"""The pass of the ground: first the depth of its meshes, then the light of each pixel."""

from __future__ import annotations

import moderngl

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering import texture_units
from lunar_rover_sim.rendering.chunk_tree import CHUNK, level_ranges, Selection
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.context import load_program, release_all, set_uniform
from lunar_rover_sim.rendering.ground_mesh import ChunkMesh, GridTexture, lattice
from lunar_rover_sim.rendering.projection import Projection, ViewVolume
from lunar_rover_sim.rendering.relief_brightness import LEVELS
from lunar_rover_sim.rendering.surface import Surface, ZONE
from lunar_rover_sim.rendering.view import Window
from lunar_rover_sim.world.model import World

_MESH_ERROR_M = 0.012     # of the coarse meshes within `exact_m`, on ground of usual roughness
_SHADERS: dict[str, dict[str, int]] = {
    'lit': {'ROVER_SHADOW': 1, 'SKYLINE': 1},
    'lit refined': {'ROVER_SHADOW': 1, 'SKYLINE': 1, 'REFINE': 1},
    'unlit': {'UNLIT': 1},
    'unlit refined': {'UNLIT': 1, 'REFINE': 1},
    'truth': {'TRUTH': 1}}

Chosen = list[Selection]        # of each level


class GroundPass:
    """Draws the nested height grids.

    programs: those that compute light or truth, for the constants of the light
    """

    def __init__(self, context: moderngl.Context, world: World, detail: DetailConfig,
                 surface: Surface, lamp: bool) -> None:
        """Make meshes and programs; surface: textures to light with; lamp: whether there is one.
        """
        self._context, self._detail, self._surface = context, detail, surface
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
            name: load_program(context, 'screen', 'ground', LEVELS=len(world.levels),
                               RELIEF_LEVELS=LEVELS, ZONE=ZONE,
                               **flags, **({'LAMP': 1} if lamp and 'lit' in name.split() else {}))
            for name, flags in _SHADERS.items()}
        self.programs = tuple(self._programs.values())
        self._screens = {name: context.vertex_array(program, [])
                         for name, program in self._programs.items()}

    def choose(self, volume: ViewVolume) -> Chosen:
        """Choose what to draw for a view."""
        return [level.tree.select(volume, reach)
                for level, reach in zip(self._levels, self._ranges)]

    def draw_depth(self, chosen: Chosen) -> None:
        """Draw the depth of the chosen meshes into the framebuffer in use."""
        context, programs = self._context, self._depth_programs
        for level, selection in zip(self._levels, chosen):
            name = 'inner' if level.tree.aligned else 'outer'
            context.enable_only(context.DEPTH_TEST | context.CULL_FACE)
            level.bind(programs[name])
            self._mesh.draw(programs[name], selection.chunks)
            context.enable_only(context.DEPTH_TEST)     # skirts are seen from both sides
            level.bind(programs[f'{name} skirt'])
            self._mesh.draw(programs[f'{name} skirt'], selection.skirts, skirt=True)

    def rows(self, chosen: Chosen, projection: Projection,
             T_world_camera: Array) -> tuple[int, int, int]:
        """Return the rows that the ground covers, the same in both images of a rectified pair.

        They are: the first one, the first one below all coarse meshes, the one after the last.
        """
        spans = [projection.covered_rows(selection.boxes, T_world_camera)
                 for selection in chosen if len(selection.chunks)]
        if not spans:
            return 0, 0, 0
        first, last = min(s[0] for s in spans), max(s[1] for s in spans)
        coarse = chosen[0].boxes[chosen[0].chunks[:, 2] > 1.0]
        middle = projection.covered_rows(coarse, T_world_camera)[1] if len(coarse) else first
        return first, max(first, middle), last

    def draw(self, target: moderngl.Framebuffer, window: Window, rows: tuple[int, int, int],
             ground_depth: moderngl.Texture, *, lit: bool) -> None:
        """Light the pixels that the meshes cover, or with `lit` false, only compute their depth.

        rows: see `rows`; where the meshes may be coarser than the grid, depth is refined first
        """
        first, middle, last = rows
        self._context.enable_only(self._context.NOTHING)
        kind = 'lit' if lit else 'unlit'
        for name, top, bottom in ((f'{kind} refined', first, middle), (kind, middle, last)):
            if top < bottom:
                target.viewport = (window[0], window[1] + top, window[2], bottom - top)
                self._draw_screen(name, ground_depth)

    def draw_truth(self, ground_depth: moderngl.Texture) -> None:
        """Draw normals and labels into the framebuffer in use."""
        self._context.enable_only(self._context.NOTHING)
        self._draw_screen('truth', ground_depth)

    def _draw_screen(self, name: str, ground_depth: moderngl.Texture) -> None:
        program = self._programs[name]
        self._surface.bind(program)
        ground_depth.use(texture_units.GROUND_DEPTH)
        set_uniform(program, u_depth=texture_units.GROUND_DEPTH)
        if name.endswith('refined'):
            finest = self._levels[0]
            finest.heights.use(texture_units.HEIGHTS)
            set_uniform(program, u_heights=texture_units.HEIGHTS, u_lattice=lattice(finest.grid),
                        u_refine=(0.8 * self._ranges[0][0], self._detail.exact_m, _MESH_ERROR_M))
        self._screens[name].render(vertices=3)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self._screens.values(), *self.programs, *self._depth_programs.values(),
                    self._mesh, *self._levels)
