"""Sensors that are computed when they are due, and while somebody reads them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from physics_scene import make_world
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import Vector3Stamped  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402

from lunar_rover_sim import frames, topics  # noqa: E402
from lunar_rover_sim.bag.messages import time_ns  # noqa: E402
from lunar_rover_sim.nodes.heading_publisher import HeadingPublisher  # noqa: E402
from lunar_rover_sim.nodes.power_publisher import PowerPublisher  # noqa: E402
from lunar_rover_sim.nodes.solar_publisher import SolarPublisher  # noqa: E402
from lunar_rover_sim.nodes.sun_from_rover import SunFromRover  # noqa: E402
from lunar_rover_sim.nodes.wheel_odometry_publisher import WheelOdometryPublisher  # noqa: E402
from lunar_rover_sim.physics.simulation import Simulation  # noqa: E402
from lunar_rover_sim.physics.state import RoverState  # noqa: E402
from lunar_rover_sim.rover.description import RoverDescription  # noqa: E402
from lunar_rover_sim.run.node_config import PhysicsNodeConfig  # noqa: E402


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
