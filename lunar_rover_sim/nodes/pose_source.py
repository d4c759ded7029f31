"""The pose by which mapping_node and navigator_node work: the truth, or an estimate."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
import functools
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu

from lunar_rover_sim.autonomy.navigation.config import SLAM, TRUTH
from lunar_rover_sim.autonomy.navigation.poses import AnchoredPoses, JUMP_M, LevelledWheels
from lunar_rover_sim.bag.messages import header_ns, xyz
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.base.files.state_file import attributes, restore_attributes
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.slam.protocol import STATES, TRACKING
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.nodes.node_main import GraphNode, TimeJump
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import imu_pose, optical_poses
from lunar_rover_sim.run.shared_config import NodeConfig

_KEPT_NS = 5_000_000_000    # poses older than this are forgotten
_TRACKING = STATES[TRACKING]


class PoseSource:
    """Subscriptions of one source of poses, and the poses of the last seconds.

    An estimate begins at the true start: a rover knows where it was set down. From then on only
    the estimate counts. Where a SLAM program begins another map, wheels and IMU place it. Poses of
    slam/pose in the frame `odom` are those in the site, of an estimator with a map from orbit:
    they are taken as they are, and wheels and IMU carry them on between frames.

    Attributes:
        frame_id: Frame of the poses.
        answered_ns: Stamp [ns] up to which the source has said a pose, or that it knows none.
    """

    def __init__(self, node: GraphNode, config: NodeConfig, pose: str, rover: RoverDescription,
                 on_answer: Callable[[], None], on_restart: Callable[[], None]) -> None:
        """Subscribe.

        Args:
            on_answer: Called when `answered_ns` has grown, or a pose can be carried further.
            on_restart: Called when simulated time has gone back.
        """
        self._node, self._kind = node, pose
        self._on_answer, self._on_restart = on_answer, on_restart
        self.frame_id = (config.truth.frame_id if pose == TRUTH else frames.ODOM_FRAME)
        self._jump = TimeJump(node)
        self._truth: deque[tuple[int, bytes]] = deque()
        self._poses: deque[tuple[int, Array]] = deque()
        self._wheels: deque[Odometry] = deque()
        self._rolled: deque[tuple[int, Array]] = deque()    # poses by wheels and IMU
        # T_map_camera of the SLAM program, and whether the map is the site.
        self._tracked: deque[tuple[int, Array, bool]] = deque()
        self._statuses: deque[tuple[int, bool]] = deque()   # and whether it tracks
        self._told_ns = self._imu_ns = 0                    # of the newest pose told, and sample
        self._R_base_imu = imu_pose(rover)[:3, :3]
        self._levelled = LevelledWheels()
        T_base_camera = optical_poses(rover)[0]
        self._anchored, self._T_camera_base = (AnchoredPoses(T_base_camera),
                                               frames.inverse(T_base_camera))
        self._is_in_site, self._jumped_ns = False, -1
        self.answered_ns = 0
        self._rolls = False         # whether wheels have begun at the true start

        # A long queue also in real time: states come while a map is made.
        listen = functools.partial(qos.subscription, node, lockstep=True)
        listen(config.truth, self._truth_callback, raw=True)
        self.waits: tuple[str, ...] = (config.truth.name,) if pose == TRUTH else ()
        if pose == SLAM:
            listen(topics.SLAM_POSE, self._slam_callback)
            listen(topics.SLAM_STATUS, self._status_callback)
            self.waits = (topics.SLAM_POSE.name, topics.SLAM_STATUS.name)
        if pose != TRUTH:
            listen(topics.WHEEL_ODOM, self._wheels_callback, light=True)
            listen(topics.IMU_RAW, self._imu_callback, light=True)
            self.waits += (topics.WHEEL_ODOM.name, topics.IMU_RAW.name)

    def at(self, stamp: int) -> Array | None:
        """Return T_world_base (4, 4) at a stamp [ns], or None."""
        if self._kind == TRUTH:
            return self._true(stamp)
        return next((T for ns, T in self._poses if ns == stamp), None)

    def newest(self, up_to_ns: int, carried_to_ns: int | None = None,
               ) -> tuple[int, Array] | None:
        """Return stamp [ns] and pose of the newest one up to a stamp; None without any.

        Args:
            carried_to_ns: To which wheels and IMU carry a pose in the site.
        """
        if self._kind == TRUTH:
            found = next(((ns, raw) for ns, raw in reversed(self._truth) if ns <= up_to_ns), None)
            return None if found is None else (found[0], _pose_of(found[1]))
        newest = next(((ns, T) for ns, T in reversed(self._poses) if ns <= up_to_ns), None)
        if newest is None or carried_to_ns is None or not self._is_in_site:
            return newest
        return self._carried(*newest, carried_to_ns)

    def is_carried_to(self, stamp: int) -> bool:
        """Return whether all has come by which a pose is carried to a stamp [ns]."""
        return not self._is_in_site or bool(self._rolled) and self._rolled[-1][0] >= stamp

    def has_jumped(self, stamp: int) -> bool:
        """Return whether the pose in the site at a stamp [ns] is not where the wheels came to."""
        return stamp == self._jumped_ns

    def tilt_deg(self, up_to_ns: int) -> float | None:
        """Return the tilt by the IMU, of the newest pose by wheels up to a stamp.

        None: it is that of the pose, since that is the truth, or there is none by wheels yet.
        """
        found = next((T for ns, T in reversed(self._rolled) if ns <= up_to_ns), None)
        return None if found is None else float(frames.tilt_deg(found[:3, :3]))

    def is_at_rest(self, time_ns: int) -> bool:
        """Return whether nothing that has come up to a time [ns] waits for something else."""
        if self._kind == TRUTH:
            return self.answered_ns >= time_ns
        return not (self._wheels or self._tracked or self._statuses)

    def state(self) -> dict[str, Any]:
        """Return all that it goes on from, at rest."""
        return attributes(self, '_truth', '_poses', '_rolled', '_told_ns', '_imu_ns', '_levelled',
                          '_anchored', '_is_in_site', '_jumped_ns', 'answered_ns', '_rolls')

    def resume(self, time_ns: int, state: Mapping[str, Any]) -> None:
        """Go on at a time [ns] from what `state` has returned."""
        restore_attributes(self, state)
        self._jump.resume(time_ns)

    def _truth_callback(self, raw: bytes) -> None:
        stamp = stamp_ns(topics.ODOM.type, raw)
        if stamp is None:
            return
        if self._jump.has_occurred(stamp):
            for queue in (self._truth, self._poses, self._wheels, self._rolled, self._tracked,
                          self._statuses):
                queue.clear()       # type: ignore[attr-defined]
            self._levelled.restart()
            self._anchored.restart()
            self.answered_ns = self._told_ns = self._imu_ns = 0
            self._rolls, self._jumped_ns = False, -1
            self._on_restart()
        if self._kind != TRUTH and self._begun:
            self._truth.clear()
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
        self._told_ns = header_ns(msg)
        p, q = msg.pose.position, msg.pose.orientation
        numbers = np.array([p.x, p.y, p.z, q.w, q.x, q.y, q.z])
        norm = frames.length(numbers[3:].tolist())
        if not np.isfinite(numbers).all() or not abs(norm - 1.0) < 1e-2:
            self._node.warnings.add('pose', f'{topics.SLAM_POSE.name}: {numbers.tolist()} is no '
                                    'pose, and not used')
        else:
            T = frames.se3(frames.matrix_from_wxyz(numbers[3:] / norm), numbers[:3])
            self._tracked.append((self._told_ns, T, msg.header.frame_id == frames.ODOM_FRAME))
        self._pair()

    def _status_callback(self, msg: DiagnosticArray) -> None:
        tracks = any(status.message == _TRACKING for status in msg.status)
        self._statuses.append((header_ns(msg), tracks))
        self._pair()

    @property
    def _begun(self) -> bool:
        """Whether the true start is not needed any more."""
        return self._rolls and (self._kind != SLAM or self._is_in_site
                                or self._anchored.is_anchored)

    def _pair(self) -> None:
        """Make poses of what has come of several topics."""
        self._roll()
        # The pose and the status of a frame come on two topics, in any order.
        while self._statuses:
            stamp, tracks = self._statuses[0]
            if not self._anchor(stamp) or tracks and self._told_ns < stamp:
                return
            self._statuses.popleft()
            if not tracks:
                self._anchored.lose()
            self._answered(stamp)

    def _anchor(self, up_to_ns: int) -> bool:
        """Make the poses of the SLAM program up to a stamp [ns]; return whether none waits."""
        while self._tracked and self._tracked[0][0] <= up_to_ns:
            stamp, T_map_camera, self._is_in_site = self._tracked[0]
            waits, start = self._start(stamp, self._is_in_site or self._anchored.is_anchored)
            if waits or not self._rolled or self._rolled[-1][0] < stamp:
                return False
            self._tracked.popleft()
            if self._is_in_site:
                self._take_in_site(stamp, T_map_camera @ self._T_camera_base)
                continue
            rolled = self._rolled_at(stamp)
            if rolled is None or start is None and not self._anchored.is_anchored:
                continue            # from before this node has joined
            self._poses.append((stamp, self._anchored.base(T_map_camera, rolled, start)))
            _forget(self._poses, stamp)
        return True

    def _take_in_site(self, stamp: int, T_site_base: Array) -> None:
        if self._poses:
            expected = self._carried(*self._poses[-1], stamp)
            if expected is None or float(np.linalg.norm(
                    T_site_base[:3, 3] - expected[1][:3, 3])) > JUMP_M:
                self._jumped_ns = stamp
        self._poses.append((stamp, T_site_base))
        _forget(self._poses, stamp)

    def _carried(self, stamp: int, T: Array, to_ns: int) -> tuple[int, Array] | None:
        """Return a pose carried on to a time [ns], and when it is from; None if it is too old."""
        before = self._rolled_at(stamp)
        now = next(((ns, rolled) for ns, rolled in reversed(self._rolled) if ns <= to_ns), None)
        if before is None or now is None:
            return None
        return now[0], np.asarray(T @ frames.inverse(before) @ now[1])

    def _rolled_at(self, stamp: int) -> Array | None:
        return next((T for ns, T in reversed(self._rolled) if ns <= stamp), None)

    def _roll(self) -> None:
        """Make the poses of wheels and IMU."""
        while self._wheels and self._imu_ns >= header_ns(self._wheels[0]):
            stamp = header_ns(self._wheels[0])
            waits, start = self._start(stamp, self._rolls)
            if waits:
                return
            told = self._wheels.popleft().pose.pose
            if start is None and not self._rolls:
                continue            # from before this node has joined
            self._rolls = True
            p, q = told.position, told.orientation
            pose = self._levelled.base((p.x, p.y, 2.0 * math.atan2(q.z, q.w)), start)
            self._rolled.append((stamp, pose))
            _forget(self._rolled, stamp)
            if self._kind != SLAM:
                self._poses.append((stamp, pose))
                _forget(self._poses, stamp)
                self._answered(stamp)
            elif self._is_in_site:
                self._on_answer()

    def _start(self, stamp: int, has_begun: bool) -> tuple[bool, Array | None]:
        """Return whether what has come must wait for the true start, and that pose.

        It is None where it is not needed any more, or older than the truth that is known.
        """
        if has_begun:
            return False, None
        start = self._true(stamp)
        is_past = bool(self._truth) and self._truth[-1][0] > stamp
        return start is None and not is_past, start

    def _true(self, stamp: int) -> Array | None:
        raw = next((raw for ns, raw in self._truth if ns == stamp), None)
        return None if raw is None else _pose_of(raw)

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
