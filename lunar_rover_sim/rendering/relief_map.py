"""The shape of the relief below the grid near the cameras: a texture that wraps around.

Depth is found by a ray's steps over these heights, and all that follows from depth sees one
ground. A block is drawn when it comes into view; blocks far apart share a place.
"""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.rendering import texture_units
from lunar_rover_sim.rendering.context import load_program, release_all, set_uniform
from lunar_rover_sim.rendering.ground_mesh import GridTexture, lattice
from lunar_rover_sim.rendering.projection import ViewVolume
from lunar_rover_sim.rendering.surface import Surface, ZONE

_TEXEL_M = 1.0 / 320.0      # that of the coarse tile
_BLOCK = 80                # texels along a side
_BLOCK_M = _BLOCK * _TEXEL_M
_BLOCKS = 22                # of the map, along a side: twice the most of `detail.relief_shape_m`
_LIFT_M = 1.0               # most that ground within reach is above or below that at the camera


class ReliefMap:
    """The texture of heights, and what brings it up to date.

    Attributes:
        reach_m: Distance up to which relief has shape.
    """

    def __init__(self, context: moderngl.Context, surface: Surface, finest: GridTexture,
                 reach_m: float) -> None:
        """surface: has the tiles; finest: the ground that the relief lies on."""
        self._context, self._surface, self._finest = context, surface, finest
        self.reach_m, tiles = reach_m, surface.tiles
        side = _BLOCK * _BLOCKS
        self._shape = context.texture((side, side), 2, bytes(4 * side**2), dtype='f2')
        self._shape.filter = (context.LINEAR, context.LINEAR)
        self._target = context.framebuffer([self._shape])
        self._tiles = [_texture(context, tile.heights, tile.rises)
                       for tile in (tiles.coarse, tiles.fine)]
        self._most_m = float(tiles.coarse.heights.max() + tiles.fine.heights.max())
        # Triangles are interpolated in the map, not in the heights below it.
        self._between = context.sampler(filter=(context.LINEAR, context.LINEAR), repeat_x=False,
                                        repeat_y=False)
        self._program = load_program(context, 'relief_map', 'relief_map', ZONE=ZONE,
                                     BLOCKS=float(_BLOCKS), BLOCK_M=_BLOCK_M)
        self._instances = context.buffer(reserve=8 * _BLOCKS**2, dynamic=True)
        self._array = context.vertex_array(self._program,
                                           [(self._instances, '2f /i', 'i_block')])
        self._drawn: NDArray[np.int64] = np.full((_BLOCKS, _BLOCKS, 2), np.iinfo(np.int64).max)

    def update(self, volume: ViewVolume) -> None:
        """Draw the blocks within reach that a view shows and that are not drawn yet."""
        first = np.floor((volume.centre_m[:2] - self.reach_m) / _BLOCK_M).astype(np.int64)
        end = np.floor((volume.centre_m[:2] + self.reach_m) / _BLOCK_M).astype(np.int64) + 1
        y, x = np.mgrid[first[1]:end[1], first[0]:end[0]]
        blocks = np.stack([x.ravel(), y.ravel()], axis=-1)
        rows, columns = blocks[:, 1] % _BLOCKS, blocks[:, 0] % _BLOCKS
        stale = np.any(self._drawn[rows, columns] != blocks, axis=1)
        if not stale.any():
            return
        ground_m = volume.centre_m[2] - volume.above_m
        boxes = np.empty((len(blocks), 2, 3))
        boxes[:, 0, :2], boxes[:, 1, :2] = (blocks - 0.1) * _BLOCK_M, (blocks + 1.1) * _BLOCK_M
        boxes[:, 0, 2], boxes[:, 1, 2] = ground_m - _LIFT_M, ground_m + _LIFT_M
        new = np.flatnonzero(stale & volume.sees(boxes))
        if len(new):
            self._drawn[rows[new], columns[new]] = blocks[new]
            self._draw(blocks[new])

    def _draw(self, blocks: NDArray[np.int64]) -> None:
        program, context = self._program, self._context
        self._target.use()
        self._target.viewport = (0, 0, *self._shape.size)
        context.enable_only(context.NOTHING)
        self._surface.bind(program)
        self._finest.bind(program)
        for name, texture, unit in (('u_shape_a', self._tiles[0], texture_units.SHAPE_A),
                                    ('u_shape_b', self._tiles[1], texture_units.SHAPE_B)):
            texture.use(unit)
            set_uniform(program, **{name: unit})
        self._instances.write(blocks.astype(np.float32).tobytes())
        self._array.render(mode=context.TRIANGLE_STRIP, vertices=4, instances=len(blocks))

    def bind(self, program: moderngl.Program) -> None:
        """Bind the map for a program that includes near_relief.glsl."""
        self._finest.heights.use(texture_units.BASE)
        self._between.use(texture_units.BASE)
        self._shape.use(texture_units.RELIEF)
        grid = self._finest.grid
        set_uniform(program, u_base=texture_units.BASE, u_relief=texture_units.RELIEF,
                    u_lattice=lattice(grid),
                    u_relief_scale=1.0 / (_BLOCKS * _BLOCK_M), u_relief_reach=self.reach_m,
                    u_relief_most=(self._most_m, grid.half_extent_m - grid.cell_m))

    def release(self) -> None:
        """Release the GL objects."""
        release_all(self._array, self._instances, self._program, self._between, self._target,
                    self._shape, *self._tiles)


def _texture(context: moderngl.Context, *channels: NDArray[np.float32]) -> moderngl.Texture:
    n = len(channels[0])
    texels = np.stack(channels, axis=-1).astype(np.float16)
    texture = context.texture((n, n), len(channels), np.ascontiguousarray(texels), dtype='f2')
    texture.build_mipmaps()
    texture.filter = (context.LINEAR_MIPMAP_NEAREST, context.LINEAR)
    return texture
