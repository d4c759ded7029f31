"""Textures of the ground: slope and shadow of the grids, albedo, tiles of finer relief."""

from __future__ import annotations

import moderngl
import numpy as np

from lunar_rover_sim.rendering import texture_units
from lunar_rover_sim.rendering.context import release_all, set_uniform
from lunar_rover_sim.rendering.ground_texels import LevelTexels
from lunar_rover_sim.rendering.relief_brightness import (LEAST_FACTOR, LEAST_SCALES,
                                                         ReliefBrightness)
from lunar_rover_sim.rendering.relief_tiles import ReliefTiles
from lunar_rover_sim.world.model import World

_CELL_M = 1.0           # side of the triangles between the cells of the relief below the grid
ZONE = 0.1              # of the way to the middle of a cell, where the next one may be drawn
_GRAIN = (1.0 / 3.1, 1.0, 0.11, 1.4)    # of rocks, see u_grain in shaders/rock.frag


class Surface:
    """The textures that the ground and the rocks are lit with.

    Attributes:
        tiles: Of the relief below the grid, under the present sun.
    """

    def __init__(self, context: moderngl.Context, world: World) -> None:
        """Make textures of all levels; `light` fills them."""
        self._context, self._world = context, world
        # One layer per level; a smaller level fills the corner of its layer.
        side = max(grid.n for grid in world.levels)
        size = (side, side, len(world.levels))
        self._ground = context.texture_array(size, 4, dtype='f2')
        self._matter = context.texture_array(size, 4, dtype='f1')
        for texture in (self._ground, self._matter):
            texture.repeat_x = texture.repeat_y = False
        self._levels = np.array([[1.0 / (side * grid.cell_m), 0.5 * grid.n / side,
                                  -np.log2(grid.cell_m), grid.half_extent_m]
                                 for grid in world.levels])
        self._relief: list[moderngl.Texture | moderngl.Texture3D] = []

    def light(self, texels: list[LevelTexels], tiles: ReliefTiles,
              brightness: ReliefBrightness) -> None:
        """Fill the textures for a sun; texels: of each level; tiles, brightness: under that sun.
        """
        context = self._context
        for k, (grid, (ground, matter)) in enumerate(zip(self._world.levels, texels)):
            area = (0, 0, k, grid.n, grid.n, 1)
            self._ground.write(ground, area)
            self._matter.write(matter, area)
        for texture in (self._ground, self._matter):
            texture.build_mipmaps()
        self._ground.filter = (context.LINEAR_MIPMAP_LINEAR, context.LINEAR)
        # Albedo and scattered light are smooth: the nearest mip level suffices.
        self._matter.filter = (context.LINEAR_MIPMAP_NEAREST, context.LINEAR)
        self._release_relief()
        self.tiles, self._brightness = tiles, brightness
        for tile in (tiles.coarse, tiles.fine):
            n = len(tile.codes[0])
            relief = context.texture((n, n), 4, tile.codes[0], dtype='f1')
            relief.build_mipmaps()
            for level, codes in enumerate(tile.codes):
                relief.write(codes, level=level)
            relief.filter = (context.LINEAR_MIPMAP_LINEAR, context.LINEAR)
            self._relief.append(relief)
        factor = brightness.factor
        roots = np.rint(255.0 * np.sqrt(LEAST_FACTOR / factor)).astype(np.uint8)
        nodes = context.texture3d(factor.shape[2::-1], 4, roots, dtype='f1')
        nodes.repeat_x = nodes.repeat_y = nodes.repeat_z = False
        self._relief.append(nodes)

    def bind(self, program: moderngl.Program) -> None:
        """Bind what the ground is lit with."""
        self._ground.use(texture_units.GROUND)
        self._matter.use(texture_units.MATTER)
        for texture, unit in zip(self._relief, (texture_units.TILE_A, texture_units.TILE_B,
                                                texture_units.RELIEF_FACTOR)):
            texture.use(unit)
        tiles, brightness = self.tiles, self._brightness
        set_uniform(program, u_ground=texture_units.GROUND, u_matter=texture_units.MATTER,
                    u_tile_a=texture_units.TILE_A, u_tile_b=texture_units.TILE_B,
                    u_factor=texture_units.RELIEF_FACTOR,
                    u_level=np.ascontiguousarray(self._levels, np.float32),
                    u_tile=(1.0 / tiles.coarse.period_m, 1.0 / tiles.fine.period_m, 1.0 / _CELL_M,
                            float(-np.log2(tiles.fine.texel_m))),
                    u_horizon=(tiles.centre, tiles.half_range), u_scales=brightness.scales,
                    u_least_scales=LEAST_SCALES,
                    u_sun_level=1.0 / brightness.tangent)

    def bind_rocks(self, program: moderngl.Program) -> None:
        """Bind what rocks are lit with."""
        self._relief[0].use(texture_units.TILE_A)
        set_uniform(program, u_tile_a=texture_units.TILE_A, u_grain=_GRAIN)

    def release(self) -> None:
        """Release the GL objects."""
        self._release_relief()
        self._ground.release()
        self._matter.release()

    def _release_relief(self) -> None:
        release_all(*self._relief)
        self._relief.clear()
