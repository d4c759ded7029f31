"""Messages made of states: quaternion order, frames, transforms."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from rosbags.typesys import get_typestore, Stores  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import Imu, JointState  # noqa: E402

from lunar_rover_sim import frames, topics  # noqa: E402  (what follows needs rclpy)
from lunar_rover_sim.errors import GraphError  # noqa: E402
from lunar_rover_sim.nodes import conversions, state_publisher  # noqa: E402
from lunar_rover_sim.nodes.joint_messages import command_template, JointReader  # noqa: E402
from lunar_rover_sim.physics.config import ImuConfig  # noqa: E402
from lunar_rover_sim.physics.imu import ImuNoise  # noqa: E402
from lunar_rover_sim.physics.state import RoverState  # noqa: E402
from lunar_rover_sim.rover.description import RoverDescription  # noqa: E402
from lunar_rover_sim.rover.mounts import imu_pose  # noqa: E402

YAW_90 = frames.wxyz_from_rpy(0, 0, np.pi / 2)


@pytest.fixture()
def state() -> RoverState:
    """A rover at (1, 2, 3), turned left by 90 degrees, rolling forward at 0.1 m/s."""
    from dataclasses import fields
    values: dict[str, Any] = {f.name: np.zeros(4) for f in fields(RoverState)}
    values.update(time_ns=5_000_000, position_m=np.array([1.0, 2.0, 3.0]),
                  orientation_wxyz=YAW_90, linear_velocity_mps=np.array([0.1, 0.0, 0.0]),
                  angular_velocity_radps=np.zeros(3), contact_force_n=np.ones((4, 3)),
                  contact_torque_nm=np.zeros((4, 3)),
                  specific_force_mps2=np.array([0.0, 0.0, 1.62]), imu_rate_radps=np.zeros(3))
    return RoverState(**values)


def test_odometry(state: RoverState) -> None:
    """Pose in odom, twist in base_link; xyzw only in the message; and back."""
    msg = conversions.odometry(state, conversions.time_msg(1_234_567_890))
    assert (msg.header.frame_id, msg.child_frame_id) == ('odom', 'base_link')
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec) == (1, 234_567_890)
    assert msg.pose.pose.orientation.z == pytest.approx(np.sqrt(0.5))
    assert msg.twist.twist.linear.x == 0.1
    T = conversions.pose_of(msg)
    assert np.allclose(T[:3, 3], [1, 2, 3])
    assert np.allclose(T[:3, 0], [0, 1, 0])


def test_a_pose_that_is_none_is_refused(state: RoverState) -> None:
    """An all-zero quaternion, as in a message nobody filled, is named."""
    msg = conversions.odometry(state, conversions.time_msg(0))
    msg.pose.pose.orientation.w = msg.pose.pose.orientation.z = 0.0
    with pytest.raises(GraphError, match='is not a pose'):
        conversions.pose_of(msg)


def test_joints_in_any_order() -> None:
    """Values are found by name, among others'."""
    msg = conversions.joint_state(conversions.time_msg(0), [1, 2, 3, 4], [5, 6, 7, 8])
    msg.name = ['arm', *reversed(msg.name)]
    msg.position = [0.0, *reversed(msg.position)]
    assert conversions.legs_of(msg, 'position').tolist() == [1, 2, 3, 4]


def test_joints_read_from_bytes() -> None:
    """The reader says what the message says, whoever made it, and when senders change."""
    usual = conversions.joint_state(conversions.time_msg(5), [1, 2, 3, 4], [5, 6, 7, 8])
    turned = conversions.joint_state(conversions.time_msg(6), [4, 3, 2, 1], [8, 7, 6, 5], [0.1])
    turned.name = list(reversed(turned.name))
    framed = conversions.joint_state(conversions.time_msg(7), [1, 2, 3, 4.5], [5, 6, 7, 8], [1, 2])
    framed.header.frame_id = 'rover'
    more = conversions.joint_state(conversions.time_msg(8), [0, 1, 2, 3, 4], [9, 5, 6, 7, 8])
    more.name = ['arm', *more.name]
    reader = JointReader()
    for msg in (usual, usual, turned, usual, framed, framed, more, usual):
        for field in ('position', 'velocity'):
            assert list(reader.read(serialize_message(msg), field)) == \
                conversions.legs_of(msg, field).tolist()
    for name, velocity in ((usual.name, []), (usual.name, [5.0, 6.0]), (['leg'] * 4, [1.0] * 4)):
        usual.name, usual.velocity = name, velocity
        with pytest.raises(GraphError, match='not complete'):
            reader.read(serialize_message(usual), 'velocity')


class FakeNode:
    """Takes what is published."""

    def __init__(self) -> None:
        self.sent: dict[str, list[Any]] = {}

    def create_publisher(self, kind: Any, topic: str, profile: Any) -> Any:
        """Return a publisher that keeps its messages."""
        messages = self.sent.setdefault(topic, [])
        return type('Publisher', (), {'publish': staticmethod(messages.append)})


