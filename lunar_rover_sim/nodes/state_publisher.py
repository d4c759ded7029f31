"""Everything that physics publishes with one stamp."""

from __future__ import annotations

from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from lunar_rover_sim import frames, topics
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.nodes.types import message_class
from lunar_rover_sim.physics.imu import ImuNoise
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
        self._R_base_imu = imu_pose(rover)[:3, :3]
        self._accel_variance, self._gyro_variance = imu.white_noise_variances()
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
        stamp = conversions.time_msg(stamp_ns)
        sample = self._imu.measure(state.specific_force_mps2, state.imu_rate_radps)
        send = self._send
        send(topics.IMU_RAW, conversions.imu_raw(sample, self._accel_variance,
                                                 self._gyro_variance, stamp))
        send(topics.IMU_TRUTH, conversions.imu_truth(state, self._R_base_imu, stamp))
        send(topics.IMU_BIAS, conversions.imu_bias(sample, stamp))
        for topic, force, torque in zip(topics.CONTACTS, state.contact_force_n,
                                        state.contact_torque_nm):
            send(topic, conversions.wrench(force, torque, stamp))
        send(topics.ODOM, conversions.odometry(state, stamp))
        send(topics.JOINT_STATES, conversions.joint_state(
            stamp, state.joint_angle_rad, state.joint_velocity_radps, state.motor_torque_nm))
        if self._tf is not None:
            self._tf.publish(self._moving_transforms(state, stamp))
        self._clock.publish(Clock(clock=stamp))

    def _send(self, topic: topics.Topic, msg: object) -> None:
        self._publishers[topic.name].publish(msg)

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
