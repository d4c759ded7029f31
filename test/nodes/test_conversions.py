"""Messages made from states: quaternion order, frames, transforms."""

from __future__ import annotations

import dataclasses
import logging
from typing import Any
from xml.etree import ElementTree

import numpy as np
from physics_scene import make_world
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import AccelStamped, Vector3Stamped  # noqa: E402  (needs rclpy)
from geometry_msgs.msg import WrenchStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import Imu, JointState  # noqa: E402

from lunar_rover_sim import frames, topics  # noqa: E402
from lunar_rover_sim.bag.messages import time_ns  # noqa: E402
from lunar_rover_sim.errors import GraphError  # noqa: E402
from lunar_rover_sim.nodes import conversions, state_publisher  # noqa: E402
from lunar_rover_sim.nodes.heading_publisher import HeadingPublisher  # noqa: E402
from lunar_rover_sim.nodes.power_publisher import PowerPublisher  # noqa: E402
from lunar_rover_sim.nodes.solar_publisher import SolarPublisher  # noqa: E402
from lunar_rover_sim.nodes.sun_from_rover import SunFromRover  # noqa: E402
from lunar_rover_sim.nodes.wheel_odometry_publisher import WheelOdometryPublisher  # noqa: E402
from lunar_rover_sim.physics.config import ImuConfig, WheelOdometryConfig  # noqa: E402
from lunar_rover_sim.physics.imu import ImuNoise, ImuSample  # noqa: E402
from lunar_rover_sim.physics.simulation import Simulation  # noqa: E402
from lunar_rover_sim.physics.state import RoverState  # noqa: E402
from lunar_rover_sim.physics.wheel_odometry import Rolling, WheelOdometry  # noqa: E402
from lunar_rover_sim.rover.description import RoverDescription  # noqa: E402
from lunar_rover_sim.rover.mounts import imu_pose  # noqa: E402
from lunar_rover_sim.rover.urdf import urdf  # noqa: E402
from lunar_rover_sim.rover.visual import link_poses  # noqa: E402
from lunar_rover_sim.run.node_config import OdometryConfig, PhysicsNodeConfig  # noqa: E402

LEG_JOINTS = [f'{leg}_joint' for leg in topics.LEGS]
YAW_90 = frames.wxyz_from_rpy(0, 0, np.pi / 2)


@pytest.fixture()
def state() -> RoverState:
    """A rover at (1, 2, 3), turned left by 90 degrees, rolling forward at 0.1 m/s."""
    values: dict[str, Any] = {f.name: np.zeros(4) for f in dataclasses.fields(RoverState)}
    values.update(stamp_ns=5_000_000, position_m=np.array([1.0, 2.0, 3.0]),
                  orientation_wxyz=YAW_90, linear_velocity_mps=np.array([0.1, 0.0, 0.0]),
                  angular_velocity_radps=np.zeros(3), contact_force_n=np.ones((4, 3)),
                  contact_torque_nm=np.zeros((4, 3)),
                  specific_force_mps2=np.array([0.0, 0.0, 1.62]), imu_rate_radps=np.zeros(3))
    return RoverState(**values)


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
    assert conversions.legs_of(msg, 'position').tolist() == [1, 2, 3, 4]


def test_incomplete_joints_are_refused() -> None:
    """A joint or a value that is missing is named."""
    for name, velocity in ((LEG_JOINTS, []), (LEG_JOINTS, [5.0, 6.0]), (['leg'] * 4, [1.0] * 4)):
        msg = JointState(name=name, velocity=velocity)
        with pytest.raises(GraphError, match='velocity of joints .* not complete'):
            conversions.legs_of(msg, 'velocity')


class FakeNode:
    """Keeps everything that is published, and the topics in the order of publishing."""

    def __init__(self) -> None:
        self.sent: dict[str, list[Any]] = {}
        self.order: list[str] = []

    def create_publisher(self, kind: Any, topic: str, profile: Any) -> Any:
        """Return a publisher that keeps what it is given: messages of tf, the others as bytes."""
        messages = self.sent.setdefault(topic, [])

        def publish(message: Any) -> None:
            messages.append(message)
            self.order.append(topic)

        return type('Publisher', (), {'publish': staticmethod(publish)})

    def get_logger(self) -> Any:
        """Return a logger."""
        return logging.getLogger()


