"""Routes: polylines and splines through waypoints, and shapes that revisit places for SLAM."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.autonomy.path_following.config import DriveConfig
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array, distance_along

SAMPLE_M = 0.02


class Route:
    """A polyline with its arc length.

    Args:
        points_m: (n, 2) vertices, of which at least two differ; equal neighbours are merged.
        closed: The last vertex joins the first, and the arc length runs through `laps` laps.

    Raises:
        ConfigError: If all vertices are at one place.
    """

    def __init__(self, points_m: ArrayLike, closed: bool = False, laps: int = 1) -> None:
        points = np.asarray(points_m, dtype=float)
        points = points[np.r_[True, np.any(np.diff(points, axis=0) != 0.0, axis=1)]]
        if closed and np.any(points[0] != points[-1]):
            points = np.vstack([points, points[:1]])
        if len(points) < 2:
            raise ConfigError('waypoints: all lie on one spot; valid is two or more that differ,'
                              ' including the start')
        self.closed = closed
        self.points_m = points
        self._s = distance_along(points)
        self._lap_m = float(self._s[-1])
        self.length_m = self._lap_m * (laps if closed else 1)

    def at(self, s_m: ArrayLike) -> Array:
        """Return the (..., 2) points at (...) arc lengths [m]; beyond an end, that end."""
        s = np.clip(np.asarray(s_m, dtype=float), 0.0, self.length_m)
        if self.closed:
            s = np.where(s >= self.length_m, self._lap_m, s % self._lap_m)
        return np.stack([np.interp(s, self._s, self.points_m[:, k]) for k in (0, 1)], axis=-1)

    def nearest(self, position_m: ArrayLike, from_m: float, to_m: float) -> tuple[float, float]:
        """Return arc length [m] and distance [m] of the nearest point between two arc lengths.

        The search is limited to that part, so that another part that crosses it is not taken; it
        samples every 2 cm.
        """
        n = max(2, math.ceil((to_m - from_m) / SAMPLE_M) + 1)
        s = np.linspace(from_m, min(to_m, self.length_m), n)
        distance = np.linalg.norm(self.at(s) - np.asarray(position_m, dtype=float)[:2], axis=1)
        k = int(np.argmin(distance))
        return float(s[k]), float(distance[k])


def make_route(config: DriveConfig, start_xy_m: ArrayLike, heading_rad: float) -> Route:
    """Return the route of a configuration for a rover that starts at a pose in the odom frame.

    Raises:
        ConfigError: If all waypoints are at one place.
    """
    start = np.asarray(start_xy_m, dtype=float)[:2]
    if config.shape != 'none':
        points, closed = shape_points(config.shape, config.shape_size_m)
        points = _from_start(points, start, heading_rad)
        smooth = config.mode == 'spline' and config.shape == 'square'
    else:
        points = np.stack([config.waypoints_x_m, config.waypoints_y_m], axis=-1)
        if config.relative:
            points = _from_start(points, start, heading_rad)
        closed = config.laps > 1 or (len(points) > 2 and bool(np.all(points[0] == points[-1])))
        if not closed:
            points = np.vstack([start, points])
        smooth = config.mode == 'spline'
    if closed and np.all(points[0] == points[-1]):
        points = points[:-1]
    if smooth and len(points) > 2:
        points = catmull_rom(points, closed)
    return Route(points, closed, config.laps)


def shape_points(shape: str, size_m: float) -> tuple[Array, bool]:
    """Return the (n, 2) points of a shape that starts at 0 along +x, and whether it is closed."""
    if shape == 'circle':
        angle = np.linspace(0.0, 2.0 * np.pi, 129)[:-1]
        return 0.5 * size_m * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=-1), True
    if shape == 'square':
        return size_m * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), True
    if shape == 'figure_eight':
        angle = np.linspace(0.0, 2.0 * np.pi, 129)[:-1]
        loop = 0.5 * size_m * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=-1)
        return np.vstack([loop, loop * [1.0, -1.0]]), True
    if shape == 'tour':
        return size_m * np.array([[0.0, 0.0], [0.55, -0.35], [1.0, 0.0], [0.75, 0.5],
                                  [0.15, 0.45]]), True
    # Out and back: a drop-shaped loop at the far end lets the rover turn back without a stop.
    turn = min(0.2 * size_m, 0.7)
    far = size_m - 1.8 * turn
    drop = far + turn * np.array([0.0, 0.8, 1.8, 0.8, 0.0])
    back = np.array([far - 0.5 * turn, 0.5 * far, 0.0])
    x = np.concatenate([back[::-1], drop, back])
    y = np.concatenate([np.zeros(3), turn * np.array([0.0, 0.8, 0.0, -0.8, 0.0]), np.zeros(3)])
    return catmull_rom(np.stack([x, y], axis=-1), closed=False), False


def catmull_rom(points_m: ArrayLike, closed: bool, alpha: float = 0.5) -> Array:
    """Return the centripetal Catmull-Rom spline through (n, 2) points, sampled every few cm.

    It passes all points and neither loops nor cusps (Yuksel, Schaefer and Keyser, 2011); `alpha`
    is the exponent of the knot distances.
    """
    points = np.asarray(points_m, dtype=float)
    if closed:
        padded = np.vstack([points[-1], points, points[:2]])
    else:
        padded = np.vstack([2 * points[0] - points[1], points, 2 * points[-1] - points[-2]])
    pieces = []
    for p0, p1, p2, p3 in zip(padded, padded[1:], padded[2:], padded[3:]):
        t = np.cumsum([0.0] + [max(math.hypot(*(b - a)), 1e-9) ** alpha
                               for a, b in ((p0, p1), (p1, p2), (p2, p3))])
        n = max(2, math.ceil(math.hypot(*(p2 - p1)) / (2.0 * SAMPLE_M)))
        x = np.linspace(t[1], t[2], n, endpoint=False)[:, None]
        a1 = ((t[1] - x) * p0 + (x - t[0]) * p1) / (t[1] - t[0])
        a2 = ((t[2] - x) * p1 + (x - t[1]) * p2) / (t[2] - t[1])
        a3 = ((t[3] - x) * p2 + (x - t[2]) * p3) / (t[3] - t[2])
        b1 = ((t[2] - x) * a1 + (x - t[0]) * a2) / (t[2] - t[0])
        b2 = ((t[3] - x) * a2 + (x - t[1]) * a3) / (t[3] - t[1])
        pieces.append(((t[2] - x) * b1 + (x - t[1]) * b2) / (t[2] - t[1]))
    if not closed:
        pieces.append(points[-1:])
    return np.vstack(pieces)


def _from_start(points: Array, start: Array, heading_rad: float) -> Array:
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    # Not by BLAS, whose products differ from processor to processor.
    x, y = points.T
    return np.stack([c * x - s * y, s * x + c * y], axis=-1) + start
