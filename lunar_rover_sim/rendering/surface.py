"""Textures of the ground: slope and shadow of the grids, albedo, tiles of finer relief."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.illumination.sunlight import Sunlight
from lunar_rover_sim.rendering import texture_units
from lunar_rover_sim.rendering.context import release_all, set_uniform
from lunar_rover_sim.rendering.relief_brightness import (LEAST_FACTOR, LEAST_SCALES,
                                                         ReliefBrightness)
from lunar_rover_sim.rendering.relief_tiles import ReliefTiles
from lunar_rover_sim.world.far_albedo import far_albedo, RECIPE
from lunar_rover_sim.world.fine_relief import disc_share
from lunar_rover_sim.world.kept_arrays import kept
from lunar_rover_sim.world.model import World

F32 = NDArray[np.float32]

_CELL_M = 1.0           # side of the triangles between the cells of the relief below the grid
ZONE = 0.1              # of the way to the middle of a cell, where the next one may be drawn
_GRAIN = (1.0 / 3.1, 1.0, 0.11, 1.4)    # of rocks, see u_grain in shaders/rock.frag


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
        self._albedos = {0: _albedo_texels(world.albedo)}
        self._relief: list[moderngl.Texture | moderngl.Texture3D] = []

    def light(self, sunlight: Sunlight, sun_radius_rad: float, tiles: ReliefTiles,
              brightness: ReliefBrightness) -> None:
        """Fill the textures for a sun; tiles, brightness: under that sun."""
        context, levels = self._context, self._world.levels

        def texels(k: int) -> tuple[NDArray[np.float16], NDArray[np.uint8]]:
            grid = levels[k]
            matter = _matter_texels(self._albedo(k), *sunlight.scattered[k])
            share = (sunlight.rock_share[k - 1] if k > 0 else
                     _visibility(*sunlight.clearance[k], sun_radius_rad))
            matter[..., 3] = share
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
        self._release_relief()
        self._tiles, self._brightness = tiles, brightness
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

    def _albedo(self, k: int) -> NDArray[np.uint8]:
        """Return the texels of the albedo factor of a level, which do not depend on the sun."""
        if k not in self._albedos:
            world, grid = self._world, self._world.levels[k]
            recipe = [RECIPE, world.hash, k, grid.n, grid.cell_m]

            def texels() -> NDArray[np.uint8]:
                return _albedo_texels(far_albedo(world, k))
            self._albedos[k] = (kept('far_albedo', recipe, texels)
                                if world.hash else texels())
        return self._albedos[k]

    def bind(self, program: moderngl.Program) -> None:
        """Bind what the ground is lit with."""
        self._ground.use(texture_units.GROUND)
        self._matter.use(texture_units.MATTER)
        for texture, unit in zip(self._relief, (texture_units.TILE_A, texture_units.TILE_B,
                                                texture_units.RELIEF_FACTOR)):
            texture.use(unit)
        tiles, brightness = self._tiles, self._brightness
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


def _visibility(clearance_m: F32, occluder_m: F32, radius_rad: float) -> NDArray[np.uint8]:
    """Return (n, n) the share of the sun that is seen, in steps of 1 / 255."""
    share = disc_share(clearance_m / (occluder_m * np.float32(radius_rad)))
    return np.rint(255.0 * share).astype(np.uint8)


def _albedo_texels(albedo: F32) -> NDArray[np.uint8]:
    """Return the first channel of u_matter in shaders/ground.frag."""
    return np.clip(np.rint(albedo * np.float32(127.5)), 0, 255).astype(np.uint8)


def _matter_texels(albedo: NDArray[np.uint8], irradiance: F32,
                   surroundings: F32) -> NDArray[np.uint8]:
    """Return (n, n, 4) texels of u_matter in shaders/ground.frag, without its last channel."""
    n = albedo.shape[0]
    data = np.zeros((n, n, 4), np.uint8)
    data[..., 0] = albedo
    for channel, value in ((1, np.sqrt(4.0 * irradiance)), (2, np.sqrt(4.0 * surroundings))):
        value = cv2.resize(value, (n, n), interpolation=cv2.INTER_LINEAR)
        data[..., channel] = np.clip(np.rint(value * 255.0), 0, 255)
    return data