class FakeTFMessage:
    """tf2_msgs is not on PyPI: the same field, no middleware."""

    def __init__(self, transforms: list[Any]) -> None:
        self.transforms = transforms


def test_transforms(state: RoverState, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where tf2_msgs is installed, odom → base_link → legs move and the sensors are static."""
    monkeypatch.setattr(state_publisher, 'TFMessage', FakeTFMessage)
    node = FakeNode()
    noise = ImuNoise(ImuConfig(), 200, np.random.default_rng(1))
    publisher = state_publisher.StatePublisher(node, RoverDescription(), noise,  # type: ignore
                                               PhysicsNodeConfig())
    publisher.publish(state, state.stamp_ns)
    moving = {t.child_frame_id: t for t in node.sent['tf'][0].transforms}
    legs = {f'{leg}_link' for leg in topics.LEGS}
    assert set(moving) == {'base_link', 'base_footprint', *legs}
    assert moving['base_link'].header.frame_id == 'odom'
    assert moving['base_link'].transform.translation.y == 2.0
    for name in ('odom', 'imu/data_raw', '/clock'):
        assert len(node.sent[name]) == 1


def test_tf_is_the_tree_of_the_urdf(state: RoverState, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same parents and poses: with robot_state_publisher no frame has two parents."""
    monkeypatch.setattr(state_publisher, 'TFMessage', FakeTFMessage)
    rover = RoverDescription()
    upright = dataclasses.replace(state, joint_angle_rad=np.zeros(4))
    node = FakeNode()
    publisher = state_publisher.StatePublisher(  # type: ignore
        node, rover, ImuNoise(ImuConfig(), 200, np.random.default_rng(1)), PhysicsNodeConfig())
    publisher.publish(upright, 5_000_000)
    sent = {t.child_frame_id: t for name in ('tf', 'tf_static')
            for t in node.sent[name][0].transforms}
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
    frame_ids = {topic.frame_id for topic in topics.CONTRACT} - apart
    tree = {t.header.frame_id for name in ('tf', 'tf_static')
            for t in node.sent[name][0].transforms} | {
        t.child_frame_id for name in ('tf', 'tf_static') for t in node.sent[name][0].transforms}
    assert frame_ids <= tree


@pytest.mark.parametrize(('parameters', 'frames_sent', 'odometry'), [
    ({'publish_tf': False}, set(), ('odom', 'odom', 'base_link')),
    ({'separate_truth': True}, {'ground_truth/base_link'},
     ('ground_truth/odom', 'ground_truth/odom', 'ground_truth/base_link')),
    ({'separate_truth': True, 'publish_tf': False}, set(),
     ('ground_truth/odom', 'ground_truth/odom', 'ground_truth/base_link'))])
def test_an_estimator_may_own_odom(state: RoverState, monkeypatch: pytest.MonkeyPatch,
                                   parameters: dict[str, bool], frames_sent: set[str],
                                   odometry: tuple[str, str, str]) -> None:
    """Then nobody else publishes odom → base_link, and the truth may have frames of its own."""
    monkeypatch.setattr(state_publisher, 'TFMessage', FakeTFMessage)
    node = FakeNode()
    state_publisher.StatePublisher(  # type: ignore
        node, RoverDescription(), ImuNoise(ImuConfig(), 200, np.random.default_rng(1)),
        PhysicsNodeConfig(**parameters)).publish(state, 5_000_000)    # type: ignore[arg-type]
    moving = {t.child_frame_id for t in node.sent['tf'][0].transforms}
    assert moving == {f'{leg}_link' for leg in topics.LEGS} | frames_sent
    assert {'odom', 'ground_truth/odom'} & set(node.sent) == {odometry[0]}
    msg = deserialize_message(node.sent[odometry[0]][0], Odometry)
    assert (msg.header.frame_id, msg.child_frame_id) == odometry[1:]


def test_one_of_several_rovers_is_without_a_clock(state: RoverState) -> None:
    """Two publishers of /clock would make time jump."""
    node = FakeNode()
    state_publisher.StatePublisher(  # type: ignore
        node, RoverDescription(), ImuNoise(ImuConfig(), 200, np.random.default_rng(1)),
        PhysicsNodeConfig(publish_clock=False)).publish(state, 5_000_000)
    assert '/clock' not in node.sent and len(node.sent['odom']) == 1


def test_the_order_of_a_state(state: RoverState) -> None:
    """What time waits for comes first; who has the clock has the rest of its time."""
    node = FakeNode()
    state_publisher.StatePublisher(  # type: ignore
        node, RoverDescription(), ImuNoise(ImuConfig(), 200, np.random.default_rng(1)),
        PhysicsNodeConfig()).publish(state, 5_000_000)
    order = [topic for topic in node.order if not topic.startswith('tf')]
    assert order[:2] == ['joint_states', 'odom'] and order[-1] == '/clock'
    assert len(order) == len(set(order)) == 10


def test_refilled_messages_equal_new_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of the state before is left in the messages of the next one."""
    monkeypatch.setattr(state_publisher, 'TFMessage', None)
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
    conversions.set_odometry_covariance(odometry, OdometryConfig())
    imu_wxyz = frames.wxyz_from_matrix(imu_pose(rover)[:3, :3])
    links = link_poses(rover, second.joint_angle_rad)
    expected = {
        topics.CLOCK: Clock(clock=stamp),
        topics.ODOM: conversions.fill_odometry(odometry, second, stamp),
        topics.JOINT_STATES: conversions.fill_joint_state(
            JointState(), second.joint_angle_rad, second.joint_velocity_radps,
            second.motor_torque_nm, stamp),
        topics.IMU_RAW: conversions.fill_imu_raw(Imu(), sample, *same.white_noise_variances(),
                                                 stamp),
        topics.IMU_TRUTH: conversions.fill_imu_truth(Imu(), second, imu_wxyz, stamp),
        topics.IMU_BIAS: conversions.fill_imu_bias(AccelStamped(), sample, stamp),
        **{topic: conversions.fill_wrench(WrenchStamped(), second.contact_force_n[k] @ R,
                                          second.contact_torque_nm[k] @ R, f'{leg}_link', stamp)
           for k, (leg, topic) in enumerate(zip(topics.LEGS, topics.CONTACTS))
           for R in [frames.matrix_from_wxyz(second.orientation_wxyz) @ links[leg][:3, :3]]}}
    for topic, message in expected.items():
        # As sent: a message that is refilled is serialised before the next one.
        sent = deserialize_message(node.sent[topic.graph_name][1], type(message))
        assert sent == message, topic.name


def test_imu_messages(state: RoverState) -> None:
    """The truth has the orientation of the IMU, w positive; the noisy signal has none."""
    R_base_imu = frames.matrix_from_wxyz(frames.wxyz_from_rpy(0.3, -0.2, 2.9))
    stamp = conversions.time_msg(7)
    for sign in (1.0, -1.0):
        turned = dataclasses.replace(state, orientation_wxyz=sign * YAW_90)
        truth = conversions.fill_imu_truth(Imu(), turned, frames.wxyz_from_matrix(R_base_imu),
                                           stamp)
        q = truth.orientation
        expected = frames.wxyz_from_matrix(frames.matrix_from_wxyz(YAW_90) @ R_base_imu)
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
    msg = conversions.wheel_odometry(odometry, conversions.time_msg(5))
    assert (msg.header.frame_id, msg.child_frame_id) == ('wheel_odom', 'base_link')
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


class Reader:
    """A node whose publishers are itself, which counts its readers as it is told."""

    def __init__(self) -> None:
        self.sent: list[Any] = []
        self.readers = 0

    def create_publisher(self, *_: Any) -> Any:
        """Return itself."""
        return self

    def publish(self, message: Any) -> None:
        """Keep a message."""
        self.sent.append(message)

    def get_subscription_count(self) -> int:
        """Return how many read."""
        return self.readers


def test_power_is_made_for_readers(state: RoverState) -> None:
    """By the definition of BatteryState what is drawn is negative."""
    node = Reader()
    power = PowerPublisher(node, PhysicsNodeConfig(), RoverDescription().motor)  # type: ignore
    pushing = dataclasses.replace(state, motor_torque_nm=np.full(4, 0.3),
                                  joint_velocity_radps=np.full(4, 2.0))
    power.publish(pushing, 5)
    assert not node.sent
    node.readers = 1
    power.publish(pushing, 5)
    assert [m.location for m in node.sent] == [*topics.LEGS, 'bus']
    assert all(time_ns(m.header.stamp) == 5 and m.present for m in node.sent)
    currents = [m.current for m in node.sent]
    assert max(currents) < -0.05 and currents[4] == pytest.approx(sum(currents[:4]), abs=1e-3)
    assert [m.voltage for m in node.sent] == [pytest.approx(12.0, abs=0.02)] * 5
    assert all(np.isnan([m.charge, m.percentage, m.temperature]).all() for m in node.sent)


def test_sun_sensor_and_star_tracker_are_made_for_readers_when_due() -> None:
    node, config = Reader(), PhysicsNodeConfig()
    with Simulation(make_world(), RoverDescription(), config) as simulation:
        sun_from_rover = SunFromRover(simulation, make_world(), config.sun)
        heading = HeadingPublisher(node, sun_from_rover, config)    # type: ignore[arg-type]
        heading.publish(simulation.state, 0)
        assert not node.sent
        node.readers = 1
        for stamp_ns in (1_000_000_000, 1_005_000_000, 1_200_000_000):
            heading.publish(simulation.state, stamp_ns)
        R = simulation.state.T_world_base[:3, :3]
    sent = [m for m in node.sent if isinstance(m, Vector3Stamped)]
    assert [time_ns(m.header.stamp) for m in sent] == [1_000_000_000, 1_200_000_000]
    sun = frames.sun_direction(config.sun.azimuth_deg, config.sun.elevation_deg)
    for m in sent:
        assert m.header.frame_id == 'base_link'
        assert R @ [m.vector.x, m.vector.y, m.vector.z] == pytest.approx(sun, abs=0.01)
    attitude, = (m for m in node.sent if isinstance(m, Imu))
    q = attitude.orientation
    assert frames.matrix_from_wxyz([q.w, q.x, q.y, q.z]) == pytest.approx(R, abs=2e-3)
    assert np.linalg.eigvalsh(attitude.orientation_covariance.reshape(3, 3)).min() > 0.0
    assert attitude.angular_velocity_covariance[0] == -1.0
    assert attitude.linear_acceleration_covariance[0] == -1.0


def test_the_solar_panel_is_read_when_due() -> None:
    node, config = Reader(), PhysicsNodeConfig()
    rover = RoverDescription()
    with Simulation(make_world(), rover, config) as simulation:
        sun_from_rover = SunFromRover(simulation, make_world(), config.sun)
        solar = SolarPublisher(node, sun_from_rover, config,    # type: ignore[arg-type]
                               rover.motor)
        solar.publish(simulation.state, 0)
        assert not node.sent
        node.readers = 1
        for stamp_ns in (1_000_000_000, 1_005_000_000, 1_200_000_000):
            solar.publish(simulation.state, stamp_ns)
        up = simulation.state.T_world_base[:3, 2]
    assert [time_ns(m.header.stamp) for m in node.sent] == [1_000_000_000, 1_200_000_000]
    sun, panel = config.sun, config.solar_panel
    cosine = up @ frames.sun_direction(sun.azimuth_deg, sun.elevation_deg)
    for m in node.sent:
        assert m.voltage * m.current == pytest.approx(
            sun.irradiance * cosine * panel.area_m2 * panel.efficiency, rel=3e-3)
        assert m.power_supply_status == m.POWER_SUPPLY_STATUS_CHARGING


def test_wheel_odometry_is_made_for_readers_and_begins_with_them(state: RoverState) -> None:
    node = Reader()
    config = PhysicsNodeConfig.from_mapping({'wheel_odometry': {'forward_scale': 0.8}})
    wheels = WheelOdometryPublisher(node, config, RoverDescription())  # type: ignore[arg-type]

    def turn(*angles: float) -> None:
        for angle in angles:
            wheels.publish(dataclasses.replace(state, joint_angle_rad=np.full(4, angle)), 0)
    turn(0.0, 0.2)
    assert not node.sent
    node.readers = 1
    turn(0.3, 0.4)
    assert [m.pose.pose.position.x for m in node.sent] == [
        0.0, pytest.approx(0.8 * 0.1 * (0.072 * np.cos(0.35) + 0.008), rel=0.01)]
    node.readers = 0
    turn(5.0)
    node.readers = 1
    turn(9.0)
    assert node.sent[-1].pose.pose.position.x == 0.0
    wheels.restart()
    turn(0.0)
    assert node.sent[-1].pose.pose.position.x == 0.0
