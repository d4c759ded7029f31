"""What the ground and the rocks are lit with: texels of the grids, tiles of finer relief."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.rendering.ground_texels import LevelTexels
from lunar_rover_sim.image.rendering.mip_texels import mip_texels, MipTexels, packed_levels
from lunar_rover_sim.image.rendering.relief_brightness import (LEAST_FACTOR, LEAST_SCALES, LEVELS,
                                                               ReliefBrightness)
from lunar_rover_sim.image.rendering.relief_rows import place_in_site
from lunar_rover_sim.image.rendering.relief_tiles import ReliefTiles

F32 = NDArray[np.float32]

_CELL_M = 1.0           # side of the triangles between the cells of the relief below the grid
_ZONE = 0.1             # of the way to the middle of a cell, where the next one may be drawn


@dataclasses.dataclass(frozen=True)
class SurfaceTexels:
    """What compiled loops light the ground with; arguments of those are explained there.

    Attributes:
        levels, ground, matter: Of `grid_rows.light_of_grid`.
        coarse, fine, tile, horizon: Of `relief_rows.relief_of`.
        factor: Of `relief_factor.relief_factor`.
        sun_tangent: That of its elevation over level ground, at least a hundredth.
        scales: Of `shade_rows.shade`.
        fine_log2: log2 of texels of the fine tile per metre.
    """

    levels: F32
    ground: MipTexels
    matter: MipTexels
    coarse: MipTexels
    fine: MipTexels
    tile: F32
    horizon: F32
    factor: NDArray[np.uint32]
    sun_tangent: float
    scales: F32
    fine_log2: float

    zone = np.float32(_ZONE)
    last = float(LEVELS - 1)
    least_scales = np.array(LEAST_SCALES, np.float32)


def surface_texels(world: World, levels: list[LevelTexels], tiles: ReliefTiles,
                   brightness: ReliefBrightness) -> SurfaceTexels:
    """Return the texels of a world, in a frame of its own, under a sun.

    Args:
        levels: Of each grid.
        tiles, brightness: Of the relief below the grid, under that sun.
    """
    grids = world.levels
    side = max(grid.n for grid in grids)
    places = np.array([[1.0 / (side * grid.cell_m), 0.5 * grid.n / side,
                        -np.log2(grid.cell_m), grid.half_extent_m] for grid in grids])
    factor = brightness.factor
    roots = np.rint(255.0 * np.sqrt(LEAST_FACTOR / factor)).astype(np.uint8)
    tile = np.array([1.0 / tiles.coarse.period_m, 1.0 / tiles.fine.period_m, 1.0 / _CELL_M],
                    np.float32)
    return SurfaceTexels(
        places.astype(np.float32), mip_texels([level.ground for level in levels], side),
        mip_texels([level.matter for level in levels], side),
        packed_levels(tiles.coarse.codes), packed_levels(tiles.fine.codes),
        np.concatenate([tile, place_in_site(tile, world.origin_m)]),
        np.array([tiles.centre, tiles.half_range], np.float32),
        np.ascontiguousarray(roots).view(np.uint32)[..., 0], brightness.tangent,
        np.asarray(brightness.scales, np.float32), float(-np.log2(tiles.fine.texel_m)))


@dataclasses.dataclass
class Surface:
    """What the ground and the rocks are lit with at present.

    Attributes:
        tiles: Of the relief below the grid, under the present sun.
        texels: Of the ground.
    """

    tiles: ReliefTiles
    texels: SurfaceTexels
