"""Conversions between core classes and ROS 2 messages of states and commands.

Images, camera infos, and the clouds of stereo and ground are in `image_conversions`, LiDAR clouds
and scans in `lidar_node`, boxes and labels in `image_conversions`, sensors on request in
`state_publisher`. The publishers of sun and diagnostics, and slam_node, fill theirs themselves.

Quaternions are wxyz in the core and xyzw in messages. What physics publishes of every state is
made in `state_publisher`: its numbers are written into CDR (`Refilled`).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import math
from typing import Any, TYPE_CHECKING

from builtin_interfaces.msg import Time
from geometry_msgs.msg import (Point, PoseStamped, PoseWithCovarianceStamped, Quaternion, Twist,
                               TwistStamped, Vector3)
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from lunar_rover_sim.base import frames
from lunar_rover_sim.base.errors import brief, GraphError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.rover.description import Legs
from lunar_rover_sim.rover.pose import RoverPose

if TYPE_CHECKING:
    from lunar_rover_sim.rover.physics.state import RoverState
    from lunar_rover_sim.sensors.wheel_odometry import WheelOdometry

# What messages state of exact values, in the squares of their units. Zeros would mean `unknown` in
# sensor_msgs/Imu, and estimators invert covariances.
EXACT_VARIANCE = 1e-8
UNKNOWN_VARIANCE = 1e6
_PLANAR = [0, 1, 5]     # x, y and yaw among the six axes of a pose or twist


def time_msg(stamp_ns: int) -> Time:
    """Return a stamp [ns] as a message."""
    return Time(sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S)


def wheel_odometry_numbers(odometry: WheelOdometry) -> tuple[Sequence[float], ...]:
    """Return pose (7), its covariance (36), twist (6) and its covariance (36) of an Odometry.

    Pose and twist are planar; the variance of what they do not know is huge.
    """
    x, y, yaw = odometry.pose.tolist()
    forward, turning = odometry.twist.tolist()
    pose, twist = (np.diag(np.full(6, UNKNOWN_VARIANCE)) for _ in range(2))
    pose[np.ix_(_PLANAR, _PLANAR)] = odometry.covariance + EXACT_VARIANCE * np.eye(3)
    twist[_PLANAR, _PLANAR] = np.maximum(odometry.twist_variance, EXACT_VARIANCE)
    return ((x, y, 0.0, 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)),
            pose.ravel().tolist(), (forward, 0.0, 0.0, 0.0, 0.0, turning),
            twist.ravel().tolist())


def pose_of(msg: Odometry) -> Array:
    """Return T_world_base (4, 4) of an odometry message; raise GraphError if it is not a pose."""
    p, q = msg.pose.pose.position, msg.pose.pose.orientation
    position, quat = np.array([p.x, p.y, p.z]), np.array([q.w, q.x, q.y, q.z])
    norm = frames.length(quat.tolist())
    if not np.all(np.isfinite(position)) or not abs(norm - 1.0) < 1e-3:
        raise GraphError(f'odom: position {position.tolist()}, orientation wxyz {quat.tolist()} '
                         'is not a pose; valid is finite with a unit quaternion')
    return frames.se3(frames.matrix_from_wxyz(quat / norm), position)


def twist_of(msg: Odometry) -> tuple[Array, Array]:
    """Return linear [m/s] and angular [rad/s] velocity, (3,) in axes of the child frame.

    Raises:
        GraphError: If they are not finite.
    """
    v, w = msg.twist.twist.linear, msg.twist.twist.angular
    twist = np.array([v.x, v.y, v.z]), np.array([w.x, w.y, w.z])
    if not np.all(np.isfinite(twist)):
        raise GraphError(f'odom: twist {twist[0].tolist()}, {twist[1].tolist()} is not valid; '
                         'valid is finite')
    return twist


def twist(forward_mps: float, yaw_rate_radps: float) -> Twist:
    """Return a velocity command: forward velocity [m/s] and yaw rate [rad/s, left positive]."""
    msg = Twist()
    msg.linear.x, msg.angular.z = float(forward_mps), float(yaw_rate_radps)
    return msg


def twist_stamped(forward_mps: float, yaw_rate_radps: float, stamp: Time) -> TwistStamped:
    """Return the same with a stamp, in base_link."""
    msg = TwistStamped(twist=twist(forward_mps, yaw_rate_radps))
    _set_header(msg.header, stamp, frames.BASE_FRAME)
    return msg


def fill_joint_state(msg: JointState, legs: Legs, position: Array, velocity: Array,
                     effort: Array | None, stamp: Time) -> JointState:
    """Write angles [rad], velocities [rad/s] and torques [N m] of the legs into `msg`.

    Returns `msg`. Without torques the effort is empty.
    """
    msg.header.stamp = stamp
    msg.name = list(legs.joint_names)
    msg.position, msg.velocity = position.tolist(), velocity.tolist()
    msg.effort = [] if effort is None else effort.tolist()
    return msg


def legs_of(msg: JointState, legs: Legs, field: str) -> Array:
    """Return (legs,) values of `field` ('position' [rad] or 'velocity' [rad/s]) in leg order.

    The message may name the joints in any order, and others too.

    Raises:
        GraphError: If a joint or its value is missing, or is not finite.
    """
    names, values = list(msg.name), getattr(msg, field)
    try:
        found = np.array([values[names.index(joint)] for joint in legs.joint_names], dtype=float)
    except (ValueError, IndexError):
        raise GraphError(f'{field} {brief(list(values))} of joints {brief(names)} refused; valid '
                         f'is one value each for {", ".join(legs.joint_names)}') from None
    if not np.isfinite(found).all():
        raise GraphError(f'{field} {brief(list(values))} refused; valid is finite')
    return found


def fill_entity_state(msg: Any, state: RoverState, stamp: Time, frame_id: str) -> None:
    """Write pose and twist in axes of a frame into a simulation_interfaces/EntityState."""
    _set_header(msg.header, stamp, frame_id)
    R_world_base = frames.matrix_from_wxyz(state.orientation_wxyz)
    set_vector(msg.pose.position, state.position_m)
    _set_quaternion(msg.pose.orientation, state.orientation_wxyz)
    set_vector(msg.twist.linear, R_world_base @ state.linear_velocity_mps)
    set_vector(msg.twist.angular, R_world_base @ state.angular_velocity_radps)


def pose_stamped(T_world_body: Array, frame_id: str, stamp: Time) -> PoseStamped:
    """Return a (4, 4) pose as a message."""
    msg = PoseStamped()
    _set_header(msg.header, stamp, frame_id)
    set_vector(msg.pose.position, T_world_body[:3, 3])
    _set_quaternion(msg.pose.orientation, frames.wxyz_from_matrix(T_world_body[:3, :3]))
    return msg


def pose_with_covariance(T_world_body: Array, covariance: Array, frame_id: str,
                         stamp: Time) -> PoseWithCovarianceStamped:
    """Return a (4, 4) pose and the (6, 6) covariance about fixed axes as a message."""
    msg = PoseWithCovarianceStamped()
    _set_header(msg.header, stamp, frame_id)
    set_vector(msg.pose.pose.position, T_world_body[:3, 3])
    _set_quaternion(msg.pose.pose.orientation, frames.wxyz_from_matrix(T_world_body[:3, :3]))
    msg.pose.covariance = covariance.ravel()
    return msg


def rover_pose(odom_raw: bytes, joints_raw: bytes | None, legs: Legs) -> RoverPose:
    """Return pose and motion; legs without a valid message, or without velocities, are at rest.

    The node that drives the legs counts and names messages that are not valid.
    """
    odom = deserialize_message(odom_raw, Odometry)
    linear_mps, angular_radps = twist_of(odom)
    angles, speeds = np.zeros(len(legs.each)), np.zeros(len(legs.each))
    if joints_raw is not None:
        joints = deserialize_message(joints_raw, JointState)
        with suppress(GraphError):
            angles = legs_of(joints, legs, 'position')
            if len(joints.velocity):
                speeds = legs_of(joints, legs, 'velocity')
    return RoverPose(pose_of(odom), angles, linear_mps, angular_radps, speeds)


def _set_header(header: Header, stamp: Time, frame_id: str) -> None:
    header.stamp = stamp
    header.frame_id = frame_id


def set_vector(msg: Point | Vector3, xyz: Array) -> None:
    """Write (3,) numbers into a vector or a point."""
    msg.x, msg.y, msg.z = xyz.tolist()


def _set_quaternion(msg: Quaternion, wxyz: Array) -> None:
    msg.w, msg.x, msg.y, msg.z = wxyz.tolist()
