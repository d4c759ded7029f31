"""Voltage and current of the motors: topics on request."""

from __future__ import annotations

import math

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import BatteryState

from lunar_rover_sim import topics
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.physics.power_monitor import LINES, PowerMonitors
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.rover.description import Motor
from lunar_rover_sim.run.node_config import PhysicsNodeConfig


class PowerPublisher:
    """Publishes what the power monitors show, while somebody reads it.

    publishers: those of the lines, in the order of LINES
    """

    def __init__(self, node: Node, config: PhysicsNodeConfig, motor: Motor) -> None:
        self._monitors = PowerMonitors(motor, config.power_monitor,
                                       np.random.default_rng([config.seed, 2]))
        self.publishers = [node.create_publisher(BatteryState, topic.name, qos.offered(topic))
                           for topic in topics.POWER]

    def publish(self, state: RoverState, stamp_ns: int) -> None:
        """Publish the lines that are read, of the interval that a state ends."""
        read = [k for k, each in enumerate(self.publishers) if each.get_subscription_count()]
        if not read:
            return
        shown = self._monitors.measure(state.motor_torque_nm, state.joint_velocity_radps)
        for k in read:
            message = _message(LINES[k], float(shown.voltage_v[k]), float(shown.current_a[k]))
            message.header.stamp = conversions.time_msg(stamp_ns)
            self.publishers[k].publish(message)


def _message(line: str, voltage_v: float, current_a: float) -> BatteryState:
    """Return a message; its current is negative where power is drawn, as its definition says."""
    unknown = math.nan
    return BatteryState(
        voltage=voltage_v, current=-current_a, temperature=unknown, charge=unknown,
        capacity=unknown, design_capacity=unknown, percentage=unknown, present=True,
        power_supply_status=BatteryState.POWER_SUPPLY_STATUS_DISCHARGING, location=line)
