"""Sun sensor and star tracker: topics on request."""

from __future__ import annotations

from geometry_msgs.msg import Vector3Stamped
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from lunar_rover_sim import topics
from lunar_rover_sim.frames import Array, BASE_FRAME, wxyz_from_matrix
from lunar_rover_sim.illumination.star_tracker import StarTracker
from lunar_rover_sim.illumination.sun_sensor import SunSensor
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.nodes.sun_from_rover import SunFromRover
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.run.node_config import PhysicsNodeConfig
from lunar_rover_sim.seconds import NS_PER_S

_EXACT_RAD2 = 1e-14     # added, since zeros would say that the covariance is unknown


class HeadingPublisher:
    """Publishes what sun sensor and star tracker measure, while somebody reads it.

    publishers: of the sun sensor and of the star tracker
    """

    def __init__(self, node: Node, sun: SunFromRover, config: PhysicsNodeConfig) -> None:
        self._config, self._sun = config, sun
        self._sensor = SunSensor(config.sun_sensor, np.random.default_rng([config.seed, 3]))
        self._tracker = StarTracker(config.star_tracker, np.random.default_rng([config.seed, 4]))
        self._direction = node.create_publisher(Vector3Stamped, topics.SUN_SENSOR.name,
                                                qos.offered(topics.SUN_SENSOR))
        self._attitude = node.create_publisher(Imu, topics.STAR_TRACKER.name,
                                               qos.offered(topics.STAR_TRACKER))
        self.publishers = [self._direction, self._attitude]

    def publish(self, state: RoverState, stamp_ns: int) -> None:
        """Publish what is due at a state and read, and what can be seen there."""
        config = self._config
        if (self._direction.get_subscription_count()
                and stamp_ns % (NS_PER_S // config.sun_sensor.rate_hz) == 0):
            self._publish_direction(state, stamp_ns)
        if (self._attitude.get_subscription_count()
                and stamp_ns % (NS_PER_S // config.star_tracker.rate_hz) == 0):
            self._publish_attitude(state, stamp_ns)

    def _publish_direction(self, state: RoverState, stamp_ns: int) -> None:
        sun = self._sun.seen(state, self._config.sun_sensor.position_m, stamp_ns)
        measured = self._sensor.measure(sun, state.T_world_base[:3, :3])
        if measured is not None:
            message = Vector3Stamped()
            _set_header(message.header, stamp_ns)
            message.vector.x, message.vector.y, message.vector.z = measured.tolist()
            self._direction.publish(message)

    def _publish_attitude(self, state: RoverState, stamp_ns: int) -> None:
        rotation = state.T_world_base[:3, :3]
        measured = self._tracker.measure(
            rotation, state.angular_velocity_radps,
            self._sun.seen(state, self._config.star_tracker.position_m, stamp_ns),
            self._sun.earth(stamp_ns))
        if measured is not None:
            self._attitude.publish(_attitude(
                measured, self._tracker.covariance_rad2(rotation), stamp_ns))


def _attitude(rotation: Array, covariance_rad2: Array, stamp_ns: int) -> Imu:
    """Return an orientation alone: what it does not have is -1 (sensor_msgs/Imu)."""
    message = Imu()
    _set_header(message.header, stamp_ns)
    q = message.orientation
    q.w, q.x, q.y, q.z = wxyz_from_matrix(rotation).tolist()
    message.orientation_covariance = (covariance_rad2 + _EXACT_RAD2 * np.eye(3)).ravel()
    message.angular_velocity_covariance[0] = message.linear_acceleration_covariance[0] = -1.0
    return message


def _set_header(header: Header, stamp_ns: int) -> None:
    header.stamp = conversions.time_msg(stamp_ns)
    header.frame_id = BASE_FRAME
