"""Sensors that physics_node measures when they are due, and only while somebody reads them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import functools
import math
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import BatteryState

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.base.frames import wxyz_from_matrix
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.rover.physics.state import RoverState
from lunar_rover_sim.sensors.sensor import Attitude, JointValues, Sensor, Supply, Vector
from lunar_rover_sim.sensors.wheel_odometry import WheelOdometry

_UNKNOWN = 'temperature', 'charge', 'capacity', 'design_capacity', 'percentage'
_EXACT_RAD2 = 1e-14     # added, since zeros would say that the covariance is unknown


class RequestedSensors:
    """Publishes each sensor while it is read.

    Attributes:
        publishers: Those of all topics.
    """

    def __init__(self, node: Node, sensors: Sequence[Sensor],
                 silent: Sequence[topics.Topic] = ()) -> None:
        """Offer the topics.

        Args:
            sensors: In the order in which they are published.
            silent: Topics that are not offered in this run.
        """
        self._sensors: list[tuple[Sensor, list[tuple[topics.Topic, Publisher]]]] = [
            (sensor, [(topic, node.create_publisher(message_class(topic.type), topic.name,
                                                    qos.offered(topic)))
                      for topic in sensor.offered if topic not in silent])
            for sensor in sensors]
        self._names = {sensor: {topic.name for topic in sensor.offered} for sensor in sensors}
        self._unread: set[Sensor] = set()
        self.publishers = [publisher for _, offered in self._sensors for _, publisher in offered]

    def publish(self, state: RoverState, stamp_ns: int) -> None:
        """Publish what is due at a state and read; a sensor that nobody reads begins anew."""
        for sensor, offered in self._sensors:
            read = [each for each in offered if each[1].get_subscription_count()]
            if not read:
                if sensor not in self._unread:
                    sensor.restart()
                    self._unread.add(sensor)
                continue
            self._unread.discard(sensor)
            if not sensor.is_due(stamp_ns):
                continue
            measured = sensor.measure(state, stamp_ns)
            if not measured.keys() <= self._names[sensor]:
                raise GraphError(f'sensor {sensor.name}: measures {", ".join(measured)}; it '
                                 f'publishes {", ".join(sorted(self._names[sensor]))}')
            for topic, publisher in read:
                if topic.name in measured:
                    publisher.publish(_message(topic, measured[topic.name], stamp_ns))

    def restart(self) -> None:
        """The rover stands at its start again."""
        for sensor, _ in self._sensors:
            sensor.restart()


def _message(topic: topics.Topic, measured: Any, stamp_ns: int) -> Any:
    message = message_class(topic.type)()
    message.header.stamp = conversions.time_msg(stamp_ns)
    message.header.frame_id = topic.frame_id
    if isinstance(measured, Mapping):
        for name, value in measured.items():
            *parents, field = name.split('.')
            setattr(functools.reduce(getattr, parents, message), field, value)
    else:
        _FILLERS[type(measured)](message, measured)
    return message


def _fill_vector(message: Any, measured: Vector) -> None:
    message.vector.x, message.vector.y, message.vector.z = map(float, measured.xyz)


def _fill_attitude(message: Any, measured: Attitude) -> None:
    """Fill an Imu with an orientation alone: what it does not have is -1 (sensor_msgs/Imu)."""
    q = message.orientation
    q.w, q.x, q.y, q.z = wxyz_from_matrix(measured.R_world_base).tolist()
    message.orientation_covariance = (measured.covariance_rad2 + _EXACT_RAD2 * np.eye(3)).ravel()
    message.angular_velocity_covariance[0] = message.linear_acceleration_covariance[0] = -1.0


def _fill_joints(message: Any, measured: JointValues) -> None:
    message.name = list(measured.names)
    message.position, message.velocity = list(measured.position), list(measured.velocity)


def _fill_supply(message: BatteryState, measured: Supply) -> None:
    message.location, message.present = measured.line, True
    message.voltage, message.current = measured.voltage_v, measured.current_a
    for name in _UNKNOWN:
        setattr(message, name, math.nan)
    if not measured.gives:
        message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    elif measured.current_a > 0.0:
        message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_CHARGING


_FILLERS: dict[type, Callable[[Any, Any], None]] = {
    Vector: _fill_vector, Attitude: _fill_attitude, JointValues: _fill_joints,
    Supply: _fill_supply, WheelOdometry: conversions.fill_wheel_odometry}
