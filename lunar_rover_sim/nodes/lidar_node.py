"""lidar_node: poses of the rover to scans of a LiDAR or time-of-flight camera."""

from __future__ import annotations

import array
import collections
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from numpy.typing import NDArray
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import Header

from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.base.files.state_file import attributes, restore_attributes
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.lidar.lidar import Lidar
from lunar_rover_sim.image.lidar.motion import ScanMotion
from lunar_rover_sim.image.lidar.optics import LidarOptics
from lunar_rover_sim.image.lidar.scan import PlanarScan
from lunar_rover_sim.nodes import conversions, node_main, qos
from lunar_rover_sim.nodes.diagnostics import Diagnostics, Drops, Rate, SubjectStatus
from lunar_rover_sim.nodes.ground_listener import (GroundListener, load_own_world,
                                                   refuse_other_worlds, WindowListener)
from lunar_rover_sim.nodes.image_conversions import cloud
from lunar_rover_sim.nodes.node_main import TimeJump
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.nodes.reader_discovery import ReaderDiscovery
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.run.checkpoint import Checkpoint
from lunar_rover_sim.run.node_config import LidarNodeConfig


def planar_scan(scan: PlanarScan, optics: LidarOptics, period_ns: int, frame_id: str,
                stamp: Time) -> LaserScan:
    """Return one ring."""
    count = len(scan.range_m)
    return LaserScan(
        header=Header(stamp=stamp, frame_id=frame_id), angle_min=scan.angle_min_rad,
        angle_max=scan.angle_min_rad + scan.angle_step_rad * (count - 1),
        angle_increment=scan.angle_step_rad, time_increment=scan.time_step_s,
        scan_time=1e-9 * period_ns, range_min=optics.min_range_m, range_max=optics.max_range_m,
        ranges=_floats(scan.range_m), intensities=_floats(scan.intensity))


def _floats(values: NDArray[np.float32]) -> Any:
    # The one type that rclpy takes over without looking at each element.
    return array.array('f', values.tobytes())


_CLOUDS = (topics.LIDAR_POINTS, topics.LIDAR_DESKEWED)


