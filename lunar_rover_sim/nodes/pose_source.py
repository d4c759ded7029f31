"""The pose by which mapping_node and navigator_node work: the truth, or an estimate."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu

from lunar_rover_sim import frames, topics
from lunar_rover_sim.bag.messages import header_ns, xyz
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.errors import GraphError
from lunar_rover_sim.frames import Array
from lunar_rover_sim.navigation.config import SLAM, TRUTH
from lunar_rover_sim.navigation.poses import AnchoredPoses, LevelledWheels
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.nodes.node_main import GraphNode
from lunar_rover_sim.nodes.time_jump import TimeJump
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import imu_pose, optical_poses
from lunar_rover_sim.run.shared_config import NodeConfig

_KEPT_NS = 5_000_000_000    # poses older than this are forgotten


class PoseSource:
    """Subscriptions of one source of poses, and the poses of the last seconds.

    An estimate begins at the true start: a rover knows where it was set down. From then on only
    the estimate counts.

    Attributes:
        frame_id: Frame of the poses.
        answered_ns: Stamp [ns] up to which the source has said a pose, or that it knows none.
    """

    def __init__(self, node: GraphNode, config: NodeConfig, pose: str, rover: RoverDescription,
                 on_answer: Callable[[], None], on_restart: Callable[[], None]) -> None:
        """Subscribe.

        Args:
            on_answer: Called when `answered_ns` has grown.
            on_restart: Called when simulated time has gone back.
        """
        self._node, self._kind = node, pose
        self._on_answer, self._on_restart = on_answer, on_restart
        self.frame_id = (config.truth.frame_id if pose == TRUTH else frames.ODOM_FRAME)
        self._jump = TimeJump(node)
        self._truth: deque[tuple[int, bytes]] = deque()
        self._poses: deque[tuple[int, Array]] = deque()
        self._wheels: deque[Odometry] = deque()
        self._statuses: deque[int] = deque()
        self._imu_ns = 0
        self._R_base_imu = imu_pose(rover)[:3, :3]
        self._levelled = LevelledWheels()
        self._anchored = AnchoredPoses(optical_poses(rover)[0])
        self.answered_ns = 0
        self._begun = False         # whether the true start is not needed any more

        def listen(kind: Any, topic: topics.Topic, callback: Callable[..., None],
                   raw: bool = False) -> None:
            # A long queue also in real time: states come while a map is made.
            node.create_subscription(kind, topic.name, callback,
                                     qos.requested(topic, lockstep=True), raw=raw)

        listen(Odometry, config.truth, self._truth_callback, raw=True)
        self.waits: tuple[str, ...] = (config.truth.name,)
        if pose == SLAM:
            listen(PoseStamped, topics.SLAM_POSE, self._slam_callback)
            listen(DiagnosticArray, topics.SLAM_STATUS, self._status_callback)
            self.waits = (topics.SLAM_POSE.name, topics.SLAM_STATUS.name)
        elif pose != TRUTH:
            listen(Odometry, topics.WHEEL_ODOM, self._wheels_callback)
            listen(Imu, topics.IMU_RAW, self._imu_callback)
            self.waits = (topics.WHEEL_ODOM.name, topics.IMU_RAW.name)

    def at(self, stamp: int) -> Array | None:
        """Return T_world_base (4, 4) at a stamp [ns], or None."""
        if self._kind == TRUTH:
            raw = next((raw for ns, raw in self._truth if ns == stamp), None)
            return None if raw is None else _pose_of(raw)
        return next((T for ns, T in self._poses if ns == stamp), None)

    def newest(self, up_to_ns: int) -> tuple[int, Array] | None:
        """Return stamp [ns] and pose of the newest one up to a stamp; None without any."""
        if self._kind == TRUTH:
            found = next(((ns, raw) for ns, raw in reversed(self._truth) if ns <= up_to_ns), None)
            return None if found is None else (found[0], _pose_of(found[1]))
        return next(((ns, T) for ns, T in reversed(self._poses) if ns <= up_to_ns), None)

    def _truth_callback(self, raw: bytes) -> None:
        stamp = stamp_ns(topics.ODOM.type, raw)
        if stamp is None:
            return
        if self._jump.has_occurred(stamp):
            for queue in (self._truth, self._poses, self._wheels, self._statuses):
                queue.clear()       # type: ignore[attr-defined]
            self._levelled.restart()
            self._anchored.restart()
            self.answered_ns, self._imu_ns, self._begun = 0, 0, False
            self._on_restart()
        if self._kind != TRUTH and self._begun:
            return
        self._truth.append((stamp, raw))
        _forget(self._truth, stamp)
        if self._kind == TRUTH:
            self._answered(stamp)
        else:
            self._pair()

    def _imu_callback(self, msg: Imu) -> None:
        self._imu_ns = header_ns(msg)
        self._levelled.add_imu(self._imu_ns, self._R_base_imu @ xyz(msg.angular_velocity),
                               self._R_base_imu @ xyz(msg.linear_acceleration))
        self._pair()

    def _wheels_callback(self, msg: Odometry) -> None:
        self._wheels.append(msg)
        self._pair()

    def _slam_callback(self, msg: PoseStamped) -> None:
        p, q = msg.pose.position, msg.pose.orientation
        numbers = np.array([p.x, p.y, p.z, q.w, q.x, q.y, q.z])
        norm = float(np.linalg.norm(numbers[3:]))
        if not np.isfinite(numbers).all() or not abs(norm - 1.0) < 1e-2:
            self._node.warnings.add('pose', f'{topics.SLAM_POSE.name}: {numbers.tolist()} is no '
                                    'pose, and not used')
            return
        T = frames.se3(frames.matrix_from_wxyz(numbers[3:] / norm), numbers[:3])
        stamp = header_ns(msg)
        if not self._anchored.is_anchored:
            start = next((raw for ns, raw in self._truth if ns == stamp), None)
            if start is None:
                return
            self._poses.append((stamp, self._anchored.base(T, _pose_of(start))))
            self._begun = True
            self._truth.clear()
        else:
            self._poses.append((stamp, self._anchored.base(T)))
        _forget(self._poses, stamp)
        self._pair()

    def _status_callback(self, msg: DiagnosticArray) -> None:
        self._statuses.append(header_ns(msg))
        tracked = any(status.message == 'tracking' for status in msg.status)
        if not tracked:
            self._answered(header_ns(msg))
        self._pair()

    def _pair(self) -> None:
        """Make poses of what has come of both topics of an estimate."""
        if self._kind == SLAM:
            # The pose and the status of a frame come on two topics, in any order.
            while self._statuses and (self.answered_ns >= self._statuses[0] or (
                    self._poses and self._poses[-1][0] >= self._statuses[0])):
                self._answered(self._statuses.popleft())
            return
        while self._wheels and self._imu_ns >= header_ns(self._wheels[0]):
            stamp = header_ns(self._wheels[0])
            start = None
            if not self._begun:
                raw = next((raw for ns, raw in self._truth if ns == stamp), None)
                if raw is None:
                    return
                start, self._begun = _pose_of(raw), True
                self._truth.clear()
            p, q = self._wheels[0].pose.pose.position, self._wheels[0].pose.pose.orientation
            self._wheels.popleft()
            pose = self._levelled.base((p.x, p.y, 2.0 * math.atan2(q.z, q.w)), start)
            self._poses.append((stamp, pose))
            _forget(self._poses, stamp)
            self._answered(stamp)

    def _answered(self, stamp: int) -> None:
        if stamp > self.answered_ns:
            self.answered_ns = stamp
            self._on_answer()


def _forget(queue: deque[Any], now_ns: int) -> None:
    while queue and now_ns - queue[0][0] > _KEPT_NS:
        queue.popleft()


def _pose_of(raw: bytes) -> Array:
    try:
        return conversions.pose_of(deserialize_message(raw, Odometry))
    except GraphError:
        # The navigator stops for it, and says so.
        return np.full((4, 4), np.nan)
