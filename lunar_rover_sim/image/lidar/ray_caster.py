"""Rays against a world: its levels one after the other, from the finest to the coarsest."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.lidar import ray_march
from lunar_rover_sim.image.lidar.ray_arrays import HeightPyramid, LevelArrays, RockHulls, SoftCells
from lunar_rover_sim.image.lidar.ray_march import GROUND, NOTHING

_RINGS = 60
_NEAREST_M = 0.4            # where the second ring begins
_SECTORS = 128
_WIDTH = 0.25               # of a block over its distance, at most
_SHIFT = 2                  # a block is 4 x 4 cells, or 4 x 4 of the next smaller blocks
_SLACK_M = 1e-6             # far more than rounding, far less than matters


def free_distances(level: LevelArrays, inner_m: float, box_m: tuple[Array, Array],
                   which: NDArray[np.int64], direction: Array, range_m: float) -> Array:
    """Return (n,) distances [m] up to which rays meet nothing of a level; 0 where not in `which`.

    A ray whose distance is range_m or more meets nothing within that range.

    Args:
        inner_m: Half side of the square where the level is not.
        box_m: (3,) corners of a box in which all begin.
        which: (m,) rays.
        direction: (n, 3) unit vectors.
    """
    free = np.zeros(len(direction))
    ring_m = np.append(0.0, np.geomspace(_NEAREST_M, max(range_m, 1.0), _RINGS))
    _look_up(_bounds(level, inner_m, *box_m, ring_m), ring_m, which, direction, free)
    return free


@compiled
def box_around(which, place_m):
    """Return the least and the greatest coordinates of some of (n, 3) places, (3,) each."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in which:
        for k in range(3):
            low[k], high[k] = min(low[k], place_m[i, k]), max(high[k], place_m[i, k])
    return low, high


@compiled
def _bounds(level, inner_m, low_m, high_m, ring_m):
    """Return (sectors, rings) greatest slopes at which a level is seen up to the end of rings.

    Args:
        low_m: (3,) low corner of the box in which the eye is.
        high_m: (3,) its high corner.
        ring_m: (rings + 1,).
    """
    tops, first, side = level.tops_m, level.first, level.side
    half_m, rings = 0.5 * (len(level.heights_m) - 1) * level.cell_m, len(ring_m) - 1
    bounds = np.full((_SECTORS, rings), -np.inf)
    # Blocks that are to be looked at: size, row, column.
    stack = np.zeros((16 * len(first), 3), np.int64)
    stack[0, 0], count = len(first) - 1, 1
    while count > 0:
        count -= 1
        k, row, column = stack[count, 0], stack[count, 1], stack[count, 2]
        width_m = (1 << _SHIFT * (k + 1)) * level.cell_m
        x, y = column * width_m - half_m, row * width_m - half_m
        if max(abs(x), abs(x + width_m), abs(y), abs(y + width_m)) < inner_m:
            continue
        # From the eye, wherever it is in its box.
        x0, x1 = x - high_m[0] - _SLACK_M, x + width_m - low_m[0] + _SLACK_M
        y0, y1 = y - high_m[1] - _SLACK_M, y + width_m - low_m[1] + _SLACK_M
        near_m = _length(max(x0, -x1, 0.0), max(y0, -y1, 0.0))
        if near_m > ring_m[rings]:
            continue
        if k > 0 and width_m > _WIDTH * near_m:
            for r in range(row << _SHIFT, min((row + 1) << _SHIFT, side[k - 1])):
                for c in range(column << _SHIFT, min((column + 1) << _SHIFT, side[k - 1])):
                    stack[count, 0], stack[count, 1], stack[count, 2] = k - 1, r, c
                    count += 1
            continue
        far_m = _length(max(-x0, x1), max(-y0, y1))
        begin, end = 0, _SECTORS
        if near_m > 0.0:
            middle = _azimuth(0.5 * (x0 + x1), 0.5 * (y0 + y1))
            a, b = _from(middle, x0, y0), _from(middle, x0, y1)
            c, d = _from(middle, x1, y0), _from(middle, x1, y1)
            begin = int(math.floor((middle + min(a, b, c, d)) * _SECTORS))
            end = int(math.floor((middle + max(a, b, c, d)) * _SECTORS)) + 1
        height = tops[first[k] + row * side[k] + column] - low_m[2] + _SLACK_M
        r = 0
        while ring_m[r + 1] < near_m:
            r += 1
        while r < rings and ring_m[r] <= far_m:
            slope = (height / max(near_m, ring_m[r]) if height > 0.0
                     else height / min(far_m, ring_m[r + 1]))
            for s in range(begin, end):
                s = s + _SECTORS if s < 0 else s - _SECTORS if s >= _SECTORS else s
                bounds[s, r] = max(bounds[s, r], slope)
            r += 1
    for s in range(_SECTORS):
        for r in range(1, rings):
            bounds[s, r] = max(bounds[s, r], bounds[s, r - 1])
    return bounds


@compiled
def _look_up(bounds, ring_m, which, direction, free_m):
    """Write how far rays are free."""
    for i in which:
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        flat = _length(dx, dy)
        if flat == 0.0:
            continue
        slope, sector = dz / flat, min(int(_azimuth(dx, dy) * _SECTORS), _SECTORS - 1)
        low, high = 0, len(ring_m) - 1
        if slope > bounds[sector, high - 1]:
            low = high
        while low < high:
            middle = (low + high) >> 1
            if bounds[sector, middle] >= slope:
                high = middle
            else:
                low = middle + 1
        free_m[i] = ring_m[low] / flat


@compiled
def _length(x, y):
    return math.sqrt(x * x + y * y)


@compiled
def _azimuth(x, y):
    """Return a measure of azimuth from 0 to 1; it rises with it, but takes no arc tangent."""
    share = y / (abs(x) + abs(y))
    turn = share if x >= 0.0 else 2.0 - share
    return 0.25 * (turn if turn >= 0.0 else turn + 4.0)


@compiled
def _from(middle, x, y):
    """Return the azimuth of a place less another one, from -0.5 to 0.5."""
    turn = _azimuth(x, y) - middle
    return turn - 1.0 if turn > 0.5 else turn + 1.0 if turn < -0.5 else turn


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
             which: Index | None = None, from_one_place: bool = True) -> RayHits:
        """Return the first hits of (n, 3) rays within a range [m].

        Args:
            origin_m: (n, 3) world frame, on the finest level and above the ground.
            direction: (n, 3) unit length.
            which: (m,) rays to cast, all by default.
            from_one_place: Bound first how far rays of all origins are free. That costs tens of
                milliseconds, and tells nothing where rays begin on the ground all around.
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
            free_m = (free_distances(pyramid.arrays, inner_m, box_m, which, direction, range_m)
                      if from_one_place else np.zeros(count))
            ray_march.cast(pyramid.arrays, inner_m, self._rocks, soft, which, free_m, origin_m,
                           direction, range_m, hits.distance_m, hits.target, hits.normal)
            # The next level begins beyond: it is not for rays that have met something before.
            inner_m = pyramid.grid.half_extent_m
            begins_m = inner_m - max(np.abs(corner[:2]).max() for corner in box_m)
            which = which[hits.distance_m[which] > begins_m]
        return hits
