"""What ground and rocks are lit with: texels of the grids under a sun, tiles of finer relief."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
import dataclasses
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.ground.world.albedo import far_albedo, RECIPE
from lunar_rover_sim.ground.world.fine_relief import disc_share
from lunar_rover_sim.ground.world.kept_arrays import kept
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.illumination.sunlight import COARSE, Sunlight
from lunar_rover_sim.image.rendering.relief_brightness import (LEAST_FACTOR, LEAST_SCALES, LEVELS,
                                                               ReliefBrightness)
from lunar_rover_sim.image.rendering.relief_rows import place_in_site
from lunar_rover_sim.image.rendering.relief_tiles import ReliefTiles
from lunar_rover_sim.image.rendering.relief_views import ReliefViews

F32 = NDArray[np.float32]


class LevelTexels(NamedTuple):
    """Texels of a level, (n, n, 4) each, of `ground` and `matter` in `grid_rows`."""

    ground: NDArray[np.float16]
    matter: NDArray[np.uint8]


class GroundTexels:
    """Makes the texels of a world; it keeps what does not depend on the sun."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._albedos = {0: _albedo_texels(world.albedo)}

    def under(self, sunlight: Sunlight, k: int, sun_radius_rad: float) -> LevelTexels:
        """Return the texels of level k."""
        grid = self._world.levels[k]
        matter = _matter_texels(self._albedo(k), *sunlight.scattered[k])
        matter[..., 3] = (sunlight.rock_share[k - 1] if k > 0 else
                          _visibility(*sunlight.clearance[k], sun_radius_rad))
        return LevelTexels(
            _ground_texels(grid.heights_m, grid.cell_m, *sunlight.clearance[k]), matter)

    def _albedo(self, k: int) -> NDArray[np.uint8]:
        """Return the texels of the albedo factor of a level."""
        if k not in self._albedos:
            world, grid = self._world, self._world.levels[k]
            recipe = [RECIPE, world.hash, k, grid.n, grid.cell_m]

            def texels() -> NDArray[np.uint8]:
                return _albedo_texels(far_albedo(world, k))
            self._albedos[k] = (kept('far_albedo', recipe, texels)
                                if world.hash else texels())
        return self._albedos[k]


def _ground_texels(heights_m: F32, cell_m: float, clearance_m: F32,
                   occluder_m: F32) -> NDArray[np.float16]:
    """Return (n, n, 4) texels of `ground` in `grid_rows.light_of_grid`."""
    n = heights_m.shape[0]
    data = np.empty((n, n, 4), np.float16)
    slope = np.empty((n, n), np.float32)
    slope[:, 1:-1] = (heights_m[:, 2:] - heights_m[:, :-2]) * np.float32(0.5 / cell_m)
    slope[:, 0], slope[:, -1] = slope[:, 1], slope[:, -2]
    data[..., 0] = slope
    slope[1:-1] = (heights_m[2:] - heights_m[:-2]) * np.float32(0.5 / cell_m)
    slope[0], slope[-1] = slope[1], slope[-2]
    data[..., 1] = slope
    data[..., 2], data[..., 3] = clearance_m, occluder_m
    return data


def _visibility(clearance_m: F32, occluder_m: F32, radius_rad: float) -> NDArray[np.uint8]:
    """Return (n, n) the share of the sun that is seen, in steps of 1 / 255."""
    share = disc_share(clearance_m / (occluder_m * np.float32(radius_rad)))
    return np.rint(255.0 * share).astype(np.uint8)


def _albedo_texels(albedo: F32) -> NDArray[np.uint8]:
    """Return the first channel of `matter` in `grid_rows.light_of_grid`."""
    return np.clip(np.rint(albedo * np.float32(127.5)), 0, 255).astype(np.uint8)


def _matter_texels(albedo: NDArray[np.uint8], irradiance: F32,
                   surroundings: F32) -> NDArray[np.uint8]:
    """Return (n, n, 4) texels of `matter` in `grid_rows`, without their last channel."""
    n, side = albedo.shape[0], COARSE * len(irradiance)
    data = np.zeros((n, n, 4), np.uint8)
    data[..., 0] = albedo
    for channel, value in ((1, np.sqrt(4.0 * irradiance)), (2, np.sqrt(4.0 * surroundings))):
        value = cv2.resize(value, (side, side), interpolation=cv2.INTER_LINEAR)[:n, :n]
        data[..., channel] = np.clip(np.rint(value * 255.0), 0, 255)
    return data


_EVEN = 32


