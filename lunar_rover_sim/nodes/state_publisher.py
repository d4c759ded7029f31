"""Everything that physics publishes with one stamp."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from rclpy.node import Node
from rclpy.serialization import serialize_message

from lunar_rover_sim import frames, topics
from lunar_rover_sim.frames import Array, se3
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import fixed_frames, imu_pose
from lunar_rover_sim.rover.visual import link_poses
from lunar_rover_sim.run.node_config import PhysicsNodeConfig
from lunar_rover_sim.sensors.imu import ImuNoise


def footprint_pose(rover: RoverDescription, R_world_base: Array,
                   T_base_link: dict[str, Array]) -> Array:
    """Return T_base_footprint (4, 4): no roll, no pitch, the yaw of base_link.

    R_world_base: (3, 3) orientation of base_link
    T_base_link: leg → (4, 4), as `visual.link_poses` returns them

    The origin lies vertically below (above) that of base_link, at the height of the lowest point
    of the spheres at the tips of the spokes.
    """
    legs = rover.legs
    tips = (legs.spoke_length_m - legs.tip_radius_m) * np.array(legs.spoke_directions())
    down = np.concatenate([tips @ T_base_link[leg][:3, :3].T + T_base_link[leg][:3, 3]
                           for leg in legs.names]) @ R_world_base[2]
    height_m = float(down.min()) - legs.tip_radius_m
    forward = R_world_base[:2, 0] / np.linalg.norm(R_world_base[:2, 0])
    level = np.array([[forward[0], -forward[1], 0.0], [forward[1], forward[0], 0.0],
                      [0.0, 0.0, 1.0]])
    return se3(R_world_base.T @ level, R_world_base.T @ [0.0, 0.0, height_m])


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
        self._base_frame = frames.TRUE_BASE_FRAME if config.separate_truth else frames.BASE_FRAME
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
                                  self._base_frame)
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
        base, footprint, T_world_base = frames.BASE_FRAME, frames.FOOTPRINT_FRAME, \
            state.T_world_base
        transforms = [conversions.transform(base, frames.leg_frame(leg), links[leg], stamp)
                      for leg in self._rover.legs.names]
        if self._config.publish_tf:
            transforms.append(conversions.transform(self._truth.frame_id, self._base_frame,
                                                    T_world_base, stamp))
            if not self._config.separate_truth:
                transforms.append(conversions.transform(base, footprint, footprint_pose(
                    self._rover, T_world_base[:3, :3], links), stamp))
        return TFMessage(transforms=transforms)

    def _static_transforms(self) -> Any:
        zero = conversions.time_msg(0)
        return TFMessage(transforms=[conversions.transform(parent, child, pose, zero)
                                     for parent, child, pose in fixed_frames(self._rover)])
