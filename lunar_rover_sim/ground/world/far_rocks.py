"""Rocks beyond the fine ground, which no rover touches but every camera sees.

They follow the size-frequency law and the classes of size of the rocks on the ground, and lie on
the coarser levels. They are not stored: the recipe and the catalogue of craters give them.
"""

from __future__ import annotations

import dataclasses
import zlib

import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world import rockfield
from lunar_rover_sim.ground.world.grid import box_around
from lunar_rover_sim.ground.world.kept_arrays import kept
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks

_RECIPE = 2             # rises with every change of what `far_rocks` returns
LEAST_DIAMETER_M = 0.3      # of rocks at any distance
# Nearer to the fine ground there are smaller ones too, so that they do not end at its edge: as
# large as they look under this angle from its middle [rad], 1.4 px of the default camera.
_LEAST_ANGLE = 0.003


def least_diameter_m(xy_m: Array) -> Array:
    """Return the diameter of the smallest rock at (..., 2) positions [m]."""
    distance = np.abs(np.asarray(xy_m, float)).max(axis=-1)
    return np.minimum(_LEAST_ANGLE * distance, LEAST_DIAMETER_M)


def far_rocks(world: World, reach_m: float) -> Rocks:
    """Return the rocks beyond the ground, up to `reach_m` from its middle, in x or y.

    Args:
        reach_m: The levels limit it too. A world whose recipe has no seed has none.
    """
    if not world.hash:
        return _far_rocks(world, reach_m)

    def rows() -> Array:
        rocks = _far_rocks(world, reach_m)
        # Keys have 52 bits, which double precision holds.
        return np.column_stack([rocks.shape, rocks.size, rocks.position_m, rocks.orientation_wxyz,
                                rocks.albedo, rocks.key])
    # A world may have the hash of another one that it was changed from: its heights tell.
    columns = kept('far_rocks', [_RECIPE, world.hash, world.config.to_mapping(),
                                 [(grid.cell_m, grid.middle_m,
                                   zlib.crc32(grid.heights_m.tobytes()))
                                  for grid in world.levels], reach_m], rows)
    return Rocks(columns[:, 0].astype(np.int32), columns[:, 1].astype(np.int32),
                 np.ascontiguousarray(columns[:, 2:5]), np.ascontiguousarray(columns[:, 5:9]),
                 columns[:, 9].astype(np.float32), rockfield.size_classes(world.config.rocks),
                 columns[:, 10].astype(np.uint64))


def _far_rocks(world: World, reach_m: float) -> Rocks:
    """Do the work of `far_rocks`."""
    config, half = world.config.rocks, world.ground.half_extent_m
    # Rocks are drawn in the frame of the site.
    x, y = np.add(world.ground.middle_m, world.origin_m).tolist()
    craters = dataclasses.replace(world.craters,
                                  position_m=world.craters.position_m + world.origin_m)
    reach = min(reach_m, world.levels[-1].half_extent_m - config.max_diameter_m)
    if world.config.seed < 0 or config.abundance == 0.0 or reach <= half:
        return rockfield.no_rocks(config)
    classes = rockfield.size_classes(config)
    # Small ones lie near the ground, large ones far off, too.
    shells = [min(shell, reach) for shell in (LEAST_DIAMETER_M / _LEAST_ANGLE, reach_m)]
    parts, inner = [], 0.0
    for shell in sorted(set(shells)):
        least_m = float(least_diameter_m(np.array([max(half, inner), 0.0])))
        found = rockfield.population(
            config, world.config.seed, box_around((x, y), shell), craters,
            world.config.clear_radius_m, least_m)
        away = np.abs(found.xy_m - (x, y)).max(axis=1)
        diameter = classes[found.size]
        parts.append(found.select((away > half + 0.6 * diameter) & (away >= inner)
                                  & (diameter >= least_diameter_m(found.xy_m - (x, y)))))
        inner = shell
    rocks = rockfield.Population(*(np.concatenate([getattr(part, field.name) for part in parts])
                                   for field in dataclasses.fields(rockfield.Population)))
    here = dataclasses.replace(rocks, xy_m=rocks.xy_m - world.origin_m)
    return rockfield.laid(config, world, world.rock_shapes, here)
