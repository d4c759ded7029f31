"""What physics publishes: its states, the ground that it has changed, and sensors on request."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import functools
import math
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from sensor_msgs.msg import BatteryState, PointCloud2

from lunar_rover_sim.bag.ground_points import points_of
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.base.frames import Array, wxyz_from_matrix
from lunar_rover_sim.ground.regolith.overlay import GroundChanges, Overlay
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.nodes import conversions, image_conversions, qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.nodes.node_main import GraphNode
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import fixed_frames, imu_pose, moving_frames
from lunar_rover_sim.rover.physics.state import RoverState
from lunar_rover_sim.rover.visual import link_poses
from lunar_rover_sim.run.node_config import PhysicsNodeConfig
from lunar_rover_sim.run.transforms import tf_message
from lunar_rover_sim.sensors.imu import ImuNoise
from lunar_rover_sim.sensors.sensor import Attitude, JointValues, Sensor, Supply, Vector
from lunar_rover_sim.sensors.wheel_odometry import WheelOdometry


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
        conversions.set_odometry_covariance(self._messages[self._truth.name])
        self._tf = _tf_publisher(node, topics.TF)
        publish_frames(node, fixed_frames(rover))

    def restart(self, imu: ImuNoise) -> None:
        """Begin again with the noise of a new start."""
        self._imu = imu

    def state(self) -> dict[str, Any]:
        """Return what the noise goes on from."""
        return self._imu.state()

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` has returned."""
        self._imu.resume(state)

    @property
    def publishers(self) -> list[Any]:
        """Those of the messages that every state has."""
        return [*self._publishers.values(), self._tf]

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
        self._tf.publish(tf_message(moving_frames(
            self._rover, state.T_world_base, links, self._config.pose_frames), stamp_ns))
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
            R_leg_world = frames.rotated(links[leg][:3, :3].T, R_world_base).T
            force, torque = (frames.rotated(R_leg_world, vectors[k]) for vectors in (
                state.contact_force_n, state.contact_torque_nm))
            conversions.fill_wrench(messages[topic.name], force, torque, topic.frame_id, stamp)
        if self._config.publish_clock:
            messages[topics.CLOCK.name].clock = stamp


def publish_frames(node: Node, fixed: Sequence[tuple[str, str, Array]]) -> None:
    """Publish fixed frames on tf_static.

    Args:
        node: Publishes them.
        fixed: (parent, child, (4, 4) T_parent_child).
    """
    if fixed:
        _tf_publisher(node, topics.TF_STATIC).publish(tf_message(fixed, 0))


def _tf_publisher(node: Node, topic: topics.Topic) -> Publisher:
    return node.create_publisher(message_class(topic.type), topic.name, qos.offered(topic))


class GroundPublisher:
    """Publishes changes whenever a period [ns] is over, and a snapshot for each new reader.

    A reader that joins late takes the snapshot, and over it the changes with later stamps. Values
    are absolute, so it then has the ground exactly.
    """

    def __init__(self, node: GraphNode, overlay: Overlay,
                 ground: Callable[[], HeightGrid], period_ns: int, frame_id: str) -> None:
        """Publish the first snapshot: the ground at the start.

        Args:
            ground: Returns the untouched one around the rover.
            frame_id: Of the clouds.
        """
        self._overlay, self._ground, self._period_ns = overlay, ground, period_ns
        self._now_ns, self._frame_id = 0, frame_id
        self.changes: Publisher = node.create_publisher(
            PointCloud2, topics.GROUND_CHANGES.name, qos.offered(topics.GROUND_CHANGES))
        events = PublisherEventCallbacks(matched=self._on_match)
        self._snapshot: Publisher = node.create_publisher(
            PointCloud2, topics.GROUND_SNAPSHOT.name, qos.offered(topics.GROUND_SNAPSHOT),
            event_callbacks=events)
        self._send(self._snapshot, overlay.snapshot())

    def publish(self, now_ns: int) -> None:
        """Publish what has changed, if a period ends at this time [ns]."""
        self._now_ns = now_ns
        if now_ns % self._period_ns == 0:
            self._send(self.changes, self._overlay.take_changes())

    def restart(self, now_ns: int = 0) -> None:
        """Begin again at a time [ns], with the ground as it is now."""
        self._now_ns = now_ns
        self._send(self._snapshot, self._overlay.snapshot())

    def _on_match(self, event: object) -> None:
        if getattr(event, 'current_count_change') > 0:
            self._send(self._snapshot, self._overlay.snapshot())

    def _send(self, publisher: Publisher, changes: GroundChanges) -> None:
        publisher.publish(image_conversions.cloud(
            points_of(changes, self._ground()), self._frame_id,
            conversions.time_msg(self._now_ns)))


