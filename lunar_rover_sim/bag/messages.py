"""Stamps, vectors and poses of deserialised messages as numbers.

The functions read attributes only, so that messages of rosbags and of rclpy are both taken.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, se3
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.rover.description import Legs


def time_ns(stamp: Any) -> int:
    """Return a builtin_interfaces/Time in ns."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def header_ns(message: Any) -> int:
    """Return the stamp [ns] of a message with a header."""
    return time_ns(message.header.stamp)


def exposure_s(message: Any) -> float:
    """Return the exposure time [s] of a pair from a message of `stereo/exposure`."""
    return float(message.position[0])


def xyz(vector: Any) -> tuple[float, float, float]:
    """Return a geometry_msgs/Vector3 or Point."""
    return vector.x, vector.y, vector.z


def wxyz(quaternion: Any) -> tuple[float, float, float, float]:
    """Return a geometry_msgs/Quaternion, w first."""
    return quaternion.w, quaternion.x, quaternion.y, quaternion.z


def pose_matrix(odometry: Any) -> Array:
    """Return the (4, 4) pose of the child frame in the header's frame of a nav_msgs/Odometry."""
    pose = odometry.pose.pose
    return se3(matrix_from_wxyz(wxyz(pose.orientation)), xyz(pose.position))


def transform_matrix(stamped: Any) -> Array:
    """Return T_parent_child (4, 4) of a geometry_msgs/TransformStamped."""
    transform = stamped.transform
    return se3(matrix_from_wxyz(wxyz(transform.rotation)), xyz(transform.translation))


def odometry_row(odometry: Any) -> tuple[float, ...]:
    """Return the 13 numbers of a nav_msgs/Odometry.

    Position x, y, z; orientation w, x, y, z; linear, then angular velocity in the child frame.
    """
    pose, twist = odometry.pose.pose, odometry.twist.twist
    return (*xyz(pose.position), *wxyz(pose.orientation), *xyz(twist.linear), *xyz(twist.angular))


def imu_row(imu: Any) -> tuple[float, ...]:
    """Return the 6 numbers of a sensor_msgs/Imu: angular velocity, then specific force."""
    return *xyz(imu.angular_velocity), *xyz(imu.linear_acceleration)


def accel_row(stamped: Any) -> tuple[float, ...]:
    """Return the 6 numbers of a geometry_msgs/AccelStamped: angular, then linear."""
    return *xyz(stamped.accel.angular), *xyz(stamped.accel.linear)


def joints_row(message: Any, legs: Legs, where: object) -> Array:
    """Return positions, velocities and efforts (3 legs,) of a sensor_msgs/JointState, leg by leg.

    They are NaN where the message has none. Raises BagError as `joint_order`.
    """
    order = joint_order(message, legs, where)
    return np.concatenate([in_order(values, order) for values in (
        message.position, message.velocity, message.effort)])


def in_order(values: Any, order: list[int]) -> Array:
    """Return the values of joints in an order; NaN where there are none."""
    return np.asarray(values, float)[order] if len(values) else np.full(len(order), np.nan)


def joint_order(message: Any, legs: Legs, where: object) -> list[int]:
    """Return where each joint of the legs stands in a sensor_msgs/JointState.

    Args:
        where: What the message belongs to, for the text of an error.

    Raises:
        BagError: If a joint is missing.
    """
    names = list(message.name)
    missing = sorted(set(legs.joint_names) - set(names))
    if missing:
        raise BagError(f'{where}: {topics.JOINT_STATES.name} lacks {missing[0]}; valid are '
                       f'the joints {", ".join(legs.joint_names)}')
    return [names.index(name) for name in legs.joint_names]
