"""The driver: velocities along a profile or route, and the reasons to stop."""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Mapping
import dataclasses
import enum
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.autonomy.path_following.config import DriveConfig
from lunar_rover_sim.autonomy.path_following.route import make_route, Route
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.state_file import attributes_but, restore_attributes
from lunar_rover_sim.base.frames import matrix_from_wxyz, tilt_deg


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

    def update(self, position_m: ArrayLike, heading_rad: float,
               lookahead_m: float | None = None) -> Steering:
        """Return the steering at a position ((2,) or (3,), odom [m]) and heading [rad].

        Args:
            lookahead_m: Replaces that of the configuration [m].
        """
        config, route = self._config, self._route
        ahead = config.lookahead_m if lookahead_m is None else lookahead_m
        position = np.asarray(position_m, dtype=float)[:2]
        window = self._along_m + max(2.0 * config.lookahead_m, 0.5)
        self._along_m, across = route.nearest(position, self._along_m, window)
        goal = math.hypot(*(route.at(route.length_m) - position))
        left_m = route.length_m - self._along_m
        if left_m == 0.0 or max(left_m, goal) <= config.goal_tolerance_m:
            return Steering(0.0, 0.0, self._along_m, across, 0.0, True)
        target = route.at(self._along_m + ahead) - position
        distance = max(math.hypot(*target), 1e-6)
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


class VelocityProfile:
    """Velocities that begin at their times and hold until the next; the last holds.

    The profile is done at the time of its last velocity, if that is zero.
    """

    def __init__(self, config: DriveConfig) -> None:
        self._times_s = config.profile_times_s
        self._velocities = tuple(zip(config.profile_forward_mps, config.profile_yaw_rate_radps))

    def at(self, time_s: float) -> tuple[float, float]:
        """Return forward velocity [m/s] and yaw rate [rad/s] at a time [s] of the drive."""
        k = bisect.bisect_right(self._times_s, time_s) - 1
        if k < 0:
            return 0.0, 0.0
        return self._velocities[k]

    def done(self, time_s: float) -> bool:
        """Return whether the rover only stands from this time on."""
        return self._velocities[-1] == (0.0, 0.0) and time_s >= self._times_s[-1]


WAITING, DRIVING, DONE, STOPPED = 'waiting', 'driving', 'done', 'stopped'

_HISTORY_NS = 100_000_000   # progress is checked ten times per second
_STUCK_M = 0.1              # least progress within stuck_time_s
_METRES_PER_RADIAN = 0.3    # weight of progress in heading, for turns in place


class Stop(enum.Enum):
    """Why the driver stops."""

    LOST = 'lost'
    TILTED = 'tilted'
    OUTSIDE = 'outside'
    STUCK = 'stuck'


@dataclasses.dataclass(frozen=True)
class DriveCommand:
    """The commanded velocity and the status of the drive.

    Attributes:
        status: One of waiting, driving, done, stopped.
        reason: One line, '' when driving.
        cause: Why it has stopped; None: it has not.
    """

    forward_mps: float
    yaw_rate_radps: float
    status: str
    reason: str = ''
    cause: Stop | None = None


