"""Everything that physics publishes with one stamp."""

from __future__ import annotations

from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

from lunar_rover_sim import frames, topics
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.nodes.template import MessageTemplate
from lunar_rover_sim.physics.imu import ImuNoise, ImuSample
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.rover.description import LEG_NAMES, RoverDescription
from lunar_rover_sim.rover.mounts import imu_pose, optical_poses
from lunar_rover_sim.rover.visual import link_poses

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None


class StatePublisher:
    """Publishers of one state: clock, odometry, joints, IMU with its truth, contacts, tf."""

    def __init__(self, node: Node, rover: RoverDescription, imu: ImuNoise) -> None:
        self._rover = rover
        self._imu = imu
        self._turn = _times(frames.wxyz_from_matrix(imu_pose(rover)[:3, :3]))
        self._make_templates(imu)
        state_topics = (topics.ODOM, topics.JOINT_STATES, topics.IMU_RAW, topics.IMU_TRUTH,
                        topics.IMU_BIAS, *topics.CONTACTS)
        self._publishers = {topic.name: node.create_publisher(message_class(topic.type),
                                                              topic.name, qos.offered(topic))
                            for topic in state_topics}
        # Last, so that whoever takes the clock as the sign of a new state finds the rest there.
        self._clock = node.create_publisher(Clock, topics.CLOCK.name, qos.offered(topics.CLOCK))
        self._tf = None
        if TFMessage is None:
            node.get_logger().info('tf2_msgs is not installed: no tf is published')
        else:
            self._tf = node.create_publisher(TFMessage, topics.TF.name, qos.offered(topics.TF))
            self._tf_static = node.create_publisher(TFMessage, topics.TF_STATIC.name,
                                                    qos.offered(topics.TF_STATIC))
            self._tf_static.publish(self._static_transforms())

    def publish(self, state: RoverState, stamp_ns: int) -> None:
        """Publish one state with one stamp."""
        sample = self._imu.measure(state.specific_force_mps2, state.imu_rate_radps)
        w, x, y, z = state.orientation_wxyz.tolist()
        turned = self._turn @ (x, y, z, w)

        imu = self._imu_raw.numbers
        imu[13:16], imu[25:28] = sample.rate, sample.specific_force
        self._send(topics.IMU_RAW, self._imu_raw, stamp_ns)
        imu = self._imu_truth.numbers
        imu[:4] = turned if turned[3] >= 0.0 else -turned
        imu[13:16], imu[25:28] = state.imu_rate_radps, state.specific_force_mps2
        self._send(topics.IMU_TRUTH, self._imu_truth, stamp_ns)
        bias = self._imu_bias.numbers
        bias[:3], bias[3:] = sample.accel_bias, sample.gyro_bias
        self._send(topics.IMU_BIAS, self._imu_bias, stamp_ns)
        wrench = self._wrench.numbers
        for topic, force, torque in zip(topics.CONTACTS, state.contact_force_n,
                                        state.contact_torque_nm):
            wrench[:3], wrench[3:] = force, torque
            self._send(topic, self._wrench, stamp_ns)
        odom = self._odom.numbers
        odom[:3], odom[3:7] = state.position_m, (x, y, z, w)
        odom[43:46], odom[46:49] = state.linear_velocity_mps, state.angular_velocity_radps
        self._send(topics.ODOM, self._odom, stamp_ns)
        joints = self._joints.numbers
        joints[:4], joints[5:9] = state.joint_angle_rad, state.joint_velocity_radps
        joints[10:] = state.motor_torque_nm
        self._send(topics.JOINT_STATES, self._joints, stamp_ns)
        if self._tf is not None:
            self._tf.publish(self._moving_transforms(state, conversions.time_msg(stamp_ns)))
        self._clock.publish(self._clock_message.stamped(stamp_ns))

    def _send(self, topic: topics.Topic, template: MessageTemplate, stamp_ns: int) -> None:
        self._publishers[topic.name].publish(template.stamped(stamp_ns))

    def _make_templates(self, imu: ImuNoise) -> None:
        """Make one message of each kind; `publish` fills in its numbers, by their places."""
        start, three, four = conversions.time_msg(0), np.zeros(3), np.zeros(4)
        at_rest = RoverState(0, three, np.array([1.0, 0.0, 0.0, 0.0]), three, three, four, four,
                             four, four, np.zeros((4, 3)), np.zeros((4, 3)), three, three)
        sample = ImuSample(three, three, three, three)
        self._imu_raw = _template(
            conversions.imu_raw(sample, *imu.white_noise_variances(), start), 37)
        self._imu_truth = _template(conversions.imu_truth(at_rest, np.eye(3), start), 37)
        self._imu_bias = _template(conversions.imu_bias(sample, start), 6)
        self._wrench = _template(conversions.wrench(three, three, start), 6)
        self._odom = _template(conversions.odometry(at_rest, start), 85)
        self._joints = _template(conversions.joint_state(start, four, four, four), 14)
        self._clock_message = _template(Clock(), 0)

    def _moving_transforms(self, state: RoverState, stamp: object) -> object:
        T_odom_base = frames.se3(frames.matrix_from_wxyz(state.orientation_wxyz),
                                 state.position_m)
        links = link_poses(self._rover, state.joint_angle_rad)
        return TFMessage(transforms=[
            conversions.transform(frames.ODOM_FRAME, frames.BASE_FRAME, T_odom_base, stamp),
            *(conversions.transform(frames.BASE_FRAME, leg, links[leg], stamp)
              for leg in LEG_NAMES)])

    def _static_transforms(self) -> object:
        zero = conversions.time_msg(0)
        left, right = optical_poses(self._rover)
        return TFMessage(transforms=[
            conversions.transform(frames.BASE_FRAME, child, pose, zero)
            for child, pose in ((frames.IMU_FRAME, imu_pose(self._rover)),
                                (frames.LEFT_OPTICAL_FRAME, left),
                                (frames.RIGHT_OPTICAL_FRAME, right))])


def _template(message: Any, numbers: int) -> MessageTemplate:
    """Return a message to fill in whose last fields are the numbers."""
    return MessageTemplate(serialize_message(message), numbers)


def _times(q: frames.Array) -> frames.Array:
    """Return the (4, 4) matrix by which p, as xyzw, becomes the product p q; q: wxyz."""
    w, x, y, z = q
    return np.array([[w, z, -y, x], [-z, w, x, y], [y, -x, w, z], [-x, -y, -z, w]])
