"""Pure pursuit: steering along a route from the present pose."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.path_following.config import DriveConfig
from lunar_rover_sim.path_following.route import Route


@dataclasses.dataclass(frozen=True)
class Steering:
    """The commanded velocity, and the position of the rover relative to the route.

    Attributes:
        along_m: Arc length of the nearest point of the route.
        across_m: Distance from it.
        heading_error_rad: Angle from the rover's heading to the point that it steers towards.
        done: Whether the end of the route is reached.
    """

    forward_mps: float
    yaw_rate_radps: float
    along_m: float
    across_m: float
    heading_error_rad: float
    done: bool


class PurePursuit:
    """Follows a route: an arc to the point at the lookahead distance.

    The source is Coulter, Implementation of the pure pursuit path tracking algorithm, CMU-RI-TR-
    92-01, 1992. The curvature is 2 y / d^2 for a point at lateral offset y and distance d. The yaw
    rate is bounded, and the speed is lowered to keep the curvature. If the point is far off the
    heading, the rover turns in place first. The position along the route only advances, and only
    a part of the route ahead is searched, so that a figure-eight is followed through its crossing.
    """

    def __init__(self, config: DriveConfig, route: Route) -> None:
        self._config = config
        self._route = route
        self._along_m = 0.0
        self._turning = False

    @property
    def route(self) -> Route:
        """The route followed."""
        return self._route

    def update(self, position_m: ArrayLike, heading_rad: float) -> Steering:
        """Return the steering at a position ((2,) or (3,), odom [m]) and heading [rad]."""
        config, route = self._config, self._route
        position = np.asarray(position_m, dtype=float)[:2]
        window = self._along_m + max(2.0 * config.lookahead_m, 0.5)
        self._along_m, across = route.nearest(position, self._along_m, window)
        goal = float(np.linalg.norm(route.at(route.length_m) - position))
        left_m = route.length_m - self._along_m
        if left_m == 0.0 or max(left_m, goal) <= config.goal_tolerance_m:
            return Steering(0.0, 0.0, self._along_m, across, 0.0, True)
        target = route.at(self._along_m + config.lookahead_m) - position
        distance = max(float(np.linalg.norm(target)), 1e-6)
        error = math.atan2(target[1], target[0]) - heading_rad
        error = math.atan2(math.sin(error), math.cos(error))
        limit = math.radians(config.turn_in_place_deg)
        self._turning = abs(error) > (0.4 * limit if self._turning else limit)
        if self._turning:
            yaw_rate = math.copysign(config.max_yaw_rate_radps, error)
            return Steering(0.0, yaw_rate, self._along_m, across, error, False)
        curvature = 2.0 * math.sin(error) / distance
        speed = config.speed_mps
        if abs(curvature) * speed > config.max_yaw_rate_radps:
            speed = config.max_yaw_rate_radps / abs(curvature)
        return Steering(speed, speed * curvature, self._along_m, across, error, False)
