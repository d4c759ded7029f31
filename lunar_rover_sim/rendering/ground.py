"""The ground of all levels: what of it is drawn for a view, and which rows it covers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.context import set_uniform
from lunar_rover_sim.rendering.projection import covered_rows
from lunar_rover_sim.rendering.terrain import (ChunkMesh, lattice, level_ranges, Selection,
                                               TerrainLevel, ViewVolume)
from lunar_rover_sim.world.model import World

if TYPE_CHECKING:
    import moderngl

_MESH_ERROR_M = 0.012     # of the coarse meshes within `exact_m`, on ground of usual roughness

Chosen = list[Selection]        # of each level


class Ground:
    """GL objects of the nested height grids."""

    def __init__(self, context: moderngl.Context, world: World, detail: DetailConfig) -> None:
        self._context, self._detail = context, detail
        self._levels = []
        inner = 0.0
        for grid in world.levels:
            self._levels.append(TerrainLevel(context, grid, inner))
            inner = grid.half_extent_m
        self._mesh = ChunkMesh(context)
        self._ranges = level_ranges([level.tree for level in self._levels], detail)

    def choose(self, view: ViewVolume) -> Chosen:
        """Choose what to draw for a view."""
        return [level.tree.select(view, reach)
                for level, reach in zip(self._levels, self._ranges)]

    def draw(self, programs: dict[str, moderngl.Program], chosen: Chosen) -> None:
        """Draw the chosen meshes with the programs 'inner', 'outer' and those of their skirts."""
        context = self._context
        for level, selection in zip(self._levels, chosen):
            name = 'inner' if level.tree.aligned else 'outer'
            context.enable_only(context.DEPTH_TEST | context.CULL_FACE)
            level.bind(programs[name])
            self._mesh.draw(programs[name], selection.chunks)
            context.enable_only(context.DEPTH_TEST)     # skirts are seen from both sides
            level.bind(programs[f'{name} skirt'])
            self._mesh.draw(programs[f'{name} skirt'], selection.skirts, skirt=True)

    def rows(self, chosen: Chosen, camera: Array, K: Array, height: int,
             near_m: float) -> tuple[int, int, int]:
        """Return first row of ground, first below all coarse meshes, and the one after the last.

        camera, K, height, near_m: as for `covered_rows`; the eyes of a rectified pair have the
        same rows
        """
        def span(boxes: Array) -> tuple[int, int]:
            return covered_rows(boxes, camera, K, height, near_m)

        spans = [span(selection.boxes) for selection in chosen if len(selection.chunks)]
        if not spans:
            return 0, 0, 0
        first, last = min(s[0] for s in spans), max(s[1] for s in spans)
        coarse = chosen[0].boxes[chosen[0].chunks[:, 2] > 1.0]
        middle = span(coarse)[1] if len(coarse) else first
        return first, max(first, middle), last

    def bind_exact(self, program: moderngl.Program) -> None:
        """Bind what the exact intersection with the finest grid needs."""
        finest = self._levels[0]
        finest.heights.use(0)
        set_uniform(program, u_heights=0, u_lattice=lattice(finest.grid),
                    u_refine=(0.8 * self._ranges[0][0], self._detail.exact_m, _MESH_ERROR_M))
