"""Where rays meet a world: its levels one after the other, from the finest to the coarsest."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.lidar import ray_march
from lunar_rover_sim.lidar.free_sight import box_around, free_distances
from lunar_rover_sim.lidar.ray_arrays import HeightPyramid, RockHulls, SoftCells
from lunar_rover_sim.lidar.ray_march import GROUND, NOTHING

I32 = NDArray[np.int32]
Index = NDArray[np.int64]

__all__ = ['GROUND', 'RayHits', 'NOTHING', 'RayCaster', 'ROVER']

ROVER = -3                  # a target, besides GROUND, NOTHING and the numbers of rocks


@dataclasses.dataclass(frozen=True)
class RayHits:
    """Where n rays meet the world.

    Attributes:
        distance_m: (n,) inf where nothing is met.
        target: (n,) GROUND, NOTHING, a rock, or of a `Lidar` the ROVER.
        normal: (n, 3) outward unit normals, world frame, 0 where nothing is met.
    """

    distance_m: Array
    target: I32
    normal: Array


class RayCaster:
    """Casts rays on a world.

    Args:
        pyramids: Of its levels, the finest first.

    Attributes:
        soft: Changed ground on the finest one.
    """

    def __init__(self, pyramids: Sequence[HeightPyramid], hulls: RockHulls) -> None:
        """Prepare the casting; compiles it if no process has done so before."""
        self._pyramids, self._rocks = pyramids, hulls.arrays
        self.soft: SoftCells | None = None
        self._unchanged = SoftCells.nothing()
        self.cast(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), 0.0)

    def cast(self, origin_m: Array, direction: Array, range_m: float,
             which: Index | None = None) -> RayHits:
        """Return the first hits of (n, 3) rays within a range [m].

        Args:
            origin_m: (n, 3) world frame, on the finest level and above the ground.
            direction: (n, 3) unit length.
            which: (m,) rays to cast, all by default.
        """
        count = len(direction)
        hits = RayHits(np.full(count, np.inf), np.full(count, NOTHING, np.int32),
                       np.zeros((count, 3)))
        origin_m, direction = (np.ascontiguousarray(a, float) for a in (origin_m, direction))
        range_m = float(range_m)
        if which is None:
            which = np.arange(count)
        inner_m, box_m = 0.0, box_around(which, origin_m)
        for pyramid in self._pyramids:
            soft = self.soft.arrays if self.soft is not None and not inner_m else self._unchanged
            free_m = free_distances(pyramid.arrays, inner_m, box_m, which, direction, range_m)
            ray_march.cast(pyramid.arrays, inner_m, self._rocks, soft, which, free_m, origin_m,
                           direction, range_m, hits.distance_m, hits.target, hits.normal)
            # The next level begins beyond: it is not for rays that have met something before.
            inner_m = pyramid.grid.half_extent_m
            begins_m = inner_m - max(np.abs(corner[:2]).max() for corner in box_m)
            which = which[hits.distance_m[which] > begins_m]
        return hits