_UNKNOWN = 'temperature', 'charge', 'capacity', 'design_capacity', 'percentage'
_EXACT_RAD2 = 1e-14     # added, since zeros would say that the covariance is unknown


class RequestedSensors:
    """Publishes each sensor while it is read.

    Attributes:
        publishers: Those of all topics.
    """

    def __init__(self, node: Node, sensors: Sequence[Sensor],
                 silent: Sequence[topics.Topic] = ()) -> None:
        """Offer the topics.

        Args:
            sensors: In the order in which they are published.
            silent: Topics that are not offered in this run.
        """
        self._sensors: list[tuple[Sensor, list[tuple[topics.Topic, Publisher]]]] = [
            (sensor, [(topic, node.create_publisher(message_class(topic.type), topic.name,
                                                    qos.offered(topic)))
                      for topic in sensor.offered if topic not in silent])
            for sensor in sensors]
        self._names = {sensor: {topic.name for topic in sensor.offered} for sensor in sensors}
        self._unread: set[Sensor] = set()
        self.publishers = [publisher for _, offered in self._sensors for _, publisher in offered]

    def publish(self, state: RoverState, stamp_ns: int) -> None:
        """Publish what is due at a state and read; a sensor that nobody reads begins anew."""
        for sensor, offered in self._sensors:
            read = [each for each in offered if each[1].get_subscription_count()]
            if not read:
                if sensor not in self._unread:
                    sensor.restart()
                    self._unread.add(sensor)
                continue
            self._unread.discard(sensor)
            if not sensor.is_due(stamp_ns):
                continue
            measured = sensor.measure(state, stamp_ns)
            if not measured.keys() <= self._names[sensor]:
                raise GraphError(f'sensor {sensor.name}: measures {", ".join(measured)}; it '
                                 f'publishes {", ".join(sorted(self._names[sensor]))}')
            for topic, publisher in read:
                if topic.name in measured:
                    publisher.publish(_message(topic, measured[topic.name], stamp_ns))

    def state(self) -> dict[str, Any]:
        """Return what the sensors go on from, by their names."""
        return {sensor.name: sensor.state() for sensor, _ in self._sensors}

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` has returned."""
        for sensor, _ in self._sensors:
            sensor.resume(state[sensor.name])

    def restart(self) -> None:
        """The rover stands at its start again."""
        for sensor, _ in self._sensors:
            sensor.restart()


def _message(topic: topics.Topic, measured: Any, stamp_ns: int) -> Any:
    message = message_class(topic.type)()
    message.header.stamp = conversions.time_msg(stamp_ns)
    message.header.frame_id = topic.frame_id
    if isinstance(measured, Mapping):
        for name, value in measured.items():
            *parents, field = name.split('.')
            setattr(functools.reduce(getattr, parents, message), field, value)
    else:
        _FILLERS[type(measured)](message, measured)
    return message


def _fill_vector(message: Any, measured: Vector) -> None:
    message.vector.x, message.vector.y, message.vector.z = map(float, measured.xyz)


def _fill_attitude(message: Any, measured: Attitude) -> None:
    """Fill an Imu with an orientation alone: what it does not have is -1 (sensor_msgs/Imu)."""
    q = message.orientation
    q.w, q.x, q.y, q.z = wxyz_from_matrix(measured.R_world_base).tolist()
    message.orientation_covariance = (measured.covariance_rad2 + _EXACT_RAD2 * np.eye(3)).ravel()
    message.angular_velocity_covariance[0] = message.linear_acceleration_covariance[0] = -1.0


def _fill_joints(message: Any, measured: JointValues) -> None:
    message.name = list(measured.names)
    message.position, message.velocity = list(measured.position), list(measured.velocity)


def _fill_supply(message: BatteryState, measured: Supply) -> None:
    message.location, message.present = measured.line, True
    message.voltage, message.current = measured.voltage_v, measured.current_a
    for name in _UNKNOWN:
        setattr(message, name, math.nan)
    if not measured.gives:
        message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    elif measured.current_a > 0.0:
        message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_CHARGING


_FILLERS: dict[type, Callable[[Any, Any], None]] = {
    Vector: _fill_vector, Attitude: _fill_attitude, JointValues: _fill_joints,
    Supply: _fill_supply, WheelOdometry: conversions.fill_wheel_odometry}
