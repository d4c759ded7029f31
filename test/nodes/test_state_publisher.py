"""What is published of every state: transforms, order, messages that are refilled."""

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


def test_the_order_of_a_state(state: RoverState) -> None:
    """What time waits for comes first; who has the clock has the rest of its time."""
    order = [topic for topic in published(state).order if not topic.startswith('tf')]
    assert order[:2] == ['joint_states', 'odom'] and order[-1] == '/clock'
    assert len(order) == len(set(order)) == 10


def test_refilled_messages_equal_new_ones() -> None:
    """Nothing of the state before is left in the messages of the next one."""
    rng = np.random.default_rng(3)
    first, second = random_state(rng), random_state(rng)
    rover = RoverDescription()
    mount = dataclasses.replace(rover.imu, rpy_deg=(10.0, -20.0, 60.0))
    rover = dataclasses.replace(rover, imu=mount)
    noise, same = (ImuNoise(ImuConfig(), 200, np.random.default_rng(1)) for _ in range(2))
    node = FakeNode()
    publisher = state_publisher.StatePublisher(node, rover, noise,  # type: ignore[arg-type]
                                               PhysicsNodeConfig())
    publisher.publish(first, 5_000_000)
    publisher.publish(second, 1_234_567_890_123)
    same.measure(first.specific_force_mps2, first.imu_rate_radps)
    sample = same.measure(second.specific_force_mps2, second.imu_rate_radps)
    stamp = conversions.time_msg(1_234_567_890_123)
    odometry = Odometry()
    conversions.set_odometry_covariance(odometry)
    imu_wxyz = frames.wxyz_from_matrix(imu_pose(rover)[:3, :3])
    links = link_poses(rover, second.joint_angle_rad)
    expected = {
        topics.CLOCK: Clock(clock=stamp),
        topics.ODOM: conversions.fill_odometry(odometry, second, stamp),
        topics.JOINT_STATES: conversions.fill_joint_state(
            JointState(), Legs(), second.joint_angle_rad, second.joint_velocity_radps,
            second.motor_torque_nm, stamp),
        topics.IMU_RAW: conversions.fill_imu_raw(Imu(), sample, *same.white_noise_variances(),
                                                 stamp),
        topics.IMU_TRUTH: conversions.fill_imu_truth(Imu(), second, imu_wxyz, stamp),
        topics.IMU_BIAS: conversions.fill_imu_bias(AccelStamped(), sample, stamp),
        **{topic: conversions.fill_wrench(WrenchStamped(),
                                          frames.rotated(R.T, second.contact_force_n[k]),
                                          frames.rotated(R.T, second.contact_torque_nm[k]),
                                          f'{leg}_link', stamp)
           for k, (leg, topic) in enumerate(zip(
               Legs().names, topics.of_legs([topics.CONTACT], Legs().names)))
           for R in [frames.rotated(links[leg][:3, :3].T,
                                    frames.matrix_from_wxyz(second.orientation_wxyz))]}}
    for topic, message in expected.items():
        # As sent: a message that is refilled is serialised before the next one.
        sent = deserialize_message(node.sent[topic.graph_name][1], type(message))
        assert sent == message, topic.name
