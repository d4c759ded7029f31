"""Everything that physics publishes with one stamp."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.serialization import serialize_message

from lunar_rover_sim import frames, topics
from lunar_rover_sim.frames import Array
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import fixed_frames, imu_pose, moving_frames
from lunar_rover_sim.rover.visual import link_poses
from lunar_rover_sim.run.node_config import PhysicsNodeConfig
from lunar_rover_sim.sensors.imu import ImuNoise

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None


class StatePublisher:
    """Publishers of one state: IMU with its truth, contacts, odometry, joints, tf, clock."""

    def __init__(self, node: Node, rover: RoverDescription, imu: ImuNoise,
                 config: PhysicsNodeConfig) -> None:
        self._rover = rover
        self._config = config
        self._truth = config.truth
        # In the order of publishing. The clock is last: it means that the rest has been published.
        self._contacts = topics.of_legs([topics.CONTACT], rover.legs.names)
        self._others = (self._truth, topics.IMU_RAW, topics.IMU_TRUTH, topics.IMU_BIAS,
                        *self._contacts, *([topics.CLOCK] if config.publish_clock else []))
        self._imu = imu
        self._imu_variances = imu.white_noise_variances()
        self._imu_wxyz = frames.wxyz_from_matrix(imu_pose(rover)[:3, :3])
        # Message objects are refilled: making ten of them for every state would take longer than
        # filling them.
        self._messages: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}
        for topic in (topics.JOINT_STATES, *self._others):
            message_type = message_class(topic.type)
            self._messages[topic.name] = message_type()
            self._publishers[topic.name] = node.create_publisher(message_type, topic.graph_name,
                                                                 qos.offered(topic))
        conversions.set_odometry_covariance(self._messages[self._truth.name], config.odometry)
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
        """Publish one state with one stamp [ns].

        First the joint states, which the gait controller answers in lockstep: it works while the
        rest is filled and sent.
        """
        stamp = conversions.time_msg(stamp_ns)
        conversions.fill_joint_state(self._messages[topics.JOINT_STATES.name], self._rover.legs,
                                     state.joint_angle_rad, state.joint_velocity_radps,
                                     state.motor_torque_nm, stamp)
        self._send([topics.JOINT_STATES])
        links = link_poses(self._rover, state.joint_angle_rad)
        self._fill_others(state, links, stamp)
        if self._tf is not None:
            self._tf.publish(self._moving_transforms(state, links, stamp))
        self._send(self._others)

    def _send(self, published: Sequence[topics.Topic]) -> None:
        # In one go, after all are serialised: readers then wake up once, not once per message.
        serialised = [(topic.name, serialize_message(self._messages[topic.name]))
                      for topic in published]
        for name, data in serialised:
            self._publishers[name].publish(data)

    def _fill_others(self, state: RoverState, links: dict[str, Array], stamp: Time) -> None:
        messages = self._messages
        conversions.fill_odometry(messages[self._truth.name], state, stamp, self._truth.frame_id,
                                  self._config.base_frame)
        sample = self._imu.measure(state.specific_force_mps2, state.imu_rate_radps)
        conversions.fill_imu_raw(messages[topics.IMU_RAW.name], sample, *self._imu_variances,
                                 stamp)
        conversions.fill_imu_truth(messages[topics.IMU_TRUTH.name], state, self._imu_wxyz, stamp)
        conversions.fill_imu_bias(messages[topics.IMU_BIAS.name], sample, stamp)
        R_world_base = frames.matrix_from_wxyz(state.orientation_wxyz)
        for k, (leg, topic) in enumerate(zip(self._rover.legs.names, self._contacts)):
            R_world_leg = R_world_base @ links[leg][:3, :3]
            conversions.fill_wrench(messages[topic.name], state.contact_force_n[k] @ R_world_leg,
                                    state.contact_torque_nm[k] @ R_world_leg, topic.frame_id,
                                    stamp)
        if self._config.publish_clock:
            conversions.fill_clock(messages[topics.CLOCK.name], stamp)

    def _moving_transforms(self, state: RoverState, links: dict[str, Array], stamp: Time) -> Any:
        moved = moving_frames(self._rover, state.T_world_base, links, self._config.pose_frames)
        return TFMessage(transforms=[conversions.transform(*frame, stamp) for frame in moved])

    def _static_transforms(self) -> Any:
        zero = conversions.time_msg(0)
        return TFMessage(transforms=[conversions.transform(parent, child, pose, zero)
                                     for parent, child, pose in fixed_frames(self._rover)])