class MipTexels(NamedTuple):
    """Square textures, each with the same number of texels and mip levels.

    Attributes:
        words: All texels; those of a level begin at `first`, one texture after the other.
        side: (levels,) texels along a side of a level.
        first: (levels,) where it begins.
    """

    words: NDArray[Any]
    side: NDArray[np.int32]
    first: NDArray[np.int32]


def halving_side(n: int) -> int:
    """Return the side of textures of n texels that halves evenly five times.

    Texels of these levels then lie on the lattice of the site, the same in all of its windows.
    """
    return -(-n // _EVEN) * _EVEN


def mip_texels(textures: Sequence[NDArray[Any]], side: int) -> MipTexels:
    """Return textures with their mip levels, each the mean of the one before.

    Args:
        textures: (n, n, 4) float16 or uint8; a smaller one lies in the corner, and its border goes
            on.
        side: Of all.
    """
    sides = [side]
    while sides[-1] > 1:
        sides.append(sides[-1] // 2)
    kind = textures[0].dtype
    word = np.dtype(f'u{4 * kind.itemsize}')
    count = len(textures)
    first = np.cumsum([0, *(count * n * n for n in sides)])
    words = np.zeros(first[-1], word)

    def fill(k: int) -> None:
        levels = [words[start + k * n * n:start + (k + 1) * n * n].view(kind).reshape(n, n, 4)
                  for start, n in zip(first, sides)]
        m = len(textures[k])
        levels[0][:m, :m] = textures[k]
        levels[0][m:, :m], levels[0][:, m:] = levels[0][m - 1, :m], levels[0][:, m - 1:m]
        for finer, level in pairwise(levels):
            _halve(finer, level)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(fill, range(count)))
    return MipTexels(words, np.array(sides, np.int32), first[:-1].astype(np.int32))


def _halve(finer: NDArray[Any], level: NDArray[Any]) -> None:
    """Fill in the (n, n, 4) texels of a level, interpolated between those of the finer one."""
    n = len(level)
    mean = cv2.resize(finer.astype(np.float32), (n, n), interpolation=cv2.INTER_LINEAR).reshape(
        n, n, 4)
    level[:] = np.rint(mean, out=mean) if level.dtype == np.uint8 else mean


def packed_levels(codes: Sequence[NDArray[np.uint8]]) -> MipTexels:
    """Return a texture whose (n, n, 4) mip levels are given."""
    sides = np.array([len(level) for level in codes], np.int32)
    first = np.cumsum([0, *(len(level)**2 for level in codes)])[:-1].astype(np.int32)
    words = np.concatenate([np.ascontiguousarray(level).view(np.uint32).ravel()
                            for level in codes])
    return MipTexels(words, sides, first)


_CELL_M = 1.0           # side of the triangles between the cells of the relief below the grid
_ZONE = 0.1             # of the way to the middle of a cell, where the next one may be drawn


@dataclasses.dataclass(frozen=True)
class SurfaceTexels:
    """What compiled loops light the ground with; arguments of those are explained there.

    Attributes:
        levels, ground, matter: Of `grid_rows.light_of_grid`.
        coarse, fine, tile, horizon: Of `relief_rows.relief_of`.
        factor: Of `relief_brightness.relief_factor`.
        sun_tangent: That of its elevation over level ground, at least a hundredth.
        scales: Of `shade_rows.shade`.
        fine_log2: log2 of texels of the fine tile per metre.
        views: Of the relief at low views; None where it is drawn by its slopes everywhere.
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
    views: ReliefViews | None

    zone = np.float32(_ZONE)
    last = float(LEVELS - 1)
    least_scales = np.array(LEAST_SCALES, np.float32)


def surface_texels(world: World, levels: list[LevelTexels], tiles: ReliefTiles,
                   brightness: ReliefBrightness,
                   views: ReliefViews | None) -> SurfaceTexels:
    """Return the texels of a world, in a frame of its own, under a sun.

    Args:
        levels: Of each grid.
        tiles, brightness, views: Of the relief below the grid, under that sun.
    """
    grids = world.levels
    side = halving_side(max(grid.n for grid in grids))
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
        np.asarray(brightness.scales, np.float32), float(-np.log2(tiles.fine.texel_m)),
        views)


@dataclasses.dataclass
class Surface:
    """What the ground and the rocks are lit with at present.

    Attributes:
        tiles: Of the relief below the grid, under the present sun.
        texels: Of the ground.
    """

    tiles: ReliefTiles
    texels: SurfaceTexels
