"""Random waypoints over a world, with straight ways that keep clear of the larger rocks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.errors import StudyError
from lunar_rover_sim.frames import Array
from lunar_rover_sim.world.model import World

WAYPOINT_STEP_M = (2.0, 7.0)   # least and greatest distance between waypoints
OBSTACLE_M = 0.04              # rocks that rise more than this are driven around
ROCK_HEIGHT = 0.7              # height of a rock over its greatest horizontal diameter, about
CORRIDOR_M = 0.4               # least distance of the way from the middle of such a rock
MAX_TRIALS = 2000              # for the next waypoint, before the search is given up
MARGIN_M = 4.0                 # least distance of waypoints from the edge


def obstacles(world: World) -> Array:
    """Return (n, 2) positions of the rocks that rise higher than the rover can stride over."""
    rocks = world.rocks
    if len(rocks) == 0:
        return np.zeros((0, 2))
    xy = rocks.position_m[:, :2]
    rise = rocks.position_m[:, 2] + 0.5 * ROCK_HEIGHT * rocks.diameter_m - world.height_at(xy)
    return xy[rise > OBSTACLE_M]


def random_waypoints(world: World, length_m: float, rng: np.random.Generator,
                     start_m: ArrayLike = (0.0, 0.0)) -> Array:
    """Return (n, 2) waypoints [m] of a route from a start (2,) on, at least length_m [m] long.

    The straight way from each to the next keeps `CORRIDOR_M` from obstacles, as an operator with
    a map would plan it: the rover avoids nothing by itself. Obstacles that are nearer to the start
    are ignored. Raises StudyError if the world is too small or no route is found.
    """
    limit = world.ground.half_extent_m - MARGIN_M
    if limit < WAYPOINT_STEP_M[1]:
        raise StudyError('the world is too small to traverse:'
                         f' {2 * world.ground.half_extent_m:g} m;'
                         f' valid is >= {2 * (MARGIN_M + WAYPOINT_STEP_M[1]):g} m')
    start, blocked = np.asarray(start_m, dtype=float), obstacles(world)
    blocked = blocked[np.linalg.norm(blocked - start, axis=1) >= CORRIDOR_M]
    points, gone, heading = [start], 0.0, rng.uniform(-math.pi, math.pi)
    trials = 0
    while gone < length_m:
        trials += 1
        if trials > MAX_TRIALS:
            raise StudyError('no way between the rocks of this world; valid is one with fewer'
                             ' of them')
        # Mostly ahead; every third trial goes anywhere.
        turn = heading + rng.normal(0.0, 0.7) if trials % 3 else rng.uniform(-math.pi, math.pi)
        step = rng.uniform(*WAYPOINT_STEP_M)
        point = points[-1] + step * np.array([math.cos(turn), math.sin(turn)])
        if np.max(np.abs(point)) > limit or _distance(points[-1], point, blocked) < CORRIDOR_M:
            continue
        heading, gone, trials = turn, gone + step, 0
        points.append(point)
    return np.array(points[1:])


def _distance(start: Array, end: Array, points: Array) -> float:
    """Return the distance [m] of the nearest of (n, 2) points from a straight way."""
    if len(points) == 0:
        return math.inf
    way = end - start
    along = np.clip((points - start) @ way / (way @ way), 0.0, 1.0)
    return float(np.min(np.linalg.norm(start + along[:, None] * way - points, axis=1)))
