"""Pose of the rover and its legs, and the motion of both: all that a picture of it depends on."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from lunar_rover_sim.base.frames import Array


class Posed(Protocol):
    """Something with a pose, leg angles and their velocities.

    It is a `physics.state.RoverState` or a `RoverPose`.
    """

    @property
    def T_world_base(self) -> Array:
        """(4, 4) pose of base_link in the world."""

    @property
    def joint_angle_rad(self) -> Array:
        """(legs,) angles [rad] in the order of the rover's legs."""

    @property
    def linear_velocity_mps(self) -> Array:
        """(3,) velocity of the origin of base_link, base axes [m/s]."""

    @property
    def angular_velocity_radps(self) -> Array:
        """(3,) angular velocity of base_link, base axes [rad/s]."""

    @property
    def joint_velocity_radps(self) -> Array:
        """(legs,) velocities [rad/s] in the order of the rover's legs."""


def leg_values(values: Array, legs: int) -> Array:
    """Return values of the legs; 0 for each where there are none."""
    array = np.asarray(values, float)
    return array if array.size else np.zeros(legs)


def _zeros(count: int) -> Array:
    return dataclasses.field(default_factory=lambda: np.zeros(count))


@dataclasses.dataclass(frozen=True)
class RoverPose:
    """A pose, and a motion, that no simulation has to produce. By default the rover is at rest.

    Attributes:
        T_world_base: (4, 4) pose of base_link in the world, translation in metres.
        joint_angle_rad: (legs,) [rad]; empty: all 0.
        linear_velocity_mps: (3,) of the origin of base_link, base axes.
        angular_velocity_radps: (3,) base axes.
        joint_velocity_radps: (legs,); empty: at rest.
    """

    T_world_base: Array
    joint_angle_rad: Array = _zeros(0)
    linear_velocity_mps: Array = _zeros(3)
    angular_velocity_radps: Array = _zeros(3)
    joint_velocity_radps: Array = _zeros(0)


def moved(state: Posed, offset_m: Array) -> RoverPose:
    """Return a state at a place that is moved by (3,) [m], in double precision."""
    return RoverPose(moved_pose(state.T_world_base, offset_m), state.joint_angle_rad,
                     state.linear_velocity_mps, state.angular_velocity_radps,
                     state.joint_velocity_radps)


def moved_pose(T: Array, offset_m: Array) -> Array:
    """Return a (4, 4) pose whose place is moved by (3,) [m]."""
    result = np.array(T, float)
    result[:3, 3] += offset_m
    return result
