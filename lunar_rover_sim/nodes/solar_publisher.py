"""The power of the solar panel: a topic on request."""

from __future__ import annotations

import math

from rclpy.node import Node
from sensor_msgs.msg import BatteryState

from lunar_rover_sim import topics
from lunar_rover_sim.illumination.solar_panel import solar_power_w
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.nodes.sun_from_rover import SunFromRover
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.rover.description import Motor
from lunar_rover_sim.run.node_config import PhysicsNodeConfig
from lunar_rover_sim.seconds import NS_PER_S


class SolarPublisher:
    """Publishes what the panel gives to the supply, while somebody reads it.

    publisher: that of the topic
    """

    def __init__(self, node: Node, sun: SunFromRover, config: PhysicsNodeConfig,
                 motor: Motor) -> None:
        self._panel, self._irradiance = config.solar_panel, config.sun.irradiance
        self._supply_v = motor.supply_voltage_v
        self._sun = sun
        self.publisher = node.create_publisher(BatteryState, topics.SOLAR_POWER.name,
                                               qos.offered(topics.SOLAR_POWER))

    def publish(self, state: RoverState, stamp_ns: int) -> None:
        """Publish what is due at a state and read."""
        panel = self._panel
        if stamp_ns % (NS_PER_S // panel.rate_hz) or not self.publisher.get_subscription_count():
            return
        sun = self._sun.seen(state, panel.position_m, stamp_ns)
        power_w = solar_power_w(panel, sun, self._irradiance, state.T_world_base[:3, :3])
        unknown = math.nan
        message = BatteryState(
            voltage=self._supply_v, current=power_w / self._supply_v, temperature=unknown,
            charge=unknown, capacity=unknown, design_capacity=unknown, percentage=unknown,
            present=True, location='solar_panel')
        if power_w > 0.0:
            message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_CHARGING
        message.header.stamp = conversions.time_msg(stamp_ns)
        self.publisher.publish(message)
