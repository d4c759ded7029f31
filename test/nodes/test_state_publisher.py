"""What is published of every state: transforms, order, messages that are refilled."""

from collections.abc import Callable, Sequence
import dataclasses
import logging
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import AccelStamped, WrenchStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from rosbags.typesys import get_typestore, Stores  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import Imu, JointState  # noqa: E402

from lunar_rover_sim.base import frames, topics  # noqa: E402
from lunar_rover_sim.nodes import conversions, state_publisher  # noqa: E402
from lunar_rover_sim.rover.description import Legs, RoverDescription  # noqa: E402
from lunar_rover_sim.rover.mounts import imu_pose  # noqa: E402
from lunar_rover_sim.rover.physics.state import RoverState  # noqa: E402
from lunar_rover_sim.rover.urdf import urdf  # noqa: E402
from lunar_rover_sim.rover.visual import link_poses  # noqa: E402
from lunar_rover_sim.run.node_config import PhysicsNodeConfig  # noqa: E402
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise  # noqa: E402


def random_state(rng: np.random.Generator) -> RoverState:
    """Return a state of random numbers, with a unit quaternion."""
    shapes = {'contact_force_n': (4, 3), 'contact_torque_nm': (4, 3),
              **dict.fromkeys(('joint_angle_rad', 'joint_velocity_radps', 'motor_torque_nm',
                               'motor_current_a'), (4,))}
    values: dict[str, Any] = {f.name: rng.standard_normal(shapes.get(f.name, (3,)))
                              for f in dataclasses.fields(RoverState)}
    quat = rng.standard_normal(4)
    values.update(stamp_ns=0, orientation_wxyz=quat / np.linalg.norm(quat))
    return RoverState(**values)


class FakeNode:
    """Keeps everything that is published, and the topics in the order of publishing."""

    def __init__(self) -> None:
        self.sent: dict[str, list[Any]] = {}
        self.order: list[str] = []

    def create_publisher(self, kind: Any, topic: str, profile: Any) -> Any:
        """Return a publisher that keeps what it is given, all as bytes."""
        messages = self.sent.setdefault(topic, [])

        def publish(message: Any) -> None:
            messages.append(message)
            self.order.append(topic)

        return type('Publisher', (), {'publish': staticmethod(publish)})

    def get_logger(self) -> Any:
        """Return a logger."""
        return logging.getLogger()


def published(state: RoverState, **parameters: bool) -> FakeNode:
    """Return a node after a physics_node with these parameters has published a state."""
    node = FakeNode()
    noise = ImuNoise(ImuConfig(), 200, np.random.default_rng(1))
    state_publisher.StatePublisher(
        node, RoverDescription(), noise,  # type: ignore[arg-type]
        PhysicsNodeConfig(**parameters)).publish(state, 5_000_000)  # type: ignore[arg-type]
    return node


def transforms_of(node: FakeNode, topic: str) -> Any:
    """Return the transforms that are sent first on a topic."""
    message: Any = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(
        node.sent[topic][0], topics.TF.type)
    return message.transforms


def test_transforms(state: RoverState) -> None:
    """odom → base_link → legs move, and the sensors are static."""
    node = published(state)
    moving = {t.child_frame_id: t for t in transforms_of(node, 'tf')}
    legs = {f'{leg}_link' for leg in Legs().names}
    assert set(moving) == {'base_link', 'base_footprint', *legs}
    assert moving['base_link'].header.frame_id == 'odom'
    assert moving['base_link'].transform.translation.y == 2.0
    for name in ('odom', 'imu/data_raw', '/clock'):
        assert len(node.sent[name]) == 1


