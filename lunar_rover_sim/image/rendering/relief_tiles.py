"""The tiles of relief below the grid, as the ground is drawn with them."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
import dataclasses
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world import fine_relief
from lunar_rover_sim.ground.world.kept_arrays import kept
from lunar_rover_sim.image.illumination.horizon import SunGeometry
from lunar_rover_sim.image.rendering.config import DetailConfig

F32 = NDArray[np.float32]

SLOPE_SCALE = 3.0       # slopes of the tiles lie within plus and minus half of this
FINER = 2               # the texel of the fine tile is 2**-FINER of that of the coarse one
RISE_OVER = 0.4         # `rises` is that of a point so many texels above the ground
_FLAT_TEXELS = 256      # along a side of a tile without relief: any texel of it is like the others
_TILES = (dict(n=2048, period_m=6.4, longest_m=0.08, hurst=0.7, pit_share=1.0,
               pit_m=(0.025, 0.22), pebble_m=(0.011, 0.035)),
          dict(n=2048, period_m=1.6, longest_m=0.012, hurst=0.6, pit_share=0.5,
               pit_m=(0.005, 0.025), pebble_m=(0.0035, 0.011)))


@dataclasses.dataclass(frozen=True)
class ReliefTile:
    """One periodic tile under a sun.

    Attributes:
        period_m: Side of the tile.
        heights, rises: (n, n) [m], and as `fine_relief.rises` has them; the same under every sun.
        codes: RGBA8 of each mip level, (n, n, 4), see `fine_relief.TileLevels`.
        slope_variance, spread: (levels,), as there.
    """

    period_m: float
    heights: F32
    rises: F32
    codes: list[NDArray[np.uint8]]
    slope_variance: Array
    spread: Array

    @property
    def texel_m(self) -> float:
        """Side of a texel of the finest level."""
        return self.period_m / len(self.codes[0])


@dataclasses.dataclass(frozen=True, eq=False)
class ReliefTiles:
    """The tiles under a sun; the next renderer of the same scene has the same object.

    Attributes:
        heading: (2,) horizontal unit vector towards the sun.
        centre, half_range: Of the tangents of the horizon.
        recipe: All that they follow from, as JSON can write it.
    """

    coarse: ReliefTile
    fine: ReliefTile
    heading: Array
    centre: float
    half_range: float
    recipe: list[Any]

    @property
    def flat(self) -> bool:
        """Whether there is no relief in them."""
        return not (self.coarse.slope_variance.any() or self.fine.slope_variance.any())


def start_tiles(config: DetailConfig, seed: int, sun_direction: Array) -> Future[ReliefTiles]:
    """Start making the tiles of relief below the grid under a sun."""
    pool, recipes = ThreadPoolExecutor(1), _recipes(config)
    make = _new_tiles if all(_is_flat(recipe) for recipe in recipes) else _tiles
    try:
        return pool.submit(make, recipes, seed, SunGeometry.towards(sun_direction))
    finally:
        pool.shutdown(wait=False)


def relief_heights(config: DetailConfig, seed: int) -> list[tuple[float, F32]]:
    """Return period [m] and periodic (n, n) heights [m] of the coarse and the fine tile."""
    return [(recipe.period_m, _relief(recipe, seed, k))
            for k, recipe in enumerate(_recipes(config))]


def _new_tiles(recipes: tuple[fine_relief.TileRecipe, ...], seed: int,
               sun: SunGeometry) -> ReliefTiles:
    centre, half_range = _horizon_range(sun)
    coarse, fine = (_tile(recipe.period_m, *_shape(recipe, seed, k), sun, centre, half_range)
                    for k, recipe in enumerate(recipes))
    recipe = [*(_identity(recipe, seed, k) for k, recipe in enumerate(recipes)), RISE_OVER,
              SLOPE_SCALE, sun.azimuth_rad, sun.elevation_rad]
    return ReliefTiles(coarse, fine, np.asarray(sun.direction_xy), centre, half_range, recipe)


# For the next renderer of the same scene. Flat ones, made at once, would only displace others.
_tiles = functools.lru_cache(maxsize=2)(_new_tiles)


@functools.lru_cache(maxsize=2)     # both tiles, for the next sun
def _relief(recipe: fine_relief.TileRecipe, seed: int, k: int) -> F32:
    """Return the heights of tile k, which take most of the time to make it."""
    return kept('relief', _identity(recipe, seed, k),
                lambda: fine_relief.relief(recipe, np.random.default_rng([seed, 77, k])))


@functools.lru_cache(maxsize=2)     # both tiles
def _shape(recipe: fine_relief.TileRecipe, seed: int, k: int) -> tuple[F32, F32]:
    """Return heights and rises of tile k."""
    heights = _relief(recipe, seed, k)
    texel = recipe.period_m / len(heights)
    return heights, kept('rises', [*_identity(recipe, seed, k), RISE_OVER],
                         lambda: fine_relief.rises(heights, texel, RISE_OVER * texel))


def _identity(recipe: fine_relief.TileRecipe, seed: int, k: int) -> list[Any]:
    """Return what the heights of tile k follow from."""
    return [fine_relief.RECIPE, dataclasses.asdict(recipe), seed, k]


def _recipes(config: DetailConfig) -> tuple[fine_relief.TileRecipe, ...]:
    return tuple(_recipe(config, k) for k in range(len(_TILES)))


def _recipe(config: DetailConfig, k: int) -> fine_relief.TileRecipe:
    values = dict(_TILES[k])
    pits = config.pit_cover * values.pop('pit_share')   # type: ignore[operator]
    recipe = fine_relief.TileRecipe(
        pit_cover=pits, rms_slope=config.relief_rms_slope,
        pebble_cover=0.5 * config.pebble_cover, **values)   # type: ignore[arg-type]
    return dataclasses.replace(recipe, n=_FLAT_TEXELS) if _is_flat(recipe) else recipe


def _is_flat(recipe: fine_relief.TileRecipe) -> bool:
    return recipe.rms_slope == recipe.pit_cover == recipe.pebble_cover == 0.0


def _tile(period_m: float, heights: F32, rises: F32, sun: SunGeometry, centre: float,
          half_range: float) -> ReliefTile:
    texel = period_m / heights.shape[0]
    tangents = centre + half_range * np.linspace(-1.0, 1.0, 9)
    horizon = fine_relief.horizon(heights, texel, sun.azimuth_rad, tangents)
    levels = fine_relief.mip_levels(fine_relief.slopes(heights, texel), horizon, rises,
                                    SLOPE_SCALE, centre, half_range)
    return ReliefTile(period_m, heights, rises, levels.codes, levels.slope_variance, levels.spread)


def _horizon_range(sun: SunGeometry) -> tuple[float, float]:
    """Return centre and half range of the tangents that the horizon may have under this sun."""
    tangent = np.tan(min(sun.elevation_rad, np.radians(75.0)))
    return float(tangent), float(0.4 * (1.0 + tangent**2))
