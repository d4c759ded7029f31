"""Everything that physics publishes with one stamp."""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.serialization import serialize_message

from lunar_rover_sim import frames, topics
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.physics.imu import ImuNoise
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.rover.description import LEG_NAMES, RoverDescription
from lunar_rover_sim.rover.mounts import imu_pose, optical_poses
from lunar_rover_sim.rover.visual import link_poses
from lunar_rover_sim.run.node_config import OdometryConfig

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

# In the order of publishing. The clock is last: it means that the rest has been published.
_TOPICS = (topics.IMU_RAW, topics.IMU_TRUTH, topics.IMU_BIAS, *topics.CONTACTS, topics.ODOM,
           topics.JOINT_STATES, topics.CLOCK)


class StatePublisher:
    """Publishers of one state: IMU with its truth, contacts, odometry, joints, tf, clock."""

    def __init__(self, node: Node, rover: RoverDescription, imu: ImuNoise,
                 odometry: OdometryConfig) -> None:
        self._rover = rover
        self._imu = imu
        self._imu_variances = imu.white_noise_variances()
        self._imu_wxyz = frames.wxyz_from_matrix(imu_pose(rover)[:3, :3])
        # Message objects are refilled: making ten of them for every state would take longer than
        # filling them.
        self._messages: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}
        for topic in _TOPICS:
            message_type = message_class(topic.type)
            self._messages[topic.name] = message_type()
            self._publishers[topic.name] = node.create_publisher(message_type, topic.name,
                                                                 qos.offered(topic))
        conversions.set_odometry_covariance(self._messages[topics.ODOM.name], odometry)
        self._tf = None
        if TFMessage is None:
            node.get_logger().info('tf2_msgs is not installed: no tf is published')
        else:
            self._tf = node.create_publisher(TFMessage, topics.TF.name, qos.offered(topics.TF))
            self._tf_static = node.create_publisher(TFMessage, topics.TF_STATIC.name,
                                                    qos.offered(topics.TF_STATIC))
            self._tf_static.publish(self._static_transforms())

    def restart(self, imu: ImuNoise) -> None:
        """Begin again with the noise of a new start."""
        self._imu = imu

    @property
    def publishers(self) -> list[Any]:
        """Those of the messages that every state has."""
        moving = [] if self._tf is None else [self._tf]
        return [*self._publishers.values(), *moving]

    def publish(self, state: RoverState, stamp_ns: int) -> None:
        """Publish one state with one stamp [ns]."""
        stamp = conversions.time_msg(stamp_ns)
        self._fill(state, stamp)
        if self._tf is not None:
            self._tf.publish(self._moving_transforms(state, stamp))
        # Sent in one go, after all are serialised: readers then wake up once per state, not once
        # per message.
        serialised = [(name, serialize_message(message))
                      for name, message in self._messages.items()]
        for name, data in serialised:
            self._publishers[name].publish(data)

    def _fill(self, state: RoverState, stamp: Time) -> None:
        messages = self._messages
        sample = self._imu.measure(state.specific_force_mps2, state.imu_rate_radps)
        conversions.fill_imu_raw(messages[topics.IMU_RAW.name], sample, *self._imu_variances,
                                 stamp)
        conversions.fill_imu_truth(messages[topics.IMU_TRUTH.name], state, self._imu_wxyz, stamp)
        conversions.fill_imu_bias(messages[topics.IMU_BIAS.name], sample, stamp)
        for leg, topic in enumerate(topics.CONTACTS):
            conversions.fill_wrench(messages[topic.name], state.contact_force_n[leg],
                                    state.contact_torque_nm[leg], stamp)
        conversions.fill_odometry(messages[topics.ODOM.name], state, stamp)
        conversions.fill_joint_state(messages[topics.JOINT_STATES.name], state.joint_angle_rad,
                                     state.joint_velocity_radps, state.motor_torque_nm, stamp)
        conversions.fill_clock(messages[topics.CLOCK.name], stamp)

    def _moving_transforms(self, state: RoverState, stamp: Time) -> Any:
        links = link_poses(self._rover, state.joint_angle_rad)
        return TFMessage(transforms=[
            conversions.transform(frames.ODOM_FRAME, frames.BASE_FRAME, state.T_world_base,
                                  stamp),
            *(conversions.transform(frames.BASE_FRAME, leg, links[leg], stamp)
              for leg in LEG_NAMES)])

    def _static_transforms(self) -> Any:
        zero = conversions.time_msg(0)
        left, right = optical_poses(self._rover)
        return TFMessage(transforms=[
            conversions.transform(frames.BASE_FRAME, child, pose, zero)
            for child, pose in ((frames.IMU_FRAME, imu_pose(self._rover)),
                                (frames.LEFT_OPTICAL_FRAME, left),
                                (frames.RIGHT_OPTICAL_FRAME, right))])
