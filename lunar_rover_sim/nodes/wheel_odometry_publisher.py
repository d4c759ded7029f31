"""The wheel odometry: a topic on request."""

from __future__ import annotations

from nav_msgs.msg import Odometry
from rclpy.node import Node

from lunar_rover_sim import topics
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.physics.wheel_odometry import Rolling, WheelOdometry
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.run.node_config import PhysicsNodeConfig


class WheelOdometryPublisher:
    """Publishes what the encoders say of the way, while somebody reads it.

    publisher: that of the topic
    """

    def __init__(self, node: Node, config: PhysicsNodeConfig, rover: RoverDescription) -> None:
        self._config, self._rover = config.wheel_odometry, rover
        self._rolling = Rolling.of(config.wheel_odometry, config.ground.name)
        self._interval_s = 1e-9 * config.state_period_ns
        self.publisher = node.create_publisher(Odometry, topics.WHEEL_ODOM.name,
                                               qos.offered(topics.WHEEL_ODOM))
        self._odometry: WheelOdometry | None = None

    def restart(self) -> None:
        """Begin at 0 again, with the next state."""
        self._odometry = None

    def publish(self, state: RoverState, stamp_ns: int) -> None:
        """Publish the pose at a state, if somebody reads it; it is 0 where reading began."""
        if not self.publisher.get_subscription_count():
            self.restart()
            return
        if self._odometry is None:
            self._odometry = WheelOdometry(self._rover, self._config.counts_per_turn,
                                           self._rolling)
        self._odometry.add(state.joint_angle_rad, self._interval_s)
        self.publisher.publish(conversions.wheel_odometry(self._odometry,
                                                          conversions.time_msg(stamp_ns)))
