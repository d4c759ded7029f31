"""navigator_node: maps, poses and goals to velocities."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import OccupancyGrid, Path
import numpy as np
from std_msgs.msg import Header

from lunar_rover_sim.autonomy.navigation.command import NavigatorCommand, Status
from lunar_rover_sim.autonomy.navigation.config import SLAM, TraversabilityConfig
from lunar_rover_sim.autonomy.navigation.from_orbit import CostsFromOrbit
from lunar_rover_sim.autonomy.navigation.navigator import Navigator
from lunar_rover_sim.autonomy.navigation.planner import Plan
from lunar_rover_sim.autonomy.navigation.poses import JUMP_M
from lunar_rover_sim.autonomy.navigation.traversability import Limits, Traversability
from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import NavigationError
from lunar_rover_sim.base.files.state_file import attributes, restore_attributes
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.moon_place import reported_site
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.image.illumination.sun_of_date import sun_of_date
from lunar_rover_sim.nodes import conversions, map_conversions, node_main, qos
from lunar_rover_sim.nodes.nav2_action import NavigateToPoseServer, Progress
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.nodes.pose_source import PoseSource
from lunar_rover_sim.nodes.reader_discovery import ReaderDiscovery
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.run.checkpoint import Checkpoint
from lunar_rover_sim.run.node_config import NavigatorNodeConfig
from lunar_rover_sim.run.node_state import NodeState, ON_THE_WAY, tell

_KEPT_MAPS = 50
_KEPT = ('_last_period', '_maps', '_status', '_plan', '_goals', '_far_points', '_place',
         '_driven_m', '_told_s', '_is_done')
_WAY_STEP_M = 0.1       # a walking body sways: shorter moves are no way


def _sun_deg(config: NavigatorNodeConfig, world: World | None) -> tuple[float, float] | None:
    """Return azimuth and elevation of the sun; None where it does not shine."""
    sun = sun_of_date(config.sun, None if world is None else reported_site(world.report))
    return ((sun.azimuth_deg, sun.elevation_deg) if sun.shines and sun.elevation_deg > 0.0
            else None)


class NavigatorNode(node_main.GraphNode):
    """Answers the true odometry of every command period with a velocity that bears its stamp.

    In lockstep it answers from the map and, with slam, the pose of `map_lag_s` before, whatever
    has arrived meanwhile: the same run gives the same commands.
    """

    def __init__(self) -> None:
        super().__init__('navigator_node')
        self._config = config = declare(self, NavigatorNodeConfig)
        rover = load_rover(config.rover or None)
        world = load_world(config.world, verify=False) if config.world else None
        half_extent_m = None if world is None else Site.of(world).half_extent_m
        self._costs = None
        if config.world or config.maps:
            self._costs = CostsFromOrbit(config.world, config.maps, config.far,
                                         _sun_deg(config, world))
        radius_m = config.radius_m or Limits.of(rover, TraversabilityConfig()).radius_m
        self._navigator = Navigator(config, radius_m, half_extent_m, self._costs)
        if self._costs is not None and any(math.dist(a, b) > config.far.from_m for a, b in zip(
                ((0.0, 0.0), *config.goals), config.goals)):
            # Now, since time may wait for it later.
            costs = self._costs([(0.0, 0.0), *config.goals])
            for goal in config.goals:
                costs.checked(goal)
        self._period_ns = NS_PER_S // config.rate_hz
        self._map_ns = round(config.map_period_s * 1e9)
        self._lag_ns = round(config.map_lag_s * 1e9)
        self._first_period = 0 if config.lockstep else -1
        self._maps: deque[tuple[int, Traversability]] = deque(maxlen=_KEPT_MAPS)
        self._due: deque[int] = deque()
        self._status: Status | None = None
        self._plan: Plan | None = None
        self._goals: tuple[Array, ...] = ()
        self._far_points: Array | None = None
        self._restart()
        self._poses = PoseSource(self, config, config.pose, rover, self.wake, self._restart)
        qos.subscription(self, config.truth, self._odom_callback, config.lockstep, raw=True)
        qos.subscription(self, topics.TRAVERSABILITY, self._map_callback, config.lockstep)
        self.create_subscription(PoseStamped, topics.GOAL_POSE.name,
                                 lambda msg: self._take_goals([msg]), qos.reliable(1))
        self.create_subscription(Path, topics.WAYPOINTS.name, self._waypoints_callback,
                                 qos.reliable(1))
        stamped = config.enable_stamped_cmd_vel
        self._publisher = self.create_publisher(TwistStamped if stamped else Twist,
                                                topics.CMD_VEL.name, qos.offered(topics.CMD_VEL))
        self._outputs = {topic: qos.publisher(self, topic) for topic in (
            topics.PLAN, topics.GLOBAL_PLAN, topics.GOAL, topics.NAVIGATOR_STATUS,
            topics.NAVIGATED)}
        self._action = NavigateToPoseServer.make(self, self._set_goals)
        self._matching = ReaderDiscovery(self, [self._publisher, *self._outputs.values()],
                                         config.participants if config.lockstep else ())
        self.report_ready(config, waits=tuple(dict.fromkeys(
            (config.truth.name, topics.TRAVERSABILITY.name, *self._poses.waits))))

    def _restart(self) -> None:
        self._last_period = self._first_period
        self._maps.clear()
        self._due.clear()
        self._navigator.reset()
        self._status, self._plan, self._goals = None, None, ()
        self._place: Array | None = None
        self._driven_m, self._told_s = 0.0, -1
        self._is_done = False

    # Checkpoints

    def is_at_rest(self, begun: Checkpoint) -> bool:
        """See `GraphNode`."""
        return (not self._due and self._poses.is_at_rest(begun.time_ns)
                and self._last_period >= begun.time_ns // self._period_ns)

    def state(self) -> dict[str, Any]:
        """See `GraphNode`."""
        return {'navigator': self._navigator.state(), 'poses': self._poses.state(),
                **attributes(self, *_KEPT)}

    def resume(self, time_ns: int, state: Any) -> None:
        """See `GraphNode`."""
        self._navigator.resume(state.pop('navigator'))
        self._poses.resume(time_ns, state.pop('poses'))
        restore_attributes(self, state)

    # Input

    def _odom_callback(self, raw: bytes) -> None:
        now_ns = stamp_ns(topics.ODOM.type, raw)
        if now_ns is None or now_ns // self._period_ns == self._last_period \
                or now_ns // self._period_ns == self._first_period:
            return
        self._last_period = now_ns // self._period_ns
        if not self._config.lockstep:
            self._due.clear()
        self._due.append(now_ns)
        self.wake()

    def _map_callback(self, msg: OccupancyGrid) -> None:
        try:
            self._maps.append((header_ns(msg), map_conversions.traversability_of(msg)))
        except NavigationError as error:
            self.warnings.add('map', f'{error}; it is not used')
            return
        self.wake()

    def _waypoints_callback(self, msg: Path) -> None:
        for pose in msg.poses:
            pose.header.frame_id = pose.header.frame_id or msg.header.frame_id
        self._take_goals(msg.poses)

    def _take_goals(self, poses: Sequence[PoseStamped]) -> None:
        if self._set_goals(poses, False) is None and self._action is not None:
            self._action.replace()

    def _set_goals(self, poses: Sequence[PoseStamped], turns: bool) -> str | None:
        """Drive to these poses; return None or, with a warning, why they are refused.

        Args:
            turns: Whether it turns to the heading of the last one.
        """
        try:
            goals = [self._in_odom(pose) for pose in poses]
            self._navigator.set_goals([point for point, _ in goals],
                                      goals[-1][1] if turns and goals else None)
        except NavigationError as error:
            self.get_logger().warning(f'refused: {error}')
            return str(error)
        self._is_done = False
        return None

    def _in_odom(self, goal: PoseStamped) -> tuple[Array, float]:
        """Return a goal (2,) and its heading [rad] in the frame of the poses.

        Raises:
            NavigationError: If its frame has no transform here.
        """
        point = np.array([goal.pose.position.x, goal.pose.position.y])
        q = goal.pose.orientation
        heading = math.atan2(2.0 * (q.w * q.z + q.x * q.y),
                             q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z)
        frame = goal.header.frame_id.lstrip('/')
        if frame in ('', self._poses.frame_id, frames.ODOM_FRAME):
            return point, heading
        if frame in (frames.BASE_FRAME, frames.FOOTPRINT_FRAME, frames.TRUE_BASE_FRAME):
            found = self._poses.newest(1 << 62)
            if found is None:
                raise NavigationError(f'goal: no pose is known yet to bring it from {frame} to '
                                      f'{self._poses.frame_id}')
            T = found[1]
            return (np.asarray(T[:2, :2] @ point + T[:2, 3], float),
                    heading + math.atan2(T[1, 0], T[0, 0]))
        raise NavigationError(f'goal: frame {frame!r} has no transform here; valid are '
                              f'{self._poses.frame_id}, {frames.BASE_FRAME}')

    # Output

    def work(self) -> None:
        """Answer the odometry for which map and pose have come, if the readers are matched."""
        while self._due and self._matching.is_complete and self._is_ready(self._due[0]):
            self._answer(self._due.popleft())

    def _is_ready(self, now_ns: int) -> bool:
        if not self._config.lockstep:
            return True
        if (self._poses.answered_ns < self._pose_due(now_ns)
                or not self._poses.is_carried_to(now_ns)):
            return False
        # Maps come at multiples of their period, from the first one on.
        due = (now_ns - self._lag_ns) // self._map_ns * self._map_ns
        return due <= 0 or bool(self._maps) and self._maps[-1][0] >= due

    def _pose_due(self, now_ns: int) -> int:
        """Return the stamp [ns] up to which the source of the pose must have answered."""
        if self._config.pose != SLAM:
            return now_ns
        due = now_ns - self._lag_ns
        return max(due // self._map_ns * self._map_ns, 0)

    def _answer(self, now_ns: int) -> None:
        lockstep = self._config.lockstep
        known = self._pose_due(now_ns) if lockstep else now_ns
        pose = self._poses.newest(known, now_ns)
        up_to = now_ns - self._lag_ns if lockstep else now_ns
        grid = next((grid for stamp, grid in reversed(self._maps) if stamp <= up_to), None)
        if grid is not None and grid.stamp_ns <= 1:
            grid = None
        T = np.full((4, 4), np.nan) if pose is None else pose[1]
        turn = (frames.wxyz_from_matrix(T[:3, :3]) if np.isfinite(T).all()
                else np.full(4, np.nan))
        tilt = self._poses.tilt_deg(known if pose is None else max(known, pose[0]))
        command = self._navigator.update(now_ns, None if pose is None else pose[0], T[:3, 3],
                                         turn, grid, tilt)
        stamp = conversions.time_msg(now_ns)
        velocity = command.forward_mps, command.yaw_rate_radps
        if self._config.enable_stamped_cmd_vel:
            self._publisher.publish(conversions.twist_stamped(*velocity, stamp))
        else:
            self._publisher.publish(conversions.twist(*velocity))
        self._tell(command, stamp, now_ns, T)

    def _tell(self, command: NavigatorCommand, stamp: Any, now_ns: int, T: Array) -> None:
        for note in self._navigator.notes:
            self.get_logger().info(f'{now_ns / 1e9:.2f} s: {note}')
        self._navigator.notes.clear()
        frame_id, plan, goals = self._poses.frame_id, self._navigator.plan, self._navigator.goals_m
        if plan is not self._plan:
            self._plan = plan
            points = np.zeros((0, 2)) if plan is None else plan.points_m
            self._outputs[topics.PLAN].publish(map_conversions.path(points, frame_id, stamp))
        far = self._navigator.far
        if far is not None and far.points_m is not self._far_points:
            self._far_points = far.points_m
            self._outputs[topics.GLOBAL_PLAN].publish(
                map_conversions.path(far.points_m, frame_id, stamp))
        if goals and (not self._goals or goals[0] is not self._goals[0]):
            self._outputs[topics.GOAL].publish(map_conversions.goal(goals[0], frame_id, stamp))
        self._goals = goals
        if command.status != self._status:
            self._status = command.status
            self._outputs[topics.NAVIGATOR_STATUS].publish(_status(command, stamp))
            if command.failure is not None:
                self.get_logger().warning(f'gave up at {now_ns / 1e9:.2f} s: {command.reason}')
        self._tell_way(T, now_ns)
        if self._action is not None:
            left_m, heading_rad = self._navigator.left_m(T[:3, 3]), math.atan2(T[1, 0], T[0, 0])
            self._action.tell(Progress(
                command, now_ns, map_conversions.goal(T[:2, 3], frame_id, stamp, heading_rad),
                left_m, left_m / self._config.speed_mps, self._navigator.backed_off))
        if command.status.is_end and not self._is_done:
            self._is_done = True
            if (end_ns := self._config.end_ns(now_ns)) > 0:
                self._outputs[topics.NAVIGATED].publish(
                    Header(stamp=conversions.time_msg(end_ns)))

    def _tell_way(self, T: Array, now_ns: int) -> None:
        """Tell the supervisor of a run now and then how far it has driven, and how far it is."""
        if not np.isfinite(T).all():
            return
        place = T[:2, 3]
        moved_m = math.inf if self._place is None else float(np.linalg.norm(place - self._place))
        if moved_m > _WAY_STEP_M:
            # A pose that has jumped has not been driven to.
            self._driven_m += moved_m if moved_m < JUMP_M else 0.0
            self._place = place
        if now_ns // NS_PER_S != self._told_s:
            self._told_s = now_ns // NS_PER_S
            tell(NodeState(ON_THE_WAY, driven_m=self._driven_m,
                           left_m=self._navigator.left_m(T[:3, 3])))


def _status(command: NavigatorCommand, stamp: Any) -> DiagnosticArray:
    level = DiagnosticStatus.OK if command.failure is None else DiagnosticStatus.WARN
    array = DiagnosticArray(status=[DiagnosticStatus(
        level=level, name='navigator', message=command.status.value,
        values=[KeyValue(key='reason', value=command.reason)])])
    array.header.stamp = stamp
    return array