class LidarNode(node_main.GraphNode):
    """Makes one scan of each period, of the poses that it consists of.

    A scan begins with its period, which is its stamp, and is made when the state at its end has
    come. While nobody reads any of its topics the node does not even listen to the rover. In
    lockstep every scan is made, and `lidar/scanned` lets time go on; in real time the newest one
    is, and those that are left out are counted.
    """

    def __init__(self) -> None:
        super().__init__('lidar_node')
        self._config = config = declare(self, LidarNodeConfig)
        world = load_own_world(config.world)
        rover = load_rover(config.rover or None)
        self._legs = rover.legs
        self._lidar = Lidar(world, rover, config, config.seed)
        self._windows = WindowListener(self, world, config.lockstep)
        self._ring = self._lidar.pattern.ring_at(config.horizontal_beam)
        # Twenty states a scan: rosbags reads one in a fifth of the time that rclpy takes.
        self._types: Any = get_typestore(Stores.ROS2_JAZZY)
        # States from the start of the next scan on, and that scan; None before the first state.
        self._states: collections.deque[tuple[int, bytes]] = collections.deque()
        # Whether time waits for scans from its start on.
        self._is_awaited = (config.lockstep
                            and topics.LIDAR_SCANNED.name in config.participants)
        self._next: int | None = 1 if self._is_awaited else None
        self._angles: dict[int, Array] = {}     # stamp → leg angles, where a beam may meet a leg
        self._jump = TimeJump(self)
        self._ground = GroundListener(self, self.wake)
        self._follows = False
        self._rate, self._drops, self._is_fed = Rate(0.0), Drops(), False
        events = PublisherEventCallbacks(matched=lambda _: self.wake())
        self._outputs: dict[str, Publisher] = {
            topic.name: qos.publisher(self, topic, event_callbacks=events)
            for topic in topics.OF_LIDAR}
        self._scanned = qos.publisher(self, topics.LIDAR_SCANNED, event_callbacks=events)
        self._readers = ReaderDiscovery(self, [*self._outputs.values(), self._scanned],
                                        config.participants if config.lockstep else ())
        refuse_other_worlds(self, config.world, world, config.lockstep)
        self._of_rover: list[Subscription] = []
        self._listen_while_read()
        Diagnostics(self, {'Scan rate': self._scan_rate_status, 'Drops': self._drops.status})
        self.report_ready(config, f'{config.part}, {len(self._lidar.pattern)} beams a scan, '
                          f'world {world.hash[:12]}', (config.truth.name,))

    # Input

    def _odom_callback(self, raw: bytes) -> None:
        stamp = stamp_ns(topics.ODOM.type, raw)
        if stamp is None:
            return
        period_ns = self._config.period_ns
        if self._jump.has_occurred(stamp):
            self._states.clear()
            self._angles.clear()
            self._next = 1 if self._is_awaited else None
        if self._next is None:
            self._next = -(-stamp // period_ns)
        self._is_fed = True
        self._states.append((stamp, raw))
        # Of what came before the scan only the last state matters.
        while len(self._states) > 1 and self._states[1][0] <= self._next * period_ns:
            self._states.popleft()
        if stamp >= (self._next + 1) * period_ns:
            self.wake()

    def _joints_callback(self, msg: JointState) -> None:
        stamp = time_ns(msg.header.stamp)
        try:
            angles = conversions.legs_of(msg, self._legs, 'position')
        except GraphError as error:
            self.warnings.add('state', f'joint_states: {error}')
            return
        for old in [ns for ns in self._angles if self._states and ns < self._states[0][0]]:
            del self._angles[old]
        self._angles[stamp] = angles
        if self._next is not None and stamp >= (self._next + 1) * self._config.period_ns:
            self.wake()

    # Checkpoints

    def is_at_rest(self, begun: Checkpoint) -> bool:
        """See `GraphNode`."""
        return not self._is_due() and (
            not self._of_rover or bool(self._states) and self._states[-1][0] >= begun.time_ns)

    def state(self) -> dict[str, Any]:
        """See `GraphNode`; the ground comes with the first snapshot."""
        return {'middle_m': self._windows.middle_m,
                **attributes(self, '_states', '_angles', '_next')}

    def resume(self, time_ns: int, state: Any) -> None:
        """See `GraphNode`."""
        middle_m = state.pop('middle_m')
        if middle_m != self._windows.middle_m:
            self._lidar.enter(self._windows.go_to(middle_m))
        restore_attributes(self, state)
        self._jump.resume(time_ns)

    # Output

    def close(self) -> None:
        """End the thread that makes windows."""
        self._windows.close()

    def work(self) -> None:
        """Make the scans that are due; leave out those whose start has not been seen."""
        self._listen_while_read()
        while self._is_due():
            assert self._next is not None
            period_ns, lockstep = self._config.period_ns, self._config.lockstep
            # Where time does not wait for it, the node may have missed the first states.
            first = -(-self._states[0][0] // period_ns)
            newest = self._states[-1][0] // period_ns - 1
            possible = first if lockstep else max(first, newest)
            if possible > self._next:
                self._drops.add('Scans', possible - self._next)
                self._next = possible
                continue
            start = self._next * period_ns
            read = self._read_topics()
            if read:
                self._publish(start, read)
                self._rate.tick()
            self._scanned.publish(Header(stamp=conversions.time_msg(start + period_ns),
                                         frame_id=topics.LIDAR_POINTS.frame_id))
            self._next += 1
            while len(self._states) > 1 and self._states[1][0] <= self._next * period_ns:
                self._states.popleft()

    def _listen_while_read(self) -> None:
        """Subscribe to the states of the rover where they are needed, else end the subscriptions.

        Receiving 200 states a second costs more than a third of what it costs to make scans.
        """
        needed = (self._is_awaited or bool(self._read_topics())
                  or bool(self._scanned.get_subscription_count()))
        if needed and not self._of_rover:
            # A long queue also in real time: states may come while a scan is made.
            self._of_rover.append(qos.subscription(self, self._config.truth, self._odom_callback,
                                                   lockstep=True, raw=True))
            if self._lidar.legs_met:
                self._of_rover.append(qos.subscription(self, topics.JOINT_STATES,
                                                       self._joints_callback, lockstep=True))
        elif self._of_rover and not needed:
            for subscription in self._of_rover:
                self.destroy_subscription(subscription)
            self._of_rover.clear()
            self._states.clear()
            self._angles.clear()
            self._next = None

    def _read_topics(self) -> set[str]:
        return {name for name, publisher in self._outputs.items()
                if publisher.get_subscription_count()}

    def _is_due(self) -> bool:
        """Return whether all that the next scan needs has come."""
        if self.ending or self._next is None or not self._states:
            return False
        start = self._next * self._config.period_ns
        if self._states[-1][0] < start + self._config.period_ns:
            return False
        if not self._config.lockstep:
            return True
        if self._lidar.legs_met and max(self._angles, default=0) < start + self._config.period_ns:
            return False
        if self._config.await_ground and not self._ground.knows(start):
            return False
        return self._readers.is_complete and all(
            self._outputs[name].get_subscription_count()
            for name in self._config.await_readers)

    def _publish(self, start: int, read: set[str]) -> None:
        """Make the scan that begins at a stamp [ns], and publish the topics that are read."""
        config, stamp = self._config, conversions.time_msg(start)
        world = self._windows.at(start)
        if world is not None:
            self._lidar.enter(world)
        if self._ground.is_known and not self._follows:
            self._lidar.follow(self._ground.overlay)
            self._follows = True
        self._ground.advance(start)
        end = start + config.period_ns
        scan = self._lidar.scan(self._motion(start, end), start // config.period_ns)
        for topic in _CLOUDS:
            if topic.name in read:
                points = scan.cloud(config.organized, topic is topics.LIDAR_DESKEWED)
                self._outputs[topic.name].publish(cloud(
                    points, topic.frame_id, stamp, is_dense=not config.organized))
        if topics.LIDAR_SCAN.name in read:
            self._outputs[topics.LIDAR_SCAN.name].publish(planar_scan(
                scan.planar(self._ring), config.optics, config.period_ns,
                topics.LIDAR_SCAN.frame_id, stamp))

    def _motion(self, start: int, end: int) -> ScanMotion:
        """Return the poses of the states up to the first one at or after a stamp."""
        times, poses = [], []
        for stamp, raw in self._states:
            times.append(1e-9 * (stamp - start))
            poses.append(conversions.pose_of(self._types.deserialize_cdr(raw, topics.ODOM.type)))
            if stamp >= end:
                break
        if not self._angles:
            return ScanMotion(times, poses)
        known = sorted(self._angles)
        return ScanMotion(times, poses, np.stack([
            np.interp(times, [1e-9 * (stamp - start) for stamp in known], leg)
            for leg in np.array([self._angles[stamp] for stamp in known]).T], axis=-1))

    def _scan_rate_status(self) -> SubjectStatus:
        fed, self._is_fed = self._is_fed, False
        if not self._read_topics():
            return self._rate.status('Nobody reads scans')
        return self._rate.status('' if fed else 'No new odometry')