def test_tf_is_the_tree_of_the_urdf(state: RoverState) -> None:
    """The same parents and poses: with robot_state_publisher no frame has two parents."""
    rover = RoverDescription()
    node = published(dataclasses.replace(state, joint_angle_rad=np.zeros(4)))
    sent = {t.child_frame_id: t for name in ('tf', 'tf_static')
            for t in transforms_of(node, name)}
    for joint in ElementTree.fromstring(urdf(rover).encode()).findall('joint'):
        parent, child, origin = map(joint.find, ('parent', 'child', 'origin'))
        assert parent is not None and child is not None and origin is not None
        found = sent.pop(child.attrib['link'])
        assert found.header.frame_id == parent.attrib['link']
        xyz, rpy = ([float(v) for v in origin.attrib[k].split()] for k in ('xyz', 'rpy'))
        p, q = found.transform.translation, found.transform.rotation
        assert [p.x, p.y, p.z] == pytest.approx(xyz, abs=1e-8)
        assert abs(np.dot([q.w, q.x, q.y, q.z], frames.wxyz_from_rpy(*rpy))) == pytest.approx(1.0)
    assert set(sent) == {'base_link', 'base_footprint'}     # they belong to no link
    # The chase camera has its pose as a topic; the wheel odometry has no place in the world.
    # render_node publishes the frames of hazard cameras.
    apart = {'', topics.TRUE_ODOM.frame_id, frames.CHASE_OPTICAL_FRAME, frames.WHEEL_ODOM_FRAME,
             topics.HAZARD_IMAGE.frame_id}
    contract = topics.of_legs(topics.CONTRACT, rover.legs.names)
    frame_ids = {topic.frame_id for topic in contract} - apart
    tree = {t.header.frame_id for name in ('tf', 'tf_static')
            for t in transforms_of(node, name)} | {
        t.child_frame_id for name in ('tf', 'tf_static') for t in transforms_of(node, name)}
    assert frame_ids <= tree


@pytest.mark.parametrize(('parameters', 'frames_sent', 'odometry'), [
    ({'publish_tf': False}, set(), ('odom', 'odom', 'base_link')),
    ({'separate_truth': True}, {'ground_truth/base_link'},
     ('ground_truth/odom', 'ground_truth/odom', 'ground_truth/base_link')),
    ({'separate_truth': True, 'publish_tf': False}, set(),
     ('ground_truth/odom', 'ground_truth/odom', 'ground_truth/base_link'))])
def test_an_estimator_may_own_odom(state: RoverState, parameters: dict[str, bool],
                                   frames_sent: set[str],
                                   odometry: tuple[str, str, str]) -> None:
    """Then nobody else publishes odom → base_link, and the truth may have frames of its own."""
    node = published(state, **parameters)
    moving = {t.child_frame_id for t in transforms_of(node, 'tf')}
    assert moving == {f'{leg}_link' for leg in Legs().names} | frames_sent
    assert {'odom', 'ground_truth/odom'} & set(node.sent) == {odometry[0]}
    msg = deserialize_message(node.sent[odometry[0]][0], Odometry)
    assert (msg.header.frame_id, msg.child_frame_id) == odometry[1:]


def test_one_of_several_rovers_is_without_a_clock(state: RoverState) -> None:
    """Two publishers of /clock would make time jump."""
    node = published(state, publish_clock=False)
    assert '/clock' not in node.sent and len(node.sent['odom']) == 1


def sent_twice(rover: RoverDescription, imu: ImuConfig, states: Sequence[RoverState],
               ) -> Callable[[topics.Topic, Any], Any]:
    """Return what reads the second message of a topic, of one publisher of two states."""
    node = FakeNode()
    publisher = state_publisher.StatePublisher(
        node, rover, ImuNoise(imu, 200, np.random.default_rng(1)),  # type: ignore[arg-type]
        PhysicsNodeConfig())
    for k, each in enumerate(states):
        publisher.publish(each, 5_000_000 + k * 1_234_567_890_123)
    return lambda topic, kind: deserialize_message(node.sent[topic.graph_name][1], kind)


