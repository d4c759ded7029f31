"""What physics publishes: its states, the ground that it has changed, and sensors on request."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import functools
import math
import struct
from typing import Any

from geometry_msgs.msg import AccelStamped, WrenchStamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, Imu, JointState

from lunar_rover_sim.bag.ground_points import points_of
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.base.frames import Array, se3, wxyz_from_matrix
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.ground.regolith.overlay import GroundChanges, Overlay
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.nodes import conversions, image_conversions, qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.nodes.node_main import GraphNode
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import fixed_frames, imu_pose, MovingFrames
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
        self._imu = imu
        self._imu_wxyz = frames.wxyz_from_matrix(imu_pose(rover)[:3, :3])
        self._frames = MovingFrames(rover, config.pose_frames)
        self._transforms = RefilledTransforms(self._frames.pairs)
        self._truth = config.truth
        # In the order of publishing. The clock is last: it means that the rest has been published.
        self._contacts = topics.of_legs([topics.CONTACT], rover.legs.names)
        messages = {
            topics.JOINT_STATES: _joint_state(rover),
            self._truth: _odometry(config),
            topics.IMU_RAW: _imu_raw(imu),
            topics.IMU_TRUTH: _imu_truth(),
            topics.IMU_BIAS: Refilled.of(_headed(AccelStamped, frames.IMU_FRAME), 'accel'),
            **{topic: Refilled.of(_headed(WrenchStamped, topic.frame_id), 'wrench')
               for topic in self._contacts},
            **({topics.CLOCK: Refilled.of(Clock())} if config.publish_clock else {})}
        self._messages = {topic: (message, qos.publisher(node, topic))
                          for topic, message in messages.items()}
        self._tf = qos.publisher(node, topics.TF)
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
        return [*(publisher for _, publisher in self._messages.values()), self._tf]

    def publish(self, state: RoverState, stamp_ns: int) -> None:
        """Publish one state with one stamp [ns].

        First the joint states, which the gait controller answers in lockstep: it works while the
        rest is filled and sent.
        """
        message, publisher = self._messages[topics.JOINT_STATES]
        publisher.publish(message.filled(
            stamp_ns, state.joint_angle_rad.tolist(), state.joint_velocity_radps.tolist(),
            state.motor_torque_nm.tolist()))
        links = link_poses(self._rover, state.joint_angle_rad)
        T_base_leg = np.array([links[leg] for leg in self._rover.legs.names])
        T_world_base = state.T_world_base
        numbers = self._numbers(state, T_world_base[:3, :3], T_base_leg)
        # In one go, after all are filled: readers then wake up once, not once per message.
        filled = [(publisher, message.filled(stamp_ns, *numbers.get(topic, ())))
                  for topic, (message, publisher) in self._messages.items()
                  if topic != topics.JOINT_STATES]
        poses = self._frames.at(T_world_base, T_base_leg)
        self._tf.publish(self._transforms.filled(stamp_ns, poses))
        for publisher, data in filled:
            publisher.publish(data)

    def _numbers(self, state: RoverState, R_world_base: Array, T_base_leg: Array,
                 ) -> dict[topics.Topic, Sequence[Sequence[float]]]:
        """Return the runs of numbers of each message, but those of the joint states."""
        sample = self._imu.measure(state.specific_force_mps2, state.imu_rate_radps)
        wxyz = frames.product_wxyz(state.orientation_wxyz, self._imu_wxyz)
        numbers: dict[topics.Topic, Sequence[Sequence[float]]] = {
            self._truth: ((*state.position_m.tolist(), *xyzw(state.orientation_wxyz)),
                          (*state.linear_velocity_mps.tolist(),
                           *state.angular_velocity_radps.tolist())),
            topics.IMU_RAW: (sample.rate.tolist(), sample.specific_force.tolist()),
            topics.IMU_TRUTH: (xyzw(wxyz if wxyz[0] >= 0.0 else -wxyz),
                               state.imu_rate_radps.tolist(), state.specific_force_mps2.tolist()),
            topics.IMU_BIAS: ((*sample.accel_bias.tolist(), *sample.gyro_bias.tolist()),)}
        R_leg_base = T_base_leg[:, None, :3, :3].swapaxes(-1, -2)
        R_leg_world = frames.rotated(R_leg_base, R_world_base).swapaxes(-1, -2)
        loads = np.stack([state.contact_force_n, state.contact_torque_nm], axis=1)
        loads = frames.rotated(R_leg_world[:, None], loads).reshape(-1, 6)
        numbers.update(zip(self._contacts, ((load,) for load in loads.tolist())))
        return numbers


def _headed(kind: Any, frame_id: str) -> Any:
    message = kind()
    message.header.frame_id = frame_id
    return message


def _joint_state(rover: RoverDescription) -> Refilled:
    names = list(rover.legs.joint_names)
    zeros = np.zeros(len(names))
    return Refilled.of(JointState(name=names, position=zeros, velocity=zeros, effort=zeros),
                       'position', 'velocity', 'effort')


def _odometry(config: PhysicsNodeConfig) -> Refilled:
    """Return the true pose in the world and the true twist in base axes."""
    message = _headed(Odometry, config.truth.frame_id)
    message.child_frame_id = config.base_frame
    for covariance in (message.pose.covariance, message.twist.covariance):
        covariance[:] = conversions.EXACT_VARIANCE * np.eye(6).ravel()
    return Refilled.of(message, 'pose.pose', 'twist.twist')


def _imu_raw(imu: ImuNoise) -> Refilled:
    """Return the noisy signal, which has no orientation (REP-145)."""
    message = _headed(Imu, frames.IMU_FRAME)
    message.orientation_covariance[0] = -1.0
    for covariance, variance in zip((message.linear_acceleration_covariance,
                                     message.angular_velocity_covariance),
                                    imu.white_noise_variances()):
        covariance[:] = max(variance, conversions.EXACT_VARIANCE) * np.eye(3).ravel()
    return Refilled.of(message, 'angular_velocity', 'linear_acceleration')


def _imu_truth() -> Refilled:
    """Return the signal without noise, and the orientation of the IMU in `odom`, w >= 0."""
    message = _headed(Imu, frames.IMU_FRAME)
    for covariance in (message.orientation_covariance, message.linear_acceleration_covariance,
                       message.angular_velocity_covariance):
        covariance[:] = conversions.EXACT_VARIANCE * np.eye(3).ravel()
    return Refilled.of(message, 'orientation', 'angular_velocity', 'linear_acceleration')


def publish_frames(node: Node, fixed: Sequence[tuple[str, str, Array]]) -> None:
    """Publish fixed frames on tf_static.

    Args:
        node: Publishes them.
        fixed: (parent, child, (4, 4) T_parent_child).
    """
    if fixed:
        qos.publisher(node, topics.TF_STATIC).publish(tf_message(fixed, 0))


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
        self.changes = qos.publisher(node, topics.GROUND_CHANGES)
        self._snapshot = qos.publisher(node, topics.GROUND_SNAPSHOT,
                                       event_callbacks=PublisherEventCallbacks(
                                           matched=self._on_match))
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
            (sensor, [(topic, qos.publisher(node, topic))
                      for topic in sensor.offered if topic not in silent])
            for sensor in sensors]
        self._names = {sensor: {topic.name for topic in sensor.offered} for sensor in sensors}
        self._unread: set[Sensor] = set()
        self._refilled: dict[topics.Topic, Refilled] = {}
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
                    publisher.publish(self._message(topic, measured[topic.name], stamp_ns))

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

    def _message(self, topic: topics.Topic, measured: Any, stamp_ns: int) -> Any:
        if not isinstance(measured, WheelOdometry):
            return _message(topic, measured, stamp_ns)
        # The only one that comes with every state.
        if topic not in self._refilled:
            self._refilled[topic] = _wheel_odometry(topic)
        return self._refilled[topic].filled(stamp_ns,
                                            *conversions.wheel_odometry_numbers(measured))


def _wheel_odometry(topic: topics.Topic) -> Refilled:
    message = _headed(Odometry, topic.frame_id)
    message.child_frame_id = frames.BASE_FRAME
    return Refilled.of(message, 'pose.pose', 'pose.covariance', 'twist.twist', 'twist.covariance')


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
    Supply: _fill_supply}


_STAMP, _NUMBER = struct.Struct('<iI'), struct.Struct('<d')
# What no message holds otherwise: so its place is found.
_MARKED_NS = 1_734_829_105_456_789_123
_MARKS = -7.1e15    # the first of several, each greater by one


class Refilled:
    """A message in CDR: its stamps change, and runs of numbers (float64) that follow each other.

    They are written where they stand: to fill the fields and to serialise takes many times as
    long.

    Args:
        data: Holds, besides all that stays, `_MARKED_NS` for each stamp, and the next mark as the
            first number of each run.
        lengths: Numbers of each run.
    """

    def __init__(self, data: bytes, lengths: Sequence[int]) -> None:
        self._data = bytearray(data)
        stamp = _STAMP.pack(*divmod(_MARKED_NS, NS_PER_S))
        self._stamps = [at for at in range(len(data)) if data.startswith(stamp, at)]
        self._runs = [(struct.Struct(f'<{length}d').pack_into,
                       data.index(_NUMBER.pack(_MARKS + k))) for k, length in enumerate(lengths)]

    @classmethod
    def of(cls, message: Any, *runs: str) -> Refilled:
        """Return a message of ROS, refilled.

        Args:
            message: With all that stays; it is written to. Its stamp is `header.stamp`, or `clock`
                where it has no header.
            runs: Names of what changes, in the order of the message: messages of numbers, as
                'pose.pose', and arrays of numbers, of the length that they have.
        """
        stamp = message.header.stamp if hasattr(message, 'header') else message.clock
        stamp.sec, stamp.nanosec = divmod(_MARKED_NS, NS_PER_S)
        lengths = [_mark(message, run, _MARKS + k) for k, run in enumerate(runs)]
        return cls(serialize_message(message), lengths)

    def filled(self, stamp_ns: int, *runs: Iterable[float]) -> bytes:
        """Return the message with a stamp [ns] and the numbers of each run."""
        data, stamp = self._data, divmod(stamp_ns, NS_PER_S)
        for at in self._stamps:
            _STAMP.pack_into(data, at, *stamp)
        for (pack, at), numbers in zip(self._runs, runs, strict=True):
            pack(data, at, *numbers)
        return bytes(data)


class RefilledTransforms:
    """A TFMessage of frames that stay the same."""

    def __init__(self, pairs: Sequence[tuple[str, str]]) -> None:
        """Take (parent, child) of each transform."""
        marked = [(*pair, se3(np.eye(3), (_MARKS + k, 0.0, 0.0))) for k, pair in enumerate(pairs)]
        self._message = Refilled(tf_message(marked, _MARKED_NS), [7] * len(marked))

    def filled(self, stamp_ns: int, poses: Iterable[Array]) -> bytes:
        """Return the message with a stamp [ns] and (4, 4) T_parent_child of each."""
        return self._message.filled(stamp_ns, *(
            (*T[:3, 3].tolist(), *xyzw(wxyz_from_matrix(T[:3, :3]))) for T in poses))


def xyzw(quat_wxyz: Array) -> tuple[float, float, float, float]:
    """Return the numbers of a quaternion in the order of geometry_msgs."""
    w, x, y, z = quat_wxyz.tolist()
    return x, y, z, w


def _mark(message: Any, name: str, mark: float) -> int:
    """Write a mark as the first number of what is named; return how many numbers it has."""
    *parents, field = name.split('.')
    owner = functools.reduce(getattr, parents, message)
    value = getattr(owner, field)
    if isinstance(value, float):
        setattr(owner, field, mark)
        return 1
    if hasattr(value, 'get_fields_and_field_types'):
        parts = list(value.get_fields_and_field_types())
        return sum(_mark(value, part, mark if part == parts[0] else 0.0) for part in parts)
    value[0] = mark
    return len(value)
