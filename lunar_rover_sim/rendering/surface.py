"""Textures of the ground: slope and shadow of the grids, albedo, tiles of finer relief."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
import dataclasses
from typing import Any, TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.illumination.horizon import SunGeometry
from lunar_rover_sim.illumination.sunlight import Sunlight
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.context import set_uniform
from lunar_rover_sim.world import fine_relief
from lunar_rover_sim.world.model import World

if TYPE_CHECKING:
    import moderngl

F32 = NDArray[np.float32]

_TURN_DEG = 27.0        # of the fine tile against the coarse one
_SLOPE_SCALE = 3.0      # slopes of the tiles are kept within half of this, to both sides
_TILES = (dict(n=2048, period_m=6.4, longest_m=0.08, hurst=0.7, pit_share=1.0,
               pit_m=(0.025, 0.22), pebble_m=(0.011, 0.035)),
          dict(n=1024, period_m=0.83, longest_m=0.012, hurst=0.6, pit_share=0.5,
               pit_m=(0.005, 0.025), pebble_m=(0.0035, 0.011)))


@dataclasses.dataclass(frozen=True)
class Relief:
    """Periodic relief below the grid: (n, n) heights [m] over a square of side period_m."""

    period_m: float
    height_m: F32


Tiles = tuple[list[Relief], list[list[NDArray[np.uint8]]]]


class TileMaker:
    """Makes the tiles under any sun; the relief, which is the same under all, once."""

    def __init__(self, config: DetailConfig, seed: int) -> None:
        self._config, self._seed = config, seed
        self._reliefs: list[Relief] = []

    def start(self, sun_direction: Array) -> Future[Tiles]:
        """Make the reliefs, coarse to fine, and for each its RGBA8 mip levels, in a thread."""
        pool = ThreadPoolExecutor(1)
        try:
            return pool.submit(self._make, SunGeometry.towards(sun_direction))
        finally:
            pool.shutdown(wait=False)

    def _make(self, sun: SunGeometry) -> Tiles:
        if not self._reliefs:
            self._reliefs = _make_reliefs(self._config, self._seed)
        return self._reliefs, _make_tiles(self._reliefs, sun)


def _make_reliefs(config: DetailConfig, seed: int) -> list[Relief]:
    reliefs = []
    for k, values in enumerate(_TILES):
        values = dict(values)
        pits = config.pit_cover * values.pop('pit_share')  # type: ignore[operator]
        recipe = fine_relief.TileRecipe(
            pit_cover=pits, rms_slope=config.relief_rms_slope,
            pebble_cover=0.5 * config.pebble_cover, **values)  # type: ignore[arg-type]
        reliefs.append(Relief(recipe.period_m,
                              fine_relief.relief(recipe, np.random.default_rng([seed, 77, k]))))
    return reliefs


def _make_tiles(reliefs: list[Relief], sun: SunGeometry) -> list[list[NDArray[np.uint8]]]:
    centre, half_range = _horizon_range(sun)
    tangents = centre + half_range * np.linspace(-1.0, 1.0, 9)
    tiles = []
    for k, relief in enumerate(reliefs):
        texel = relief.period_m / relief.height_m.shape[0]
        horizon = fine_relief.horizon(
            relief.height_m, texel, sun.azimuth_rad + k * np.radians(_TURN_DEG), tangents)
        tiles.append(fine_relief.mip_levels(
            fine_relief.slopes(relief.height_m, texel), horizon, _SLOPE_SCALE, centre,
            half_range))
    return tiles


def _horizon_range(sun: SunGeometry) -> tuple[float, float]:
    """Return centre and half range of the tangents of the horizon that matter under this sun."""
    tangent = np.tan(min(sun.elevation_rad, np.radians(75.0)))
    return float(tangent), float(0.4 * (1.0 + tangent**2))


class Surface:
    """Owns the textures that the ground and the rocks are shaded with."""

    def __init__(self, context: moderngl.Context, world: World, sunlight: Sunlight,
                 reliefs: list[Relief], tiles: list[list[NDArray[np.uint8]]]) -> None:
        # One layer per level; a smaller level fills the corner of its layer.
        self._side = max(grid.n for grid in world.levels)
        layers = len(world.levels)
        self._ground = context.texture_array((self._side, self._side, layers), 4, dtype='f2')
        self._matter = context.texture_array((self._side, self._side, layers), 4, dtype='f1')

        def texels(k: int) -> tuple[NDArray[np.float16], NDArray[np.uint8]]:
            grid = world.levels[k]
            albedo = world.albedo if k == 0 else np.ones((grid.n, grid.n), np.float32)
            return (_ground_texels(grid.heights_m, grid.cell_m, *sunlight.clearance[k]),
                    _matter_texels(albedo, *sunlight.scattered[k]))

        with ThreadPoolExecutor(2) as pool:
            for k, (ground, matter) in enumerate(pool.map(texels, range(layers))):
                area = (0, 0, k, world.levels[k].n, world.levels[k].n, 1)
                self._ground.write(ground, area)
                self._matter.write(matter, area)
        for texture in (self._ground, self._matter):
            texture.build_mipmaps()
            texture.filter = (context.LINEAR_MIPMAP_LINEAR, context.LINEAR)
            texture.repeat_x = texture.repeat_y = False
        # Albedo and scattered light are smooth: the nearest mip level will do.
        self._matter.filter = (context.LINEAR_MIPMAP_NEAREST, context.LINEAR)
        self._levels = np.array([[1.0 / (self._side * grid.cell_m), 0.5 * grid.n / self._side,
                                  -np.log2(grid.cell_m), grid.half_extent_m]
                                 for grid in world.levels])
        self._centre, self._half_range = _horizon_range(sunlight.sun)
        self._tiles, self._periods = [], [relief.period_m for relief in reliefs]
        for levels in tiles:
            size = levels[0].shape[0]
            tile = context.texture((size, size), 4, levels[0], dtype='f1')
            tile.build_mipmaps()
            for k, level in enumerate(levels):
                tile.write(level, level=k)
            tile.filter = (context.LINEAR_MIPMAP_LINEAR, context.LINEAR)
            self._tiles.append(tile)

    def bind(self, program: moderngl.Program) -> None:
        """Bind what the ground is lit with."""
        textures: list[Any] = [self._ground, self._matter, *self._tiles]
        for unit, texture in enumerate(textures):
            texture.use(1 + unit)
        angle = np.radians(_TURN_DEG)
        set_uniform(program, u_ground=1, u_matter=2, u_tile_a=3, u_tile_b=4,
                    u_level=np.ascontiguousarray(self._levels, np.float32),
                    u_lod=tuple(float(-np.log2(p / t.width))
                                for p, t in zip(self._periods, self._tiles)),
                    u_tile=(1.0 / self._periods[0], 1.0 / self._periods[1], _SLOPE_SCALE,
                            _SLOPE_SCALE),
                    u_turn=(float(np.cos(angle)), float(np.sin(angle)), self._centre,
                            self._half_range))

    def release(self) -> None:
        """Release the GL objects."""
        self._ground.release()
        self._matter.release()
        for tile in self._tiles:
            tile.release()

    def bind_rocks(self, program: moderngl.Program) -> None:
        """Bind what rocks are lit with."""
        self._matter.use(2)
        self._tiles[0].use(3)
        set_uniform(program, u_matter=2, u_grid=tuple(self._levels[0, :2]), u_tile_a=3,
                    u_grain=(1.0 / 3.1, 1.0, 0.11, 1.4))


def _ground_texels(heights_m: F32, cell_m: float, clearance_m: F32,
                   occluder_m: F32) -> NDArray[np.float16]:
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


def _matter_texels(albedo: F32, irradiance: F32, surroundings: F32) -> NDArray[np.uint8]:
    n = albedo.shape[0]
    data = np.zeros((n, n, 4), np.uint8)
    for channel, value in enumerate((albedo * np.float32(0.5), np.sqrt(4.0 * irradiance),
                                     np.sqrt(4.0 * surroundings))):
        if value.shape[0] != n:
            value = cv2.resize(value, (n, n), interpolation=cv2.INTER_LINEAR)
        data[..., channel] = np.clip(np.rint(value * 255.0), 0, 255)
    return data