def test_messages_hold_the_second_state() -> None:
    """Nothing of the state before is left in messages whose numbers are written anew."""
    rng = np.random.default_rng(3)
    first, second = random_state(rng), random_state(rng)
    rover = RoverDescription()
    read = sent_twice(rover, ImuConfig(), (first, second))
    same = ImuNoise(ImuConfig(), 200, np.random.default_rng(1))
    same.measure(first.specific_force_mps2, first.imu_rate_radps)
    sample = same.measure(second.specific_force_mps2, second.imu_rate_radps)
    stamp = conversions.time_msg(1_234_572_890_123)

    def numbers(vector: Any) -> list[float]:
        return [vector.x, vector.y, vector.z]

    def turn(quaternion: Any) -> list[float]:
        return [quaternion.w, *numbers(quaternion)]

    odom = read(topics.ODOM, Odometry)
    assert (odom.header.frame_id, odom.child_frame_id) == ('odom', 'base_link')
    assert numbers(odom.pose.pose.position) == second.position_m.tolist()
    assert turn(odom.pose.pose.orientation) == second.orientation_wxyz.tolist()
    assert numbers(odom.twist.twist.linear) == second.linear_velocity_mps.tolist()
    assert numbers(odom.twist.twist.angular) == second.angular_velocity_radps.tolist()
    joints = read(topics.JOINT_STATES, JointState)
    assert list(joints.name) == list(Legs().joint_names)
    for found, expected in ((joints.position, second.joint_angle_rad),
                            (joints.velocity, second.joint_velocity_radps),
                            (joints.effort, second.motor_torque_nm)):
        assert list(found) == expected.tolist()
    noisy, truth = read(topics.IMU_RAW, Imu), read(topics.IMU_TRUTH, Imu)
    for imu, force, rate in ((noisy, sample.specific_force, sample.rate),
                             (truth, second.specific_force_mps2, second.imu_rate_radps)):
        assert numbers(imu.linear_acceleration) == force.tolist()
        assert numbers(imu.angular_velocity) == rate.tolist()
        assert imu.header.frame_id == 'imu_link'
    bias = read(topics.IMU_BIAS, AccelStamped).accel
    assert numbers(bias.linear) + numbers(bias.angular) == [*sample.accel_bias, *sample.gyro_bias]
    links = link_poses(rover, second.joint_angle_rad)
    R_world_base = frames.matrix_from_wxyz(second.orientation_wxyz)
    wrenches = []
    for k, (leg, topic) in enumerate(zip(
            Legs().names, topics.of_legs([topics.CONTACT], Legs().names))):
        wrench = read(topic, WrenchStamped)
        wrenches.append(wrench)
        assert wrench.header.frame_id == f'{leg}_link'
        for found, expected in ((wrench.wrench.force, second.contact_force_n[k]),
                                (wrench.wrench.torque, second.contact_torque_nm[k])):
            in_world = R_world_base @ links[leg][:3, :3] @ numbers(found)
            assert in_world == pytest.approx(expected)
    assert read(topics.CLOCK, Clock).clock == stamp
    for message in (odom, joints, noisy, truth, *wrenches):
        assert message.header.stamp == stamp


def test_the_orientation_of_the_imu() -> None:
    """The truth has it in `odom`, w positive; the noisy signal says that it has none."""
    rover = RoverDescription()
    mount = dataclasses.replace(rover.imu, rpy_deg=(10.0, -20.0, 60.0))
    rover = dataclasses.replace(rover, imu=mount)
    state = random_state(np.random.default_rng(4))
    for sign in (1.0, -1.0):
        turned = dataclasses.replace(state, orientation_wxyz=sign * state.orientation_wxyz)
        read = sent_twice(rover, ImuConfig(), (state, turned))
        q = read(topics.IMU_TRUTH, Imu).orientation
        expected = frames.wxyz_from_matrix(
            frames.matrix_from_wxyz(state.orientation_wxyz) @ imu_pose(rover)[:3, :3])
        assert [q.w, q.x, q.y, q.z] == pytest.approx(expected.tolist(), abs=1e-12)
    assert read(topics.IMU_RAW, Imu).orientation_covariance[0] == -1.0


def test_what_covariances_state(state: RoverState) -> None:
    """Zeros would mean `unknown`; robot_localization raises less than 1e-9, and says so."""
    read = sent_twice(RoverDescription(), ImuConfig(), (state, state))
    noisy, truth, odom = (read(topics.IMU_RAW, Imu), read(topics.IMU_TRUTH, Imu),
                          read(topics.ODOM, Odometry))
    force, rate = ImuNoise(ImuConfig(), 200, np.random.default_rng(1)).white_noise_variances()
    assert noisy.linear_acceleration_covariance.tolist() == np.diag([force] * 3).ravel().tolist()
    assert noisy.angular_velocity_covariance.tolist() == np.diag([rate] * 3).ravel().tolist()
    clean = sent_twice(RoverDescription(), ImuConfig(enabled=False), (state, state))(
        topics.IMU_RAW, Imu)
    for covariance in (clean.linear_acceleration_covariance, clean.angular_velocity_covariance,
                       truth.orientation_covariance, truth.linear_acceleration_covariance,
                       truth.angular_velocity_covariance):
        assert covariance.tolist() == np.diag([1e-8] * 3).ravel().tolist()
    for covariance in (odom.pose.covariance, odom.twist.covariance):
        variances = np.linalg.eigvalsh(covariance.reshape(6, 6))
        assert np.all((variances >= 1e-9) & (variances <= 1e-7))