class Driver:
    """Drives a velocity profile or a route, and stops when tilted, stuck or near the world's edge.

    It does not avoid obstacles. After a stop it stays stopped until `reset`. It reads no clock:
    the same calls give the same commands.
    """

    def __init__(self, config: DriveConfig, half_extent_m: float | None = None) -> None:
        """Make a driver for a world that extends to +-half_extent_m [m]; None has no edge.

        Raises:
            ConfigError: If a waypoint in odom is outside the world or nearer than `border_m` to
                its edge.
        """
        self._config = config
        self._half_extent_m = math.inf if half_extent_m is None else half_extent_m
        _check_waypoints(config, self._half_extent_m)
        self._profile = VelocityProfile(config)
        self.reset()

    def reset(self) -> None:
        """Start again with the next update."""
        self._start_ns: int | None = None
        self._last_ns = 0
        self._pursuit: PurePursuit | None = None
        self._final: DriveCommand | None = None
        self._history: deque = deque()      # (stamp, progress) of the last stuck_time_s
        self._heading: float | None = None
        self._turned = 0.0

    def state(self) -> dict[str, Any]:
        """Return all that the drive goes on from."""
        return attributes_but(self, '_config', '_half_extent_m', '_profile')

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` has returned, of a driver with the same parameters."""
        restore_attributes(self, state)

    def update(self, stamp_ns: int, position_m: ArrayLike,
               orientation_wxyz: ArrayLike) -> DriveCommand:
        """Return the command at a pose: position (3,) [m], orientation (4,) wxyz, in odom.

        If time goes backward, the drive starts again. A pose that is not finite stops it.
        """
        if self._start_ns is not None and stamp_ns < self._last_ns:
            self.reset()
        self._last_ns = stamp_ns
        if self._final is None:
            position = np.asarray(position_m, dtype=float)
            rotation = matrix_from_wxyz(orientation_wxyz)
            command = self._stop_reason(position, rotation) or self._drive(
                stamp_ns, position, math.atan2(rotation[1, 0], rotation[0, 0]))
            if command.status not in (DONE, STOPPED):
                return command
            self._final = command
        return self._final

    def _stop_reason(self, position: np.ndarray, rotation: np.ndarray) -> DriveCommand | None:
        config = self._config
        if config.mode == 'none':
            return None
        if not (np.all(np.isfinite(position)) and np.all(np.isfinite(rotation))):
            return _stopped(Stop.LOST, 'the pose is not finite')
        tilt = float(tilt_deg(rotation))
        if tilt > config.tilt_limit_deg:
            return _stopped(Stop.TILTED, f'tilted by {tilt:.1f} deg at {_at(position)}, more than'
                            f' tilt_limit_deg {config.tilt_limit_deg:g}')
        if np.max(np.abs(position[:2])) > self._half_extent_m - config.border_m:
            return _stopped(Stop.OUTSIDE, f'out of the world at {_at(position)}: nearer than '
                            f'border_m {config.border_m:g} to its edge at '
                            f'{self._half_extent_m:g} m')
        return None

    def _drive(self, stamp_ns: int, position: np.ndarray, heading: float) -> DriveCommand:
        config = self._config
        if self._start_ns is None:
            self._start_ns = stamp_ns
        time_s = (stamp_ns - self._start_ns) * 1e-9 - config.start_delay_s
        if config.mode == 'none':
            return DriveCommand(0.0, 0.0, WAITING, 'mode is none: it drives nowhere')
        if time_s < 0.0:
            return DriveCommand(0.0, 0.0, WAITING,
                                f'until start_delay_s {config.start_delay_s:g} is over')
        if config.mode == 'profile':
            forward, yaw_rate = self._profile.at(time_s)
            if self._profile.done(time_s):
                return DriveCommand(0.0, 0.0, DONE, 'the velocity profile is at its end')
            return (self._stuck_on_profile(stamp_ns, position, heading, forward, yaw_rate)
                    or DriveCommand(forward, yaw_rate, DRIVING))
        if self._pursuit is None:
            self._pursuit = PurePursuit(config, make_route(config, position, heading))
        steering = self._pursuit.update(position, heading)
        if steering.done:
            return DriveCommand(0.0, 0.0, DONE,
                                f'the route of {self._pursuit.route.length_m:.2f} m is at its end')
        # Progress is made along the route, towards the route, and by turning towards it.
        progress = (steering.along_m - steering.across_m
                    - _METRES_PER_RADIAN * abs(steering.heading_error_rad))
        if self._check_is_due(stamp_ns) and self._record(stamp_ns, progress):
            gain = self._history[-1][1] - min(p for _, p in self._history)
            if gain < _STUCK_M:
                return _stopped(Stop.STUCK, f'stuck at {_at(position)}: {gain:.3f} m of progress '
                                f'in {config.stuck_time_s:g} s')
        return DriveCommand(steering.forward_mps, steering.yaw_rate_radps, DRIVING)

    def _stuck_on_profile(self, stamp_ns: int, position: np.ndarray, heading: float,
                          forward: float, yaw_rate: float) -> DriveCommand | None:
        """Return a stop if the pose has moved much less than commanded, else None."""
        config = self._config
        if forward == 0.0 and yaw_rate == 0.0:
            self._history.clear()
            return None
        if not self._check_is_due(stamp_ns):
            return None
        if self._heading is not None:
            self._turned += math.remainder(heading - self._heading, 2.0 * math.pi)
        self._heading = heading
        commanded = (abs(forward) + _METRES_PER_RADIAN * abs(yaw_rate)) * config.stuck_time_s
        if self._record(stamp_ns, (position[0], position[1], self._turned)):
            x, y, angle = self._history[-1][1]
            moved = max(math.hypot(x - px, y - py) + _METRES_PER_RADIAN * abs(angle - a)
                        for _, (px, py, a) in self._history)
            if moved < min(_STUCK_M, 0.3 * commanded):
                return _stopped(Stop.STUCK, f'stuck at {_at(position)}: moved {moved:.3f} m in'
                                f' {config.stuck_time_s:g} s')
        return None

    def _check_is_due(self, stamp_ns: int) -> bool:
        """Return whether the next check of the progress is due."""
        return (self._config.stuck_time_s > 0.0
                and (not self._history or stamp_ns - self._history[-1][0] >= _HISTORY_NS))

    def _record(self, stamp_ns: int, progress: object) -> bool:
        """Record the progress; return whether the history spans the whole stuck time."""
        span_ns = self._config.stuck_time_s * 1e9
        self._history.append((stamp_ns, progress))
        full = stamp_ns - self._history[0][0] >= span_ns
        while stamp_ns - self._history[0][0] > span_ns:
            self._history.popleft()
        return full


def _check_waypoints(config: DriveConfig, half_extent_m: float) -> None:
    """Raise ConfigError if a waypoint in odom cannot be reached within the world.

    Args:
        half_extent_m: The world extends to +-half_extent_m [m]; the driver stops `border_m`
            before.
    """
    if config.mode not in ('waypoints', 'spline') or config.shape != 'none' or config.relative:
        return
    limit_m = half_extent_m - config.border_m
    for name in ('waypoints_x_m', 'waypoints_y_m'):
        for value in getattr(config, name):
            if abs(value) > limit_m:
                raise ConfigError(
                    f'{name}: {value:g} is not valid; valid is within +-{limit_m:g} [m], since '
                    f'the world ends at +-{half_extent_m:g} m and border_m is '
                    f'{config.border_m:g} m')


def _stopped(cause: Stop, reason: str) -> DriveCommand:
    return DriveCommand(0.0, 0.0, STOPPED, reason, cause)


def _at(position: np.ndarray) -> str:
    return f'x {position[0]:.2f} m, y {position[1]:.2f} m'
