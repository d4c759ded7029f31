"""Between which distances rays from about one place meet the ground, by azimuth and elevation.

The surroundings are divided into bins of azimuth and horizontal distance. The greatest height in a
bin bounds the elevation under which a ray may meet something there, the least height that under
which it must have met something. The greatest of these bounds up to a distance say which rays
pass it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lunar_rover_sim.frames import Array
from lunar_rover_sim.lidar.height_pyramid import HeightPyramid

_AZIMUTHS, _DISTANCES = 512, 144
_NEAREST_M = 0.4


class RayBrackets:
    """The table of a scan.

    pyramids: levels of the world, finest first; origin_m: (n, 3) of its rays; range_m: how far
    """

    def __init__(self, pyramids: Sequence[HeightPyramid], origin_m: Array,
                 range_m: float) -> None:
        low, high = (np.array([bound(axis) for axis in origin_m.T]) for bound in (np.min, np.max))
        place, margin = 0.5 * (low + high), 0.5 * (high - low)
        edges = np.geomspace(_NEAREST_M, max(range_m, 2.0 * _NEAREST_M), _DISTANCES)
        self._edges_m = edges = np.concatenate([[0.0], edges])
        middle = 0.5 * (edges[:-1] + edges[1:])
        middle[0] = 0.0
        across = np.maximum(np.diff(edges), edges[1:] * (2 * np.pi / _AZIMUTHS))
        across[0] = 2.0 * _NEAREST_M
        azimuth = (np.arange(_AZIMUTHS) + 0.5) * (2.0 * np.pi / _AZIMUTHS)
        x = place[0] + middle * np.cos(azimuth)[:, None]
        y = place[1] + middle * np.sin(azimuth)[:, None]
        # Half the diagonal of a bin is at most 0.71 of its longer side.
        reach = 0.71 * across + margin[:2].max()
        top, bottom = np.full(x.shape, np.inf), np.full(x.shape, -np.inf)
        todo = np.ones(x.shape, bool)
        for pyramid in pyramids:
            inside = np.maximum(np.abs(x), np.abs(y)) + reach < pyramid.grid.half_extent_m
            now = np.nonzero(todo & inside)
            level = pyramid.level_for(reach)[now[1]]
            top[now], bottom[now] = pyramid.heights_around(x[now], y[now], level)
            todo &= ~inside
        rise = top - low[2]
        run = np.where(rise > 0.0, edges[:-1], edges[1:])
        with np.errstate(divide='ignore', invalid='ignore'):
            self._first = _ascending(np.where(rise == 0.0, 0.0, rise / run))
            self._last = _ascending((bottom - high[2]) / edges[1:])

    def along(self, direction: Array) -> tuple[Array, Array]:
        """Return between which distances [m] (n, 3) rays of unit length have their hits.

        Nothing is met before the first one; the second one is inf where nothing need be met.
        """
        horizontal = np.maximum(np.hypot(direction[:, 0], direction[:, 1]), 1e-9)
        azimuth = np.arctan2(direction[:, 1], direction[:, 0]) * (_AZIMUTHS / (2.0 * np.pi))
        row = np.floor(azimuth).astype(np.int64) % _AZIMUTHS
        wanted = _share(direction[:, 2] / horizontal) + row
        begin, end = (np.searchsorted(bounds, wanted) - row * _DISTANCES
                      for bounds in (self._first, self._last))
        inf = np.inf
        # The point at which it is below the ground for certain is the far edge of a bin.
        edges = np.append(self._edges_m, inf)
        return edges[begin] / horizontal, edges[np.minimum(end + 1, _DISTANCES + 1)] / horizontal


def _share(slope: Array) -> Array:
    """Return a measure of slopes that grows with them from 0 to 1."""
    with np.errstate(invalid='ignore'):
        share = 0.5 + 0.5 * slope / (1.0 + np.abs(slope))
    return np.where(np.isinf(slope), slope > 0.0, share)


def _ascending(slope: Array) -> Array:
    """Return the greatest slopes up to each distance, rows one after the other in one array.

    So one search serves the rays of all azimuths.
    """
    share: Array = np.maximum.accumulate(_share(slope), axis=1)
    share += np.arange(float(len(share)))[:, None]
    return share.ravel()
