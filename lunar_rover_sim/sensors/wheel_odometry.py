"""Wheel odometry: the planar pose that a rover works out from the encoders of its legs alone.

A leg stands on the spoke that is nearest to straight down, at the angle a from there. Its rounded
tip rolls: while the leg turns by dq, its axle gets on by dq h over a flat ground, where

    h = (l - r) cos a + r

is the height of the axle (spoke length l, tip radius r). Legs of different heights make a body
stand on one of two groups, neighbours being in different ones: the diagonals of four legs, the
tripods of six. It is the group of the greater mean height. Least squares over the speeds with
which its feet would scrape along and across gives, for feet at (x, y) from their middle and mean
ways s_l and s_r of the n_l left and the n_r right ones,

    d = (n_l s_l + n_r s_r) / (n_l + n_r),
    w = (s_r - s_l) (y_l - y_r) n_l n_r / (n_l + n_r) / sum(x^2 + y^2),

and d + w y_m for the rover, whose middle is y_m to the right of that of the feet. With a diagonal
of a rectangle these are the means of sum and difference, w over (x^2 + y^2) / y.

What the rover really does differs by the scales and the deviations of `Rolling`. The errors are a
random walk over the way that the legs have rolled; they are independent over one step of the walk
and more. The covariance is propagated to first order, as in Siegwart, Nourbakhsh, Scaramuzza,
Introduction to Autonomous Mobile Robots, 2011, section 5.2.4.
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import math
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.bag.messages import pose_matrix, xyz
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.rover.description import Legs, RoverDescription
from lunar_rover_sim.sensors.sensor import (FROM_PRESET, HEADING, numbers, over_preset, Platform,
                                            Sensor)

if TYPE_CHECKING:
    from lunar_rover_sim.rover.physics.state import RoverState


@dataclasses.dataclass(frozen=True)
class WheelOdometryConfig(Parameters):
    """Encoders of the legs, and what is known of the way that they do not see.

    Scales and deviations are those that were measured on the ground unless they are given:
    rougher ground and another rover have others, which `lunar_rover_sim validate odometry`
    measures. The encoder's default is that of a Faulhaber IE2-512: 512 lines, four edges each, on
    the shaft of the motor.
    """

    counts_per_turn: int = param(2048, 'edges of the encoder per turn of the motor', low=1,
                                 high=2**20)
    forward_scale: float = param(FROM_PRESET, 'way of the rover over that of rolling feet, 0.1 to '
                                 '2; -1: that of the ground', low=-1.0, high=2.0)
    yaw_scale: float = param(FROM_PRESET, 'turn of the rover over that of rolling feet, 0.1 to 2; '
                             '-1: that of the ground', low=-1.0, high=2.0)
    forward_stddev: float = param(
        FROM_PRESET, 'error along the heading, for each root of a metre that the legs have rolled,'
        ' 0 to 10; -1: that of the ground', unit='m/sqrt(m)', low=-1.0, high=10.0)
    lateral_stddev: float = param(FROM_PRESET, 'error across the heading, likewise',
                                  unit='m/sqrt(m)', low=-1.0, high=10.0)
    yaw_stddev: float = param(FROM_PRESET, 'error of the heading, likewise', unit='rad/sqrt(m)',
                              low=-1.0, high=10.0)

    def validate(self) -> None:
        """Raise ConfigError if a value is neither possible nor -1."""
        for name, low, high in (('forward_scale', 0.1, 2.0), ('yaw_scale', 0.1, 2.0),
                                ('forward_stddev', 0.0, 10.0), ('lateral_stddev', 0.0, 10.0),
                                ('yaw_stddev', 0.0, 10.0)):
            value = getattr(self, name)
            if value != FROM_PRESET and not low <= value <= high:
                raise ConfigError(f'{name}: {value:g} is not valid; valid is {low:g} to {high:g},'
                                  ' or -1 for that of the ground')


@dataclasses.dataclass(frozen=True)
class Rolling:
    """How a rover goes on over a ground while its feet roll.

    Attributes:
        forward_scale, yaw_scale: Its way and its turn over those of the feet.
        forward_stddev, lateral_stddev, yaw_stddev: Error along, across and of the heading, for
            each root of a metre that the legs have rolled [m/sqrt(m)], [rad/sqrt(m)].
    """

    forward_scale: float
    yaw_scale: float
    forward_stddev: float
    lateral_stddev: float
    yaw_stddev: float

    @classmethod
    def of(cls, config: WheelOdometryConfig, ground: str, rover: str = '') -> Rolling:
        """Return what a configuration gives, and else what was measured.

        Args:
            config: Its values count where they are given.
            ground: By name; a soil that was not measured counts as `highland`.
            rover: By name; one that was not measured on a ground counts as the packaged quad.
        """
        measured = _MEASURED.get(ground, _MEASURED['highland'])
        return over_preset(config, _OF_ROVERS.get((rover, ground), measured))


# Of the packaged rover with the gait calibration of the ground, by `lunar_rover_sim validate
# odometry` on 24 worlds of `baseline`, or of `soft` for the loose soil, seeds 1 to 24.
_MEASURED = {'rigid': Rolling(0.92, 0.78, 0.05, 0.035, 0.17),
             'highland': Rolling(0.97, 0.49, 0.052, 0.030, 0.22),
             'highland_loose': Rolling(0.96, 0.50, 0.056, 0.026, 0.26)}
# Of other packaged rovers, by the same command with `--rover`. On rigid ground
# (`ground.model=rigid`) deviations of the hexapod are those of the quad: errors last longer than
# the 5 s that the command fits (0.033, 0.016, 0.126), which promise too much on eight other
# worlds; these do not.
_OF_ROVERS = {('hexapod', 'rigid'): Rolling(0.987, 1.176, 0.05, 0.035, 0.17),
              ('hexapod', 'highland'): Rolling(1.01, 1.02, 0.033, 0.016, 0.116)}


@dataclasses.dataclass(frozen=True)
class Rolled:
    """The way that the feet rolled between two states, before any scale.

    Attributes:
        forward_m: Of the rover along its heading.
        yaw_rad: Its turn.
        way_m: Mean of the legs, without signs.
    """

    forward_m: float
    yaw_rad: float
    way_m: float


class _Group(NamedTuple):
    """Legs on which the rover stands at a time: indices of those on the left and on the right.

    Attributes:
        turn_per_m: Turn for half of what the right feet get on more.
        offset_m: Y of the middle.
    """

    left: list[int]
    right: list[int]
    turn_per_m: float
    offset_m: float

    @property
    def legs(self) -> list[int]:
        """All of them."""
        return [*self.left, *self.right]

    @classmethod
    def of(cls, legs: Legs, left: list[int], right: list[int]) -> _Group:
        """Return the group of these legs."""
        axles = legs.axle_positions_m()
        members = [*left, *right]
        x, y = (sum(axles[k][i] for k in members) / len(members) for i in (0, 1))
        y_left, y_right = (sum(axles[k][1] for k in side) / len(side) for side in (left, right))
        spread = sum((axles[k][0] - x)**2 + (axles[k][1] - y)**2 for k in members)
        return cls(left, right, 2.0 * (y_left - y_right) * len(left) * len(right) / len(members)
                   / spread, y)


def _groups(legs: Legs) -> list[_Group]:
    """Return the groups on which the rover stands by turns; else one, of all its legs."""
    sides: dict[tuple[bool, int], list[int]] = {}
    for k, (left, row) in enumerate(zip(legs.on_left, legs.rows())):
        sides.setdefault((left, (row + (not left)) % 2), []).append(k)
    groups = [_Group.of(legs, sides[True, parity], sides[False, parity])
              for parity in (0, 1) if (True, parity) in sides and (False, parity) in sides]
    everything = [[k for k, left in enumerate(legs.on_left) if left == side]
                  for side in (True, False)]
    return groups if len(groups) == 2 else [_Group.of(legs, *everything)]


class RollingFeet:
    """Turns angles of the legs into distances rolled, as the encoders see them."""

    def __init__(self, rover: RoverDescription, counts_per_turn: int) -> None:
        legs = rover.legs
        self._count_rad = 2.0 * math.pi / (counts_per_turn * rover.motor.gear_ratio)
        self._spoke_pitch_rad = legs.spoke_pitch_rad
        self._to_tip_m = legs.spoke_length_m - legs.tip_radius_m
        self._radius_m = legs.tip_radius_m
        self._groups = _groups(legs)
        self._angle: Array | None = None
        self._height_m: Array = np.zeros(len(legs.each))

    @property
    def resolution_m(self) -> float:
        """Way of a leg per count of its encoder, at most."""
        return self._count_rad * (self._to_tip_m + self._radius_m)

    def add(self, joint_angle_rad: ArrayLike) -> Rolled:
        """Return the way since the last angles (legs,), unwrapped; 0 for the first ones."""
        angle = np.round(np.asarray(joint_angle_rad) / self._count_rad) * self._count_rad
        pitch = self._spoke_pitch_rad
        height = self._to_tip_m * np.cos((angle + 0.5 * pitch) % pitch - 0.5 * pitch) \
            + self._radius_m
        if self._angle is None:
            self._angle, self._height_m = angle, height
        way = (angle - self._angle) * 0.5 * (height + self._height_m)
        self._angle, self._height_m = angle, height
        group = max(self._groups, key=lambda group: height[group.legs].mean())
        left, right = float(way[group.left].mean()), float(way[group.right].mean())
        yaw = 0.5 * (right - left) * group.turn_per_m
        forward = (len(group.left) * left + len(group.right) * right) / len(group.legs)
        return Rolled(forward + yaw * group.offset_m, yaw, float(np.mean(np.abs(way))))


class WheelOdometry:
    """Sums up a pose from angles of the legs; it begins at 0, certain.

    Attributes:
        pose: (3,) x, y [m] and yaw [rad] in the frame of the start.
        covariance: (3, 3) of it.
        twist: (2,) forward speed [m/s] and yaw rate [rad/s] over the last interval.
        twist_variance: (3,) of forward speed, lateral speed [m^2/s^2] and yaw rate [rad^2/s^2].
    """

    def __init__(self, rover: RoverDescription, counts_per_turn: int, rolling: Rolling) -> None:
        self._feet = RollingFeet(rover, counts_per_turn)
        self._rolling = rolling
        self._per_metre = np.square([rolling.forward_stddev, rolling.lateral_stddev,
                                     rolling.yaw_stddev])
        # Two readings of two legs, each rounded to a count; along and, by the track, of the turn.
        rounding = self._feet.resolution_m**2 / 12.0
        half_track_m = max(abs(y) for _, y, _ in rover.legs.axle_positions_m())
        self._floor = np.array([rounding, rounding, rounding / half_track_m**2])
        self.pose, self.covariance = np.zeros(3), np.zeros((3, 3))
        self.twist, self.twist_variance = np.zeros(2), np.zeros(3)

    def add(self, joint_angle_rad: ArrayLike, interval_s: float) -> None:
        """Go on to the next angles of the legs (legs,) [rad, unwrapped], after a time [s]."""
        rolled = self._feet.add(joint_angle_rad)
        forward = self._rolling.forward_scale * rolled.forward_m
        yaw = self._rolling.yaw_scale * rolled.yaw_rad
        middle = self.pose[2] + 0.5 * yaw
        c, s = math.cos(middle), math.sin(middle)
        variance = self._per_metre * rolled.way_m
        before = np.array([[1.0, 0.0, -s * forward], [0.0, 1.0, c * forward], [0.0, 0.0, 1.0]])
        added = np.array([[c, -s, -0.5 * s * forward], [s, c, 0.5 * c * forward],
                          [0.0, 0.0, 1.0]])
        self.covariance = (before @ self.covariance @ before.T
                           + added * variance @ added.T)
        self.pose = self.pose + [c * forward, s * forward, yaw]
        self.twist = np.array([forward, yaw]) / interval_s
        self.twist_variance = (variance + self._floor) / interval_s**2


class LegEncoders(Sensor):
    """Odometry from the encoders of the legs; its pose is 0 where reading began."""

    name = 'wheel_odometry'
    parameters = WheelOdometryConfig
    published = (topics.WHEEL_ODOM,)
    content = HEADING

    def __init__(self, config: WheelOdometryConfig, platform: Platform) -> None:
        super().__init__(config, platform)
        self.restart()

    def restart(self) -> None:
        """Begin at 0 again, with the next state."""
        platform = self.platform
        self._odometry = WheelOdometry(
            platform.rover, self.config.counts_per_turn,
            Rolling.of(self.config, platform.simulation.config.ground.name, platform.rover.name))

    def measure(self, state: RoverState, stamp_ns: int) -> Mapping[str, WheelOdometry]:
        """Return the sum so far."""
        self._odometry.add(state.joint_angle_rad, self.platform.state_period_s)
        return {topics.WHEEL_ODOM.name: self._odometry}

    @classmethod
    def read(cls, topic: str, message: Any) -> dict[str, Any]:
        """Return pose and twist of a nav_msgs/Odometry."""
        twist = message.twist.twist
        return {'frame': message.header.frame_id,
                'T_wheel_odom_base': [numbers(row) for row in pose_matrix(message)],
                'linear_mps': numbers(xyz(twist.linear)),
                'angular_radps': numbers(xyz(twist.angular))}
