"""Rocks beyond the fine ground, which no rover touches but every camera sees.

They follow the size-frequency law and the classes of size of the rocks on the ground, and lie on
the coarser levels. They are not stored: the recipe and the catalogue of craters give them.
"""

from __future__ import annotations

import dataclasses
import zlib

import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world import rockfield, stamping
from lunar_rover_sim.ground.world.kept_arrays import kept
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks

_RECIPE = 1             # rises with every change of what `far_rocks` returns
LEAST_DIAMETER_M = 0.3      # of rocks at any distance
# Nearer to the fine ground there are smaller ones too, so that they do not end at its edge: as
# large as they look under this angle from its middle [rad], 1.4 px of the default camera.
_LEAST_ANGLE = 0.003
_CELLS = 512                # along a side of the map of density


def least_diameter_m(xy_m: Array) -> Array:
    """Return the diameter of the smallest rock at (..., 2) positions [m]."""
    distance = np.abs(np.asarray(xy_m, float)).max(axis=-1)
    return np.minimum(_LEAST_ANGLE * distance, LEAST_DIAMETER_M)


def far_rocks(world: World, reach_m: float) -> Rocks:
    """Return the rocks between the edge of the ground and `reach_m` from the origin, in x or y.

    Args:
        reach_m: The levels limit it too. A world whose recipe has no seed has none.
    """
    rocks = _kept_far_rocks(world, reach_m)
    # They are counted on from those of the world.
    return dataclasses.replace(rocks, key=rocks.key + np.uint32(len(world.rocks)))


def _kept_far_rocks(world: World, reach_m: float) -> Rocks:
    if not world.hash:
        return _far_rocks(world, reach_m)

    def rows() -> Array:
        rocks = _far_rocks(world, reach_m)
        return np.column_stack([rocks.shape, rocks.size, rocks.position_m, rocks.orientation_wxyz,
                                rocks.albedo])
    # A world may have the hash of another one that it was changed from: its heights tell.
    columns = kept('far_rocks', [_RECIPE, world.hash, world.config.to_mapping(),
                                 [(grid.cell_m, zlib.crc32(grid.heights_m.tobytes()))
                                  for grid in world.levels], reach_m], rows)
    return Rocks(columns[:, 0].astype(np.int32), columns[:, 1].astype(np.int32),
                 np.ascontiguousarray(columns[:, 2:5]), np.ascontiguousarray(columns[:, 5:9]),
                 columns[:, 9].astype(np.float32), rockfield.size_classes(world.config.rocks))


def _far_rocks(world: World, reach_m: float) -> Rocks:
    """Do the work of `far_rocks`."""
    config, half = world.config.rocks, world.ground.half_extent_m
    reach = min(reach_m, world.levels[-1].half_extent_m - config.max_diameter_m)
    if world.config.seed < 0 or config.abundance == 0.0 or config.max_number == 0 \
            or reach <= half:
        return rockfield.no_rocks(config)
    rng = np.random.default_rng([world.config.seed, *b'far rocks'])
    classes = rockfield.size_classes(config)
    bounds = np.sqrt(classes[1:] * classes[:-1])
    grid = np.geomspace(config.min_diameter_m, config.max_diameter_m, 2049)
    above = rockfield.number_per_m2(config, grid) * (2.0 * reach) ** 2
    above = above[grid >= min(_LEAST_ANGLE * half, LEAST_DIAMETER_M)]
    grid = grid[-len(above):]
    if len(above) < 2:
        return rockfield.no_rocks(config)
    count = int(rng.poisson(above[0]))
    diameter = np.interp(rng.uniform(0.0, above[0], count), above[::-1], grid[::-1])
    diameter = np.sort(diameter)[::-1]
    xy = _places(count, _density(world, reach), reach, rng)
    size = np.clip(np.searchsorted(bounds, diameter), 0, len(classes) - 1)
    away = np.abs(xy).max(axis=1)
    some = (diameter >= least_diameter_m(xy)) & (away > half + 0.6 * classes[size])
    xy, size = xy[some], size[some]
    apart = rockfield.apart(xy, classes[size])
    return rockfield.laid(config, world, world.rock_shapes, xy[apart], size[apart], rng)


def _density(world: World, reach_m: float) -> Array:
    """Return the running sum of the relative density of rocks over coarse cells."""
    config = world.config.rocks
    density = rockfield.relative_density(config, reach_m, _CELLS, world.craters)
    stamping.add_rays(density, 2.0 * reach_m / _CELLS, world.craters, config.near_craters)
    return np.cumsum(density.ravel())


def _places(count: int, total: Array, reach_m: float, rng: np.random.Generator) -> Array:
    """Return (count, 2) positions [m] that follow the density."""
    index = np.minimum(np.searchsorted(total, rng.uniform(0.0, total[-1], count)),
                       _CELLS * _CELLS - 1)
    corner = np.stack([index % _CELLS, index // _CELLS], axis=-1)
    return (corner + rng.random((count, 2))) * (2.0 * reach_m / _CELLS) - reach_m
