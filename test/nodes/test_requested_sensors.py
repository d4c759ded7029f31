"""Sensors that are computed when they are due, and while somebody reads them."""

from collections.abc import Iterator
import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
from physics_scene import make_world
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import Vector3Stamped  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from sensor_msgs.msg import BatteryState, Imu  # noqa: E402

from lunar_rover_sim.bag.messages import time_ns  # noqa: E402
from lunar_rover_sim.base import frames, topics  # noqa: E402
from lunar_rover_sim.nodes.state_publisher import RequestedSensors  # noqa: E402
from lunar_rover_sim.rover.description import Legs, RoverDescription  # noqa: E402
from lunar_rover_sim.rover.physics.simulation import Simulation  # noqa: E402
from lunar_rover_sim.rover.physics.state import RoverState  # noqa: E402
from lunar_rover_sim.run.node_config import PhysicsNodeConfig  # noqa: E402
from lunar_rover_sim.sensors.registry import mounted  # noqa: E402
from lunar_rover_sim.sensors.sensor import Platform  # noqa: E402


class Reader:
    """A node whose publishers are itself; it reads the topics whose names begin as told."""

    def __init__(self, *read: str) -> None:
        self.sent: list[Any] = []
        self.read = read

    def create_publisher(self, kind: Any, name: str, *_: Any) -> Any:
        """Return a publisher that gives its messages to this node."""
        def publish(message: Any) -> None:
            self.sent.append(deserialize_message(message, kind) if isinstance(message, bytes)
                             else message)

        return SimpleNamespace(publish=publish,
                               get_subscription_count=lambda: int(name.startswith(self.read)))


def of(node: Reader, simulation: Simulation, config: PhysicsNodeConfig) -> RequestedSensors:
    """Return the sensors of a rover on its world, read by a node."""
    platform = Platform(simulation, config.sun, config.seed,
                        1e-9 * config.state_period_ns)
    return RequestedSensors(node, mounted(config, platform),  # type: ignore[arg-type]
                            topics.OF_SOFT_GROUND)


@pytest.fixture(scope='module')
def simulation() -> Iterator[Simulation]:
    with Simulation(make_world(), RoverDescription(), PhysicsNodeConfig()) as made:
        yield made


def test_power_is_made_for_readers(state: RoverState, simulation: Simulation) -> None:
    """By the definition of BatteryState what is drawn is negative."""
    node = Reader('nothing')
    power = of(node, simulation, PhysicsNodeConfig())
    pushing = dataclasses.replace(state, motor_torque_nm=np.full(4, 0.3),
                                  joint_velocity_radps=np.full(4, 2.0))
    power.publish(pushing, 5)
    assert not node.sent
    node.read = ('power/',)
    power.publish(pushing, 5)
    assert [m.location for m in node.sent] == [*Legs().names, 'bus']
    assert all(time_ns(m.header.stamp) == 5 and m.present for m in node.sent)
    assert {m.power_supply_status for m in node.sent} == {
        BatteryState.POWER_SUPPLY_STATUS_DISCHARGING}
    currents = [m.current for m in node.sent]
    assert max(currents) < -0.05 and currents[4] == pytest.approx(sum(currents[:4]), abs=1e-3)
    assert [m.voltage for m in node.sent] == [pytest.approx(12.0, abs=0.02)] * 5
    assert all(np.isnan([m.charge, m.percentage, m.temperature]).all() for m in node.sent)


def test_one_line_of_power_may_be_read_alone(state: RoverState, simulation: Simulation) -> None:
    node = Reader('power/bus')
    of(node, simulation, PhysicsNodeConfig()).publish(state, 5)
    assert [m.location for m in node.sent] == ['bus']


def test_sun_sensor_and_star_tracker_are_made_for_readers_when_due(
        simulation: Simulation) -> None:
    node, config = Reader('nothing'), PhysicsNodeConfig()
    heading = of(node, simulation, config)
    heading.publish(simulation.state, 0)
    assert not node.sent
    node.read = ('sun_sensor', 'star_tracker')
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
    assert attitude.header.frame_id == 'base_link'
    q = attitude.orientation
    assert frames.matrix_from_wxyz([q.w, q.x, q.y, q.z]) == pytest.approx(R, abs=2e-3)
    assert np.linalg.eigvalsh(attitude.orientation_covariance.reshape(3, 3)).min() > 0.0
    assert attitude.angular_velocity_covariance[0] == -1.0
    assert attitude.linear_acceleration_covariance[0] == -1.0


def test_the_solar_panel_is_read_when_due(simulation: Simulation) -> None:
    node, config = Reader('power/solar'), PhysicsNodeConfig()
    solar = of(node, simulation, config)
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


def test_wheel_odometry_is_made_for_readers_and_begins_with_them(
        state: RoverState, simulation: Simulation) -> None:
    node = Reader('nothing')
    config = PhysicsNodeConfig.from_mapping({'wheel_odometry': {'forward_scale': 0.8}})
    wheels = of(node, simulation, config)

    def turn(*angles: float) -> None:
        for angle in angles:
            wheels.publish(dataclasses.replace(state, joint_angle_rad=np.full(4, angle)), 0)
    turn(0.0, 0.2)
    assert not node.sent
    node.read = ('wheel/',)
    turn(0.3, 0.4)
    assert [m.header.frame_id for m in node.sent] == ['wheel_odom'] * 2
    assert [m.pose.pose.position.x for m in node.sent] == [
        0.0, pytest.approx(0.8 * 0.1 * (0.072 * np.cos(0.35) + 0.008), rel=0.01)]
    node.read = ('nothing',)
    turn(5.0)
    node.read = ('wheel/',)
    turn(9.0)
    assert node.sent[-1].pose.pose.position.x == 0.0
    turn(9.1)
    assert node.sent[-1].pose.pose.position.x > 0.0
    wheels.restart()
    turn(0.0)
    assert node.sent[-1].pose.pose.position.x == 0.0


def test_slip_is_summed_while_it_is_read(state: RoverState, simulation: Simulation) -> None:
    """Its velocity times the time between states is what its position gains."""
    node, config = Reader('ground_truth/slip'), PhysicsNodeConfig()
    feet = of(node, simulation, config)
    for k in range(2):
        feet.publish(state, k)
    first, second = node.sent
    assert first.name == [*Legs().names, *(f'{leg}_sweep' for leg in Legs().names)]
    gained = np.asarray(second.position) - first.position
    assert gained == pytest.approx(1e-9 * config.state_period_ns * np.asarray(second.velocity))


def test_wheel_odometry_comes_with_every_state(state: RoverState, simulation: Simulation) -> None:
    """It is sent as it lies in CDR: as rclpy reads it, each has its own numbers and stamp."""
    node = Reader('wheel/')
    sensors = of(node, simulation, PhysicsNodeConfig())
    angle = state.joint_angle_rad
    for k in range(3):
        sensors.publish(dataclasses.replace(state, joint_angle_rad=angle + 0.1 * k), 5 * k)
    assert [time_ns(m.header.stamp) for m in node.sent] == [0, 5, 10]
    assert {(m.header.frame_id, m.child_frame_id) for m in node.sent} == {
        (topics.WHEEL_ODOM.frame_id, 'base_link')}
    way = [m.pose.pose.position.x for m in node.sent]
    assert way[0] == 0.0 and way[2] > way[1] > 0.0
