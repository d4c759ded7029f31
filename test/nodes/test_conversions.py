"""Messages made from states, and states read from messages: axes, order, covariances."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip('rclpy')

from nav_msgs.msg import Odometry  # noqa: E402
from sensor_msgs.msg import Imu, JointState  # noqa: E402

from lunar_rover_sim import frames  # noqa: E402
from lunar_rover_sim.bag.messages import time_ns  # noqa: E402
from lunar_rover_sim.errors import GraphError  # noqa: E402
from lunar_rover_sim.nodes import conversions, image_conversions  # noqa: E402
from lunar_rover_sim.physics.state import RoverState  # noqa: E402
from lunar_rover_sim.rover.description import Legs, RoverDescription  # noqa: E402
from lunar_rover_sim.sensors.imu import ImuSample  # noqa: E402
from lunar_rover_sim.sensors.registry import OdometryConfig  # noqa: E402
from lunar_rover_sim.sensors.wheel_odometry import Rolling, WheelOdometry  # noqa: E402
from lunar_rover_sim.sensors.wheel_odometry import WheelOdometryConfig  # noqa: E402

LEG_JOINTS = [f'{leg}_joint' for leg in Legs().names]


def test_odometry(state: RoverState) -> None:
    """Pose in odom, twist in base_link; xyzw only in the message; and back."""
    msg = conversions.fill_odometry(Odometry(), state, conversions.time_msg(1_234_567_890))
    assert (msg.header.frame_id, msg.child_frame_id) == ('odom', 'base_link')
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec) == (1, 234_567_890)
    assert msg.pose.pose.orientation.z == pytest.approx(np.sqrt(0.5))
    assert msg.twist.twist.linear.x == 0.1
    T = conversions.pose_of(msg)
    assert np.allclose(T[:3, 3], [1, 2, 3])
    assert np.allclose(T[:3, 0], [0, 1, 0])


def test_the_twist_of_odometry(state: RoverState) -> None:
    """It comes back as it was written, in axes of base_link; one that is not finite is refused."""
    state = dataclasses.replace(state, angular_velocity_radps=np.array([0.1, -0.2, 0.3]))
    msg = conversions.fill_odometry(Odometry(), state, conversions.time_msg(0))
    linear, angular = conversions.twist_of(msg)
    assert linear.tolist() == [0.1, 0.0, 0.0]
    assert angular.tolist() == [0.1, -0.2, 0.3]
    msg.twist.twist.angular.y = float('nan')
    with pytest.raises(GraphError, match='odom: twist .* is not valid; valid is finite'):
        conversions.twist_of(msg)


def test_an_invalid_pose_is_refused(state: RoverState) -> None:
    """An all-zero quaternion, as in a message that was never filled, is named."""
    msg = conversions.fill_odometry(Odometry(), state, conversions.time_msg(0))
    msg.pose.pose.orientation.w = msg.pose.pose.orientation.z = 0.0
    with pytest.raises(GraphError, match='is not a pose'):
        conversions.pose_of(msg)


def test_joints_in_any_order() -> None:
    """Values are found by name, also among other joints."""
    msg = JointState(name=['arm', *reversed(LEG_JOINTS)], position=[0.0, 4.0, 3.0, 2.0, 1.0])
    assert conversions.legs_of(msg, Legs(), 'position').tolist() == [1, 2, 3, 4]


def test_incomplete_joints_are_refused() -> None:
    """A joint or a value that is missing is named."""
    for name, velocity in ((LEG_JOINTS, []), (LEG_JOINTS, [5.0, 6.0]), (['leg'] * 4, [1.0] * 4)):
        msg = JointState(name=name, velocity=velocity)
        with pytest.raises(GraphError, match='velocity of joints .* not complete'):
            conversions.legs_of(msg, Legs(), 'velocity')


def test_imu_messages(state: RoverState) -> None:
    """The truth has the orientation of the IMU, w positive; the noisy signal has none."""
    R_base_imu = frames.matrix_from_wxyz(frames.wxyz_from_rpy(0.3, -0.2, 2.9))
    stamp = conversions.time_msg(7)
    for sign in (1.0, -1.0):
        turned = dataclasses.replace(state, orientation_wxyz=sign * state.orientation_wxyz)
        truth = conversions.fill_imu_truth(Imu(), turned, frames.wxyz_from_matrix(R_base_imu),
                                           stamp)
        q = truth.orientation
        expected = frames.wxyz_from_matrix(
            frames.matrix_from_wxyz(state.orientation_wxyz) @ R_base_imu)
        assert [q.w, q.x, q.y, q.z] == pytest.approx(expected.tolist(), abs=1e-12)
    assert truth.linear_acceleration.z == 1.62
    sample = ImuSample(*(np.full(3, float(k)) for k in range(1, 5)))
    raw = conversions.fill_imu_raw(Imu(), sample, 0.25, 0.5, stamp)
    assert raw.orientation_covariance[0] == -1.0
    assert raw.linear_acceleration_covariance.tolist() == np.diag([0.25] * 3).ravel().tolist()
    assert raw.angular_velocity_covariance.tolist() == np.diag([0.5] * 3).ravel().tolist()
    assert raw.linear_acceleration.y == sample.specific_force[1]
    assert raw.angular_velocity.y == sample.rate[1]
    # Zeros would mean `unknown`: a sensor without noise states what truth states.
    clean = conversions.fill_imu_raw(Imu(), sample, 0.0, 0.0, stamp)
    for covariance in (clean.linear_acceleration_covariance, clean.angular_velocity_covariance,
                       truth.orientation_covariance, truth.linear_acceleration_covariance,
                       truth.angular_velocity_covariance):
        assert covariance.tolist() == np.diag([1e-8] * 3).ravel().tolist()


def test_the_covariance_of_odometry(state: RoverState) -> None:
    """What the parameters state, position before orientation; by default it can be inverted."""
    msg = Odometry()
    conversions.set_odometry_covariance(msg, OdometryConfig())
    conversions.fill_odometry(msg, state, conversions.time_msg(1))
    for covariance in (msg.pose.covariance, msg.twist.covariance):
        variances = np.linalg.eigvalsh(covariance.reshape(6, 6))
        # robot_localization raises less than 1e-9, and says so.
        assert np.all((variances >= 1e-9) & (variances <= 1e-7))
    conversions.set_odometry_covariance(msg, OdometryConfig(0.1, 0.2, 0.3, 0.4))
    assert np.allclose(msg.pose.covariance.reshape(6, 6), np.diag([0.01] * 3 + [0.04] * 3))
    assert np.allclose(msg.twist.covariance.reshape(6, 6), np.diag([0.09] * 3 + [0.16] * 3))


def test_velocity_commands() -> None:
    """A command reads back, with and without a stamp."""
    assert conversions.velocity_of(conversions.twist(0.1, -0.2)) == (0.1, -0.2)
    stamped = conversions.twist_stamped(0.1, -0.2, conversions.time_msg(3_000_000_007))
    assert conversions.velocity_of(stamped.twist) == (0.1, -0.2)
    assert time_ns(stamped.header.stamp) == 3_000_000_007
    assert stamped.header.frame_id == 'base_link'


def test_wheel_odometry_says_what_it_does_not_know() -> None:
    config = WheelOdometryConfig()
    odometry = WheelOdometry(RoverDescription(), config.counts_per_turn,
                             Rolling.of(config, 'highland'))
    for angle in np.linspace(0.0, 20.0, 100):
        odometry.add([0.8 * angle, angle, 0.8 * angle, angle], 0.005)
    msg = Odometry()
    conversions.fill_wheel_odometry(msg, odometry)
    assert msg.child_frame_id == 'base_link'
    x, y, yaw = odometry.pose
    assert (msg.pose.pose.position.x, msg.pose.pose.position.y) == (x, y)
    assert 2.0 * np.arctan2(msg.pose.pose.orientation.z, msg.pose.pose.orientation.w) \
        == pytest.approx(yaw)
    assert (msg.twist.twist.linear.x, msg.twist.twist.angular.z) == tuple(odometry.twist)
    for covariance, known in ((msg.pose.covariance, odometry.covariance),
                              (msg.twist.covariance, np.diag(odometry.twist_variance))):
        matrix = covariance.reshape(6, 6)
        assert np.all(np.linalg.eigvalsh(matrix) > 0.0)
        np.testing.assert_allclose(matrix[np.ix_([0, 1, 5], [0, 1, 5])], known, atol=2e-8)
        assert np.all(np.diag(matrix)[2:5] >= 1e6)


def test_a_cloud_has_the_colours_of_its_picture() -> None:
    """Packed as in stereo_image_proc; a grey picture has none."""
    points = np.zeros((2, 3, 3), np.float32)
    picture = np.zeros((2, 3, 3), np.uint8)
    picture[1, 2] = 200, 100, 50
    grey, colour = (image_conversions.point_cloud(points, pixels, 'left',
                                                  conversions.time_msg(0))
                    for pixels in (picture[..., 0], picture))
    assert [field.name for field in grey.fields] == ['x', 'y', 'z', 'intensity']
    assert [field.name for field in colour.fields] == ['x', 'y', 'z', 'intensity', 'rgb']
    assert (colour.point_step, colour.row_step, len(colour.data)) == (20, 60, 120)
    last = np.frombuffer(bytes(colour.data), np.uint8)[-4:]
    assert last.tolist() == [50, 100, 200, 0]
    assert np.frombuffer(bytes(colour.data), np.float32)[-2] == pytest.approx(124, abs=1)
