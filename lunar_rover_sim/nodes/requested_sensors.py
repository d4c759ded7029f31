"""What physics_node measures only while somebody reads it."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.publisher import Publisher

from lunar_rover_sim.nodes.foot_publisher import FootPublisher
from lunar_rover_sim.nodes.heading_publisher import HeadingPublisher
from lunar_rover_sim.nodes.power_publisher import PowerPublisher
from lunar_rover_sim.nodes.solar_publisher import SolarPublisher
from lunar_rover_sim.nodes.sun_from_rover import SunFromRover
from lunar_rover_sim.nodes.wheel_odometry_publisher import WheelOdometryPublisher
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.run.node_config import PhysicsNodeConfig
from lunar_rover_sim.world.model import World


class RequestedSensors:
    """Publishes each sensor while it is read."""

    def __init__(self, node: Node, simulation: Simulation, world: World,
                 rover: RoverDescription, config: PhysicsNodeConfig) -> None:
        self._feet = FootPublisher(node, simulation, 1e-9 * config.state_period_ns)
        self._wheels = WheelOdometryPublisher(node, config, rover)
        self._power = PowerPublisher(node, config, rover.motor)
        sun = SunFromRover(simulation, world, config.sun)
        self._heading = HeadingPublisher(node, sun, config)
        self._solar = SolarPublisher(node, sun, config, rover.motor)

    @property
    def publishers(self) -> list[Publisher]:
        """Those of all topics."""
        return [*self._feet.publishers, self._wheels.publisher, *self._power.publishers,
                *self._heading.publishers, self._solar.publisher]

    def publish(self, state: RoverState, stamp_ns: int) -> None:
        """Publish what is read of a state."""
        self._feet.publish(stamp_ns)
        self._wheels.publish(state, stamp_ns)
        self._power.publish(state, stamp_ns)
        self._heading.publish(state, stamp_ns)
        self._solar.publish(state, stamp_ns)

    def reset(self) -> None:
        """The rover stands at its start again."""
        self._feet.restart()
        self._wheels.restart()
