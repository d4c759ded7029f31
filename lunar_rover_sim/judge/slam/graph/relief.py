"""The relief that the rover has seen: heights and slopes of cells of the ground.

It is that of the corners of keyframes, which are there anyway: some hundred of each, up to some
metres ahead.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array

_FARTHEST_M = 8.0       # from the camera: the height of what lies farther says little
_LEAST_POINTS = 6       # of a cell
# Standard deviation of a height by stereo, and the share of the spread within a cell by which the
# mean of the seen part of it is off that of the whole.
_STEREO_M, _SEEN_PART = 0.02, 1.5
_LEAST_M = 0.05         # spread of places that tells a slope
# Of a facet: points, and the least spread of their places along each axis, in its sides.
_FACET_POINTS, _FACET_SPREAD = 12, 0.17


class _Patch(NamedTuple):
    key: int
    way_m: float
    points_m: Array     # (n, 3) in base


@dataclasses.dataclass(frozen=True)
class Cells:
    """Heights of cells, in the frame of the graph's map.

    Attributes:
        xy_m: (n, 2) mean places of what was seen in them.
        z_m: (n,) mean heights.
        sigma_m: (n,) their standard deviations.
        way_m: (n,) from where on the way they were seen.
        key: Of the keyframe in the middle of the way.
        middle_m: Its place on the way.
    """

    xy_m: Array
    z_m: Array
    sigma_m: Array
    way_m: Array
    key: int
    middle_m: float

    def __len__(self) -> int:
        return len(self.z_m)


@dataclasses.dataclass(frozen=True)
class Facets:
    """Slopes of cells, in the frame of the graph's map.

    Attributes:
        xy_m: (n, 2) mean places of what was seen in them.
        gradient: (n, 2) rise along x and y.
        spread: (n,) what is left beside a plane, over the side of the cell.
    """

    xy_m: Array
    gradient: Array
    spread: Array

    def __len__(self) -> int:
        return len(self.xy_m)


class _Planes(NamedTuple):
    """Planes through the points of cells.

    Attributes:
        mean_m: (n, 3) mean points.
        gradient: (n, 2) rise along x and y.
        spread_m: (n,) what is left beside the planes.
        sides_m: (n, 2) spread of the places.
        points: (n,) how many.
        cell: (m,) of each point.
    """

    mean_m: Array
    gradient: Array
    spread_m: Array
    sides_m: Array
    points: NDArray[np.int64]
    cell: NDArray[np.int64]

    @classmethod
    def of(cls, points_m: Array, size_m: float) -> _Planes:
        """Fit planes to (m, 3) points in cells of a side."""
        _, cell, count = np.unique(np.floor(points_m[:, :2] / size_m).astype(int), axis=0,
                                   return_inverse=True, return_counts=True)
        cell = cell.ravel()

        def mean(values: Array) -> Array:
            return np.asarray(np.bincount(cell, values) / count)

        middle = np.column_stack([mean(values) for values in points_m.T])
        u, v, w = (points_m - middle[cell]).T
        uu, vv, uv, uw, vw = (mean(a * b) for a, b in ((u, u), (v, v), (u, v), (u, w), (v, w)))
        sides = np.sqrt(np.column_stack([uu, vv]))
        uu, vv = uu + _LEAST_M**2, vv + _LEAST_M**2
        gradient = np.column_stack([vv * uw - uv * vw, uu * vw - uv * uw])
        gradient /= (uu * vv - uv**2)[:, None]
        plane = gradient[:, 0] * uw + gradient[:, 1] * vw
        return cls(middle, gradient, np.sqrt(np.maximum(mean(w * w) - plane, 0.0)), sides, count,
                   cell)


class Relief:
    """What was seen from the last keyframes, as points in their axes: it moves with the graph.

    Attributes:
        way_m: Way so far.
    """

    def __init__(self, most_m: float) -> None:
        """Begin.

        Args:
            most_m: Way of which it remembers what was seen.
        """
        self._most_m = most_m
        self._patches: deque[_Patch] = deque()
        self._before: Array | None = None
        self.way_m = 0.0

    @property
    def seen_m(self) -> float:
        """The way of which it remembers what was seen."""
        return self.way_m - self._patches[0].way_m if self._patches else 0.0

    def add(self, key: int, T_map_base: Array, points_m: Array, T_base_left: Array) -> None:
        """Take the points (n, 3) of a keyframe, in its left camera."""
        place = T_map_base[:2, 3]
        if self._before is not None:
            self.way_m += float(math.dist(place, self._before))
        self._before = place.copy()
        near = points_m[points_m[:, 2] < _FARTHEST_M]
        self._patches.append(_Patch(key, self.way_m, near @ T_base_left[:3, :3].T
                                    + T_base_left[:3, 3]))
        while self._patches[0].way_m < self.way_m - self._most_m:
            self._patches.popleft()

    def forget(self) -> None:
        """Begin a new stretch of the way."""
        self._patches.clear()

    def cells(self, poses: Mapping[int, Array], size_m: float) -> Cells | None:
        """Return the cells of the remembered way; None where nothing was seen.

        Args:
            poses: T_map_base (4, 4) of the keyframes.
            size_m: Side of a cell.
        """
        patches = self._placed(poses)
        if not patches:
            return None
        planes = _Planes.of(_points(patches, poses), size_m)
        good = planes.points >= _LEAST_POINTS
        way = np.repeat([patch.way_m for patch in patches],
                        [len(patch.points_m) for patch in patches])
        along = np.bincount(planes.cell, way) / planes.points
        middle_m = 0.5 * (patches[0].way_m + patches[-1].way_m)
        middle = min(patches, key=lambda patch: abs(patch.way_m - middle_m))
        return Cells(planes.mean_m[good, :2], planes.mean_m[good, 2],
                     np.hypot(_STEREO_M, _SEEN_PART * planes.spread_m)[good], along[good],
                     middle.key, middle.way_m)

    def facets(self, poses: Mapping[int, Array], size_m: float) -> Facets | None:
        """Return the slopes of what was seen; None where nothing was. Arguments as of `cells`."""
        patches = self._placed(poses)
        if not patches:
            return None
        planes = _Planes.of(_points(patches, poses), size_m)
        good = ((planes.points >= _FACET_POINTS)
                & (planes.sides_m.min(axis=1) >= _FACET_SPREAD * size_m))
        return Facets(planes.mean_m[good, :2], planes.gradient[good],
                      planes.spread_m[good] / size_m)

    def _placed(self, poses: Mapping[int, Array]) -> list[_Patch]:
        return [patch for patch in self._patches if patch.key in poses and len(patch.points_m)]


def _points(patches: Sequence[_Patch], poses: Mapping[int, Array]) -> Array:
    """Return all points (n, 3) in the map."""
    return np.vstack([patch.points_m @ poses[patch.key][:3, :3].T + poses[patch.key][:3, 3]
                      for patch in patches])