class FakeTFMessage:
    """tf2_msgs is not on PyPI: the same field, no middleware."""

    def __init__(self, transforms: list[Any]) -> None:
        self.transforms = transforms


def test_transforms(state: RoverState, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where tf2_msgs is installed, odom → base_link → legs move and the sensors are static."""
    monkeypatch.setattr(state_publisher, 'TFMessage', FakeTFMessage)
    node = FakeNode()
    noise = ImuNoise(ImuConfig(), 200, np.random.default_rng(1))
    publisher = state_publisher.StatePublisher(node, RoverDescription(), noise)  # type: ignore
    publisher.publish(state, state.time_ns)
    moving = {t.child_frame_id: t for t in node.sent[topics.TF.name][0].transforms}
    assert set(moving) == {'base_link', *topics.LEGS}
    assert moving['base_link'].header.frame_id == 'odom'
    assert moving['base_link'].transform.translation.y == 2.0
    static = {t.child_frame_id: t for t in node.sent[topics.TF_STATIC.name][0].transforms}
    assert set(static) == {'imu_link', 'stereo_left_optical_frame', 'stereo_right_optical_frame'}
    left, right = (static[f'stereo_{side}_optical_frame'].transform for side in ('left', 'right'))
    assert left.translation.y - right.translation.y == pytest.approx(0.1)
    for name in (topics.ODOM.name, topics.IMU_RAW.name, topics.CLOCK.name):
        assert len(node.sent[name]) == 1


def test_reply_of_the_gait_controller() -> None:
    """The template that the node fills in is the message of a joint command."""
    template = command_template()
    template.numbers[:4], template.numbers[-4:] = [1, 2, 3, 4], [5, 6, 7, 8]
    msg = conversions.joint_state(conversions.time_msg(3_000_000_007), [1, 2, 3, 4], [5, 6, 7, 8])
    raw = template.stamped(3_000_000_007)
    assert deserialize_message(raw, JointState) == msg
    # To the byte: readers of bags refuse what stands behind the message.
    assert get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(raw, topics.JOINT_COMMANDS.type)


def test_filled_templates_are_the_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is published byte by byte says what the messages made one by one would say."""
    monkeypatch.setattr(state_publisher, 'TFMessage', FakeTFMessage)
    rng = np.random.default_rng(3)
    shapes = {'contact_force_n': (4, 3), 'contact_torque_nm': (4, 3),
              **dict.fromkeys(('joint_angle_rad', 'joint_velocity_radps', 'motor_torque_nm',
                               'motor_current_a'), (4,))}
    quat = rng.standard_normal(4)
    values: dict[str, Any] = {f.name: rng.standard_normal(shapes.get(f.name, (3,)))
                              for f in dataclasses.fields(RoverState)}
    values.update(time_ns=0, orientation_wxyz=-np.abs(quat) / np.linalg.norm(quat))
    moved = RoverState(**values)
    rover = RoverDescription()
    mount = dataclasses.replace(rover.imu, rpy_deg=(10.0, -20.0, 60.0))
    rover = dataclasses.replace(rover, imu=mount)
    noise, same = (ImuNoise(ImuConfig(), 200, np.random.default_rng(1)) for _ in range(2))
    node = FakeNode()
    state_publisher.StatePublisher(node, rover, noise).publish(  # type: ignore[arg-type]
        moved, 1_234_567_890_123)
    stamp = conversions.time_msg(1_234_567_890_123)
    sample = same.measure(moved.specific_force_mps2, moved.imu_rate_radps)
    expected = {
        topics.CLOCK: Clock(clock=stamp), topics.ODOM: conversions.odometry(moved, stamp),
        topics.JOINT_STATES: conversions.joint_state(
            stamp, moved.joint_angle_rad, moved.joint_velocity_radps, moved.motor_torque_nm),
        topics.IMU_RAW: conversions.imu_raw(sample, *same.white_noise_variances(), stamp),
        topics.IMU_BIAS: conversions.imu_bias(sample, stamp),
        **{topic: conversions.wrench(moved.contact_force_n[k], moved.contact_torque_nm[k], stamp)
           for k, topic in enumerate(topics.CONTACTS)}}
    for topic, message in expected.items():
        assert deserialize_message(node.sent[topic.name][0], type(message)) == message, topic.name
    truth = deserialize_message(node.sent[topics.IMU_TRUTH.name][0], Imu)
    by_matrix = conversions.imu_truth(moved, imu_pose(rover)[:3, :3], stamp)
    for axis in 'xyzw':
        assert getattr(truth.orientation, axis) == pytest.approx(
            getattr(by_matrix.orientation, axis), abs=1e-12)
    truth.orientation = by_matrix.orientation
    assert truth == by_matrix
