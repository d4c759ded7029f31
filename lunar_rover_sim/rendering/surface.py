"""Textures of the ground: slope and shadow of the grids, albedo, tiles of finer relief."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
import dataclasses

import cv2
import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.illumination.horizon import SunGeometry
from lunar_rover_sim.illumination.sunlight import Sunlight
from lunar_rover_sim.rendering import texture_units
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.context import set_uniform
from lunar_rover_sim.world import fine_relief
from lunar_rover_sim.world.far_albedo import far_albedo
from lunar_rover_sim.world.model import World

F32 = NDArray[np.float32]

_TURN_DEG = 27.0        # of the fine tile relative to the coarse one
_SLOPE_SCALE = 3.0      # slopes of the tiles lie within plus and minus half of this
_GRAIN = (1.0 / 3.1, 1.0, 0.11, 1.4)    # of rocks, see u_grain in shaders/rock.frag
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
    """Makes the tiles of relief below the grid under any sun; the relief itself only once."""

    def __init__(self, config: DetailConfig, seed: int) -> None:
        self._config, self._seed = config, seed
        self._reliefs: list[Relief] = []

    def start(self, sun_direction: Array) -> Future[Tiles]:
        """Start making the reliefs, coarse to fine, and the RGBA8 mip levels of each."""
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
    """Return centre and half range of the tangents that the horizon may have under this sun."""
    tangent = np.tan(min(sun.elevation_rad, np.radians(75.0)))
    return float(tangent), float(0.4 * (1.0 + tangent**2))


class Surface:
    """The textures that the ground and the rocks are lit with."""

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
        self._albedos: dict[int, F32] = {0: world.albedo}
        self._tiles: list[moderngl.Texture] = []
        self._periods_m: list[float] = []
        self._centre, self._half_range = 0.0, 0.0

    def light(self, sunlight: Sunlight, reliefs: list[Relief],
              tiles: list[list[NDArray[np.uint8]]]) -> None:
        """Fill the textures for a sun; reliefs, tiles: as `TileMaker` makes them."""
        context, levels = self._context, self._world.levels

        def texels(k: int) -> tuple[NDArray[np.float16], NDArray[np.uint8]]:
            grid = levels[k]
            matter = _matter_texels(self._albedo(k), *sunlight.scattered[k])
            if k > 0:
                matter[..., 3] = sunlight.rock_share[k - 1]
            return (_ground_texels(grid.heights_m, grid.cell_m, *sunlight.clearance[k]), matter)

        with ThreadPoolExecutor(2) as pool:
            for k, (ground, matter) in enumerate(pool.map(texels, range(len(levels)))):
                area = (0, 0, k, levels[k].n, levels[k].n, 1)
                self._ground.write(ground, area)
                self._matter.write(matter, area)
        for texture in (self._ground, self._matter):
            texture.build_mipmaps()
        self._ground.filter = (context.LINEAR_MIPMAP_LINEAR, context.LINEAR)
        # Albedo and scattered light are smooth: the nearest mip level suffices.
        self._matter.filter = (context.LINEAR_MIPMAP_NEAREST, context.LINEAR)
        self._centre, self._half_range = _horizon_range(sunlight.sun)
        self._release_tiles()
        self._periods_m = [relief.period_m for relief in reliefs]
        for mips in tiles:
            size = mips[0].shape[0]
            tile = context.texture((size, size), 4, mips[0], dtype='f1')
            tile.build_mipmaps()
            for k, mip in enumerate(mips):
                tile.write(mip, level=k)
            tile.filter = (context.LINEAR_MIPMAP_LINEAR, context.LINEAR)
            self._tiles.append(tile)

    def _albedo(self, k: int) -> F32:
        """Return the albedo factor of a level, which does not depend on the sun."""
        if k not in self._albedos:
            self._albedos[k] = far_albedo(self._world, k)
        return self._albedos[k]

    def bind(self, program: moderngl.Program) -> None:
        """Bind what the ground is lit with."""
        self._ground.use(texture_units.GROUND)
        self._matter.use(texture_units.MATTER)
        self._tiles[0].use(texture_units.TILE_A)
        self._tiles[1].use(texture_units.TILE_B)
        angle = np.radians(_TURN_DEG)
        set_uniform(program, u_ground=texture_units.GROUND, u_matter=texture_units.MATTER,
                    u_tile_a=texture_units.TILE_A, u_tile_b=texture_units.TILE_B,
                    u_level=np.ascontiguousarray(self._levels, np.float32),
                    u_lod=tuple(float(-np.log2(p / t.width))
                                for p, t in zip(self._periods_m, self._tiles)),
                    u_tile=(1.0 / self._periods_m[0], 1.0 / self._periods_m[1], _SLOPE_SCALE,
                            _SLOPE_SCALE),
                    u_turn=(float(np.cos(angle)), float(np.sin(angle)), self._centre,
                            self._half_range))

    def bind_rocks(self, program: moderngl.Program) -> None:
        """Bind what rocks are lit with."""
        self._tiles[0].use(texture_units.TILE_A)
        set_uniform(program, u_tile_a=texture_units.TILE_A, u_grain=_GRAIN)

    def release(self) -> None:
        """Release the GL objects."""
        self._release_tiles()
        self._ground.release()
        self._matter.release()

    def _release_tiles(self) -> None:
        for tile in self._tiles:
            tile.release()
        self._tiles.clear()


def _ground_texels(heights_m: F32, cell_m: float, clearance_m: F32,
                   occluder_m: F32) -> NDArray[np.float16]:
    """Return (n, n, 4) texels of u_ground in shaders/ground.frag."""
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
    """Return (n, n, 4) texels of u_matter in shaders/ground.frag; no rock casts a shadow."""
    n = albedo.shape[0]
    data = np.zeros((n, n, 4), np.uint8)
    for channel, value in enumerate((albedo * np.float32(0.5), np.sqrt(4.0 * irradiance),
                                     np.sqrt(4.0 * surroundings))):
        if value.shape[0] != n:
            value = cv2.resize(value, (n, n), interpolation=cv2.INTER_LINEAR)
        data[..., channel] = np.clip(np.rint(value * 255.0), 0, 255)
    return data
