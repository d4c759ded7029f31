"""The navigator: plans over the newest map, follows, looks, backs off, and gives up with a reason.

It reads no clock and no random number: the same calls give the same commands.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
import dataclasses
import enum
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.autonomy.navigation.config import NavigatorConfig
from lunar_rover_sim.autonomy.navigation.global_plan import GlobalPlan, GroundCosts
from lunar_rover_sim.autonomy.navigation.overview import Overview
from lunar_rover_sim.autonomy.navigation.planner import Disc, Ground, Plan, Planner
from lunar_rover_sim.autonomy.navigation.poses import JUMP_M
from lunar_rover_sim.autonomy.navigation.rearing import Rearing
from lunar_rover_sim.autonomy.navigation.traversability import LETHAL, Traversability
from lunar_rover_sim.autonomy.path_following.config import DriveConfig
from lunar_rover_sim.autonomy.path_following.driver import PurePursuit, Steering
from lunar_rover_sim.autonomy.path_following.route import Route
from lunar_rover_sim.base.errors import brief, NavigationError
from lunar_rover_sim.base.files.state_file import attributes_but, restore_attributes
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, path_length, tilt_deg
from lunar_rover_sim.base.seconds import NS_PER_S

_GIVEN = '_config', '_radius_m', '_half_extent_m', '_costs', '_pursuit_config'
_BACK_MPS = -0.08
_TURN_IN_PLACE_DEG = 60.0   # error of heading above which the rover turns in place
_WAYPOINT_M = 0.4           # a waypoint before the last is reached at this distance
_PLAN_NS = NS_PER_S         # from plan to plan; at once where the way is blocked
_LOOK_AHEAD_M, _LOOK_UNKNOWN_M = 1.1, 0.15  # so far a plan is known, but for this, or it looks
_TIPPED_DEG = 65.0          # tilt at which it gives up
_STUCK_M = 0.12             # least motion within stuck_time_s
_FACING_RAD = math.radians(12.0)
_LOOK_FOR_S = 30.0          # of turning towards what is unknown, at most
_REMEMBERED_NS = 180 * NS_PER_S
_BUMP_AHEAD_M, _BUMP_RADIUS_M = 0.28, 0.10
_EDGE_RADIUS_M = 0.4        # of ground beyond an edge over which it leans: a small crater
_BEHIND = -math.sin(math.radians(15.0))     # ahead of it or aside is what is less behind it
_SHADOW_BEYOND_M, _SHADOW_RADIUS_M = 0.3, 0.6   # of what it has looked at
_LEAST_BACK_M = 0.05        # less is not worth backing off
_TRAIL_M = 0.1              # from place to place of the trail, which is known ground
_CLOSE_M = 0.4              # dark ground this near is looked at, however little of it there is
_ALIGNED_RAD = math.radians(5.0)
_TURN_FOR_S = 60.0          # to the final heading, at most
_AROUND_TURNS = 6           # of a sixth of a circle each, where no way is seen
_METRES_PER_RADIAN = 0.3    # weight of turning, where motion is looked at
_LOOKAHEAD_SHARES, _ARC_POINTS = (1.0, 0.5, 0.25), 9    # of the pursuit near obstacles
_CHECK_NS = 100_000_000
_SLOPE_DEG = 8.0            # on which it turns on an arc, not on the spot, where there is room
_SETTLED_NS = NS_PER_S      # after which a walking body is at rest
_NEARER_M = 0.3             # progress to the goal that counts
_RECOVERED_M = 1.0          # nearer by this, earlier recoveries do not count any more
_ONE_PLACE_M = 10.0         # plans that are made anew within this are at one place
_HOLE_M = 3.0               # a hole of the map from orbit this near is told of
_NEWS_M = 1.0               # from place to place of the way on which no way was found


class Status(str, enum.Enum):
    """What the navigator is doing."""

    IDLE = 'idle'
    WAITING = 'waiting'
    FOLLOWING = 'following'
    LOOKING = 'looking'
    BACKING = 'backing off'
    LETTING_DOWN = 'letting down'   # the body, by standing
    TURNING = 'turning'         # at the goal, to its heading
    ARRIVED = 'arrived'
    FAILED = 'failed'

    @property
    def is_end(self) -> bool:
        """Whether the drive is over."""
        return self in (Status.ARRIVED, Status.FAILED)


class Failure(str, enum.Enum):
    """Why the navigator gives up."""

    BLOCKED = 'blocked'
    STUCK = 'stuck'
    LOST = 'lost'
    TILT = 'tilt'


@dataclasses.dataclass(frozen=True)
class NavigatorCommand:
    """A velocity, and what the navigator is doing.

    Attributes:
        reason: One line for people.
        failure: Why it has given up; None: it has not.
    """

    forward_mps: float
    yaw_rate_radps: float
    status: Status
    reason: str = ''
    failure: Failure | None = None


class Navigator:
    """Drives to one goal after the other over maps that change.

    Attributes:
        plan: What it follows; None without one.
        far: The plan over the map from orbit along which `plan` leads; None: it leads straight to
            the goal.
        notes: Lines on what has happened since they were last taken, oldest first.
        backed_off: How often it has backed off, or tried to, since the last goals.
    """

    def __init__(self, config: NavigatorConfig, radius_m: float,
                 half_extent_m: float | None = None,
                 costs: Callable[[Sequence[Array]], GroundCosts] | None = None) -> None:
        """Make a navigator.

        Args:
            radius_m: Of the circle around the rover and its spokes.
            half_extent_m: The world extends to +-half_extent_m [m]; None has no edge.
            costs: Takes where the rover is and its goals, (2,) each, and returns what ground
                costs by the map from orbit; called where a goal is farther than `far.from_m`.
                None: there is no such map.

        Raises:
            NavigationError: If a goal of the configuration is outside the world.
        """
        self._config = config
        self._radius_m = radius_m
        self._half_extent_m = math.inf if half_extent_m is None else half_extent_m
        self._costs = costs
        self._pursuit_config = DriveConfig(
            speed_mps=config.speed_mps, max_yaw_rate_radps=config.max_yaw_rate_radps,
            lookahead_m=config.lookahead_m, turn_in_place_deg=_TURN_IN_PLACE_DEG,
            goal_tolerance_m=config.goal_tolerance_m)
        self.notes: list[str] = []
        self.reset()

    def reset(self) -> None:
        """Start again with the goals of the configuration."""
        self._goals: list[Array] = []
        self.far: GlobalPlan | None = None
        self._final_heading_rad: float | None = None
        self.plan: Plan | None = None
        self._start_ns: int | None = None
        self._now_ns = 0
        self._final: NavigatorCommand | None = None
        self._grid: Traversability | None = None
        self._overview: Overview | None = None
        self._news: list[Array] = []            # where plans from orbit were made anew
        self._holes: list[Array] = []           # of that map, which were told of
        self._discs: list[Disc] = []
        self._trail: list[Disc] = []
        self._position: Array | None = None
        self._seeing_heading: float | None = None       # when the newest depth came
        self._stop_ns: int | None = None        # when it stopped to look, and where
        self._stopped_at: Array | None = None
        self._restart()
        self.backed_off = 0
        if self._config.goals:
            self.set_goals(self._config.goals)

    def state(self) -> dict[str, Any]:
        """Return all that the drive goes on from."""
        return attributes_but(self, *_GIVEN)

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` has returned, of a navigator with the same parameters."""
        restore_attributes(self, state)

    def set_goals(self, goals_m: Sequence[ArrayLike],
                  final_heading_rad: float | None = None) -> None:
        """Drive to these goals, each (2,) or (3,) [m], one after the other; none: stand still.

        Args:
            final_heading_rad: To which it turns at the last one; None: it stays as it arrives.

        Raises:
            NavigationError: If a goal is not finite or outside the world; the old ones stay.
        """
        checked = [self._checked(goal) for goal in goals_m]
        self._goals, self._final, self.plan = checked, None, None
        self.far, self._is_far_known = None, False
        self._news.clear()
        self._final_heading_rad = final_heading_rad
        self.backed_off = 0
        self._restart()

    def follow(self, far: GlobalPlan, final_heading_rad: float | None = None) -> None:
        """Drive along a plan over the map from orbit, through its goals.

        Args:
            final_heading_rad: As of `set_goals`.

        Raises:
            NavigationError: If a goal of it is outside the world; the old ones stay.
        """
        self.set_goals(far.goals_m, final_heading_rad)
        self.far, self._is_far_known = far, True

    @property
    def goals_m(self) -> tuple[Array, ...]:
        """What is still to be reached, (2,) [m] each."""
        return tuple(self._goals)

    def left_m(self, position_m: ArrayLike) -> float:
        """Return the length of the way that is left, as far as it is planned, and straight on."""
        if not self._goals:
            return 0.0
        position = np.asarray(position_m, float)
        if self.far is not None:
            return self.far.left_m(position)
        way = np.stack([position[:2], self._goals[0]])
        if self.plan is not None:
            way = np.concatenate([self._rest_of(self.plan, position), self._goals[:1]])
        return path_length(np.concatenate([way, *(g[None] for g in self._goals[1:])]))

    def _checked(self, goal: ArrayLike) -> Array:
        try:
            point = np.asarray(goal, float)
        except (TypeError, ValueError):
            point = np.empty(0)
        if point.shape not in ((2,), (3,)) or not np.isfinite(point).all():
            raise NavigationError(f'goal: {brief(goal)} is not valid; valid are finite x, y [m]')
        limit = self._half_extent_m - self._config.border_m
        if np.abs(point[:2]).max() > limit:
            raise NavigationError(
                f'goal: x {point[0]:g} m, y {point[1]:g} m is outside the world; valid is within '
                f'+-{limit:g} m: it ends at +-{self._half_extent_m:g} m, and border_m is '
                f'{self._config.border_m:g} m')
        return point[:2].copy()

    def _restart(self) -> None:
        """Forget how the way to the present goal went so far."""
        self._pursuit: PurePursuit | None = None
        self._planner: Planner | None = None
        self._planned_ns: int | None = None
        self._look: tuple[int, float, Array | None] | None = None   # since, heading, what
        self._facing_ns: int | None = None
        self._around = 0
        # Since when it backs off, from where, how far, why, and to which place of its trail.
        self._back: tuple[int, Array, float, str, Array | None] | None = None
        self._turning_ns: int | None = None
        self._history: deque[tuple[int, float, float, float]] = deque()
        self._turned, self._heading = 0.0, 0.0
        self._recoveries = 0
        self._best_m, self._best_ns, self._recovered_m = math.inf, self._now_ns, math.inf
        self._missing_ns: int | None = None
        self._rearing = Rearing(self._config.tilt_limit_deg, self._now_ns)

    def update(self, stamp_ns: int, pose_ns: int | None, position_m: ArrayLike,
               orientation_wxyz: ArrayLike, grid: Traversability | None,
               tilt_of_imu_deg: float | None = None) -> NavigatorCommand:
        """Return the command at a stamp.

        Args:
            stamp_ns: Of the command [ns]. If time goes backward, everything starts again.
            pose_ns: Stamp of the newest pose [ns]; None: there is none.
            position_m: (3,) of that pose.
            orientation_wxyz: (4,) of that pose.
            grid: The newest map; None: there is none.
            tilt_of_imu_deg: By accelerometer and gyroscope, which do not jump as an estimated
                pose does; None: the tilt is that of the pose.
        """
        command = self._decide(stamp_ns, pose_ns, position_m, orientation_wxyz, grid,
                               tilt_of_imu_deg)
        if command.status is not Status.LETTING_DOWN:
            self._rearing.note_motion(command.forward_mps, command.yaw_rate_radps)
        return command

    def _decide(self, stamp_ns: int, pose_ns: int | None, position_m: ArrayLike,
                orientation_wxyz: ArrayLike, grid: Traversability | None,
                tilt_of_imu_deg: float | None) -> NavigatorCommand:
        if self._start_ns is not None and stamp_ns < self._now_ns:
            self.reset()
        self._now_ns = stamp_ns
        if self._start_ns is None:
            self._start_ns = self._best_ns = stamp_ns
        if not self._goals:
            return self._final or _still(Status.IDLE, 'no goal')
        if self._final is not None:
            return self._final
        if stamp_ns - self._start_ns < self._config.start_delay_s * 1e9:
            self._best_ns = stamp_ns
            return _still(Status.WAITING,
                          f'until start_delay_s {self._config.start_delay_s:g} is over')
        missing = self._missing_pose(pose_ns, position_m, orientation_wxyz)
        if missing is not None:
            return self._wait_for(missing)
        position = np.asarray(position_m, float)
        rotation = matrix_from_wxyz(orientation_wxyz)
        heading = math.atan2(rotation[1, 0], rotation[0, 0])
        tilt = float(tilt_deg(rotation)) if tilt_of_imu_deg is None else tilt_of_imu_deg
        self._rearing.note_tilt(stamp_ns, tilt)
        missing = self._missing_depth(grid)
        if missing is not None:
            return self._let_down() or self._wait_for(missing, heading)
        self._missing_ns = None
        assert grid is not None
        if self._grid is None or grid.stamp_ns != self._grid.stamp_ns:
            self._seeing_heading = heading
        self._note_place(position)
        self._note_motion(position, heading)
        if not self._is_far_known:
            refused = self._plan_far(position)
            if refused is not None:
                return refused
        if tilt > _TIPPED_DEG:
            return self._fail(Failure.TILT, f'tilted by {tilt:.0f} deg, more than '
                              f'{_TIPPED_DEG:g}', position)
        reached = self._reach(position, heading)
        if reached is not None:
            return reached
        if self._rearing.lasts(stamp_ns) and self._back is None:
            return self._recover(Failure.TILT, f'tilted by {tilt:.0f} deg', position,
                                 self._edge(position, heading, rotation[:2, 2]))
        reared = self._let_down()
        if reared is not None:
            return reared
        if self._back is not None:
            return self._go_back(position)
        if self._is_stuck():
            return self._recover(
                Failure.STUCK, f'moved less than {_STUCK_M:g} m in '
                f'{self._config.stuck_time_s:g} s', position,
                self._edge(position, heading, rotation[:2, 2]))
        late = self._patience(position)
        if late is not None:
            return late
        new_map = grid is not self._grid
        self._grid = grid
        if self._look is not None:
            return self._go_on_looking(position, heading)
        return self._stop_and_look(position, grid) or self._follow(position, heading, new_map)

    # Far goals

    def _plan_far(self, position: Array) -> NavigatorCommand | None:
        """Plan over the map from orbit where a goal is far; return a command without a way."""
        self._is_far_known = True
        places = [position[:2], *self._goals]
        if self._costs is None or all(np.linalg.norm(b - a) <= self._config.far.from_m
                                      for a, b in zip(places, places[1:])):
            return None
        try:
            self.far = GlobalPlan(self._costs(places), position, self._goals, self._config.far)
        except NavigationError as error:
            return self._fail(Failure.BLOCKED, str(error), None)
        self.notes.append(f'plans over the map from orbit: {self.far.length_m:.0f} m')
        return None

    def _target(self, position: Array) -> Array:
        """Return the place (2,) that the local plan leads to."""
        return self._goals[0] if self.far is None else self.far.ahead(position)

    def _go_another_way(self, why: Failure, text: str, position: Array) -> NavigatorCommand:
        """Plan anew over the map from orbit, since no way leads along the plan; else give up."""
        if self.far is None:
            return self._fail(why, text, position)
        here = [place for place in self._news
                if np.linalg.norm(place - position[:2]) < _ONE_PLACE_M]
        if len(here) >= self._config.far.plans:
            return self._fail(why, f'{text}, and made {len(here)} plans within '
                              f'{_ONE_PLACE_M:g} m', position)
        self._news.append(position[:2].copy())
        ahead = np.arange(0.0, self._config.far.ahead_m + _NEWS_M, _NEWS_M)
        if not self.far.report_blocked([self.far.ahead(position, s) for s in ahead], position):
            return self._fail(why, text, position)
        self.notes.append(f'{why.value}: {text}; another plan over the map from orbit, '
                          f'{self.far.length_m:.0f} m')
        self._look, self._around, self._recoveries = None, 0, 0
        self._best_m, self._best_ns, self._recovered_m = math.inf, self._now_ns, math.inf
        return self._plan_again()

    def _without_holes(self, grid: Traversability, position: Array) -> Traversability:
        """Return a map in which ground that the map from orbit does not know is not driven."""
        if self.far is None:
            return grid
        at = [low + (np.arange(len(grid.cost)) + 0.5) * grid.cell_m for low in grid.origin_m]
        hole = ~self.far.costs.known_at(*at)
        if not hole.any() or not self.far.has_ground(*position[:2]):
            return grid
        rows, columns = np.nonzero(hole)
        holes = np.stack([at[0][columns], at[1][rows]], axis=-1)
        apart = np.linalg.norm(holes - position[:2], axis=1)
        nearest = holes[int(np.argmin(apart))]
        if apart.min() < _HOLE_M and all(np.linalg.norm(nearest - one) > _ONE_PLACE_M
                                         for one in self._holes):
            self._holes.append(nearest)
            self.notes.append(f'keeps off x {nearest[0]:.1f} m, y {nearest[1]:.1f} m: the map '
                              'from orbit has no heights there')
        return dataclasses.replace(grid, cost=np.where(hole, np.int8(LETHAL), grid.cost))

    def _stop_and_look(self, position: Array, grid: Traversability) -> NavigatorCommand | None:
        """Return the command to stand where it is time for that; None where it may go on."""
        every_m = self._config.stop_every_m
        if not every_m:
            return None
        if self._stop_ns is None:
            if (self._stopped_at is not None
                    and np.linalg.norm(position[:2] - self._stopped_at) < every_m):
                return None
            self._stop_ns, self._stopped_at = self._now_ns, position[:2].copy()
        if grid.stamp_ns < self._stop_ns + _SETTLED_NS:
            self._history.clear()
            return _still(Status.LOOKING, 'stops and looks')
        self._stop_ns = None
        return None

    # What is missing

    def _missing_pose(self, pose_ns: int | None, position: ArrayLike,
                      orientation: ArrayLike) -> str | None:
        if pose_ns is None:
            return 'no pose yet'
        age_s = (self._now_ns - pose_ns) * 1e-9
        if age_s > self._config.pose_age_s:
            return f'no pose for {age_s:.1f} s'
        if not (np.isfinite(np.asarray(position, float)).all()
                and np.isfinite(np.asarray(orientation, float)).all()):
            return 'the pose is not finite'
        return None

    def _missing_depth(self, grid: Traversability | None) -> str | None:
        if grid is None:
            return 'no map yet'
        age_s = (self._now_ns - grid.stamp_ns) * 1e-9
        return f'no depth for {age_s:.1f} s' if age_s > self._config.map_age_s else None

    def _wait_for(self, missing: str, heading: float | None = None) -> NavigatorCommand:
        """Stand still; return the command.

        A rover that has turned into the dark turns back to where it saw something. Where there is
        nothing to be seen any more, or it has seen nothing yet, it looks around on the spot, where
        the ground is known.
        """
        if self._missing_ns is None:
            self._missing_ns = self._now_ns
            self.notes.append(f'stands still: {missing}')
        self._history.clear()
        config, waited_s = self._config, (self._now_ns - self._missing_ns) * 1e-9
        turn_s = 2.0 * math.pi / config.max_yaw_rate_radps
        # An image comes a while after the turn that shows something.
        back_s = (0.0 if heading is None or self._seeing_heading is None
                  else 0.5 * turn_s + config.map_age_s)
        around_s = 0.0 if heading is None else turn_s
        if waited_s > config.lost_s + back_s + around_s:
            return self._fail(Failure.LOST, missing, None)
        yaw_rate = 0.0
        if heading is not None and waited_s < back_s:
            assert self._seeing_heading is not None
            if self._look is not None:
                self._end_look()
            off = math.remainder(self._seeing_heading - heading, 2.0 * math.pi)
            if abs(off) > _ALIGNED_RAD:
                yaw_rate = math.copysign(config.max_yaw_rate_radps, off)
        elif heading is not None and waited_s > back_s + config.map_age_s \
                and waited_s < back_s + config.map_age_s + around_s:
            yaw_rate = config.max_yaw_rate_radps
        return NavigatorCommand(0.0, yaw_rate, Status.WAITING, missing)

    # Progress

    def _note_place(self, position: Array) -> None:
        """Take note of where it stands: that ground is known."""
        at = position[:2].copy()
        moved = 0.0 if self._position is None else float(np.linalg.norm(at - self._position))
        if moved > JUMP_M:
            self._begin_elsewhere(moved)
        if self._position is None or moved > JUMP_M:
            self._trail = [self._stood(at, max(self._config.plan.start_m, self._radius_m))]
        elif math.hypot(at[0] - self._trail[-1].x_m, at[1] - self._trail[-1].y_m) > _TRAIL_M:
            self._trail.append(self._stood(at, self._radius_m))
        self._position = at

    def _begin_elsewhere(self, moved_m: float) -> None:
        """Forget what was seen where the rover was believed to be, and plan to the same goals."""
        self.notes.append(f'the pose has jumped by {moved_m:.1f} m: plans anew')
        self.plan, self._overview, self._discs = None, None, []
        self.far, self._is_far_known = None, False
        self._news.clear()
        self._restart()

    def _stood(self, at: Array, radius_m: float) -> Disc:
        return Disc(float(at[0]), float(at[1]), radius_m, Ground.STOOD)

    def _note_motion(self, position: Array, heading: float) -> None:
        if self._history and self._now_ns - self._history[-1][0] < _CHECK_NS:
            return
        self._turned += math.remainder(heading - self._heading, 2.0 * math.pi)
        self._heading = heading
        self._history.append((self._now_ns, position[0], position[1], self._turned))
        span_ns = self._config.stuck_time_s * 1e9
        while len(self._history) > 1 and self._now_ns - self._history[1][0] >= span_ns:
            self._history.popleft()

    def _is_stuck(self) -> bool:
        if self._look is not None and self._facing_ns is not None:
            return False
        first, last = self._history[0], self._history[-1]
        if last[0] - first[0] < self._config.stuck_time_s * 1e9:
            return False
        moved = max(math.hypot(last[1] - x, last[2] - y)
                    + _METRES_PER_RADIAN * abs(last[3] - turned)
                    for _, x, y, turned in self._history)
        return moved < _STUCK_M

    def _patience(self, position: Array) -> NavigatorCommand | None:
        left, patience_s = (
            (float(np.linalg.norm(self._goals[0] - position[:2])), self._config.patience_s)
            if self.far is None else (self.far.left_m(position), self._config.far.patience_s))
        if left < self._best_m - _NEARER_M:
            self._best_m, self._best_ns = left, self._now_ns
        if left < self._recovered_m - _RECOVERED_M:
            self._recovered_m, self._recoveries = left, 0
        if self._now_ns - self._best_ns > patience_s * 1e9:
            return self._go_another_way(
                Failure.BLOCKED, f'not nearer than {self._best_m:.1f} m for '
                f'{patience_s:g} s', position)
        return None

    def _reach(self, position: Array, heading: float) -> NavigatorCommand | None:
        last = len(self._goals) == 1
        limit = self._config.goal_tolerance_m if last else _WAYPOINT_M
        if self._turning_ns is not None:
            limit *= 2.0        # turning moves it a little
        if float(np.linalg.norm(self._goals[0] - position[:2])) > limit:
            self._turning_ns = None
            return None
        at = f'x {position[0]:.2f} m, y {position[1]:.2f} m'
        if last:
            return self._turn(heading) or self._arrive(at)
        self.notes.append(f'waypoint reached at {at}; {len(self._goals) - 1} to go')
        self._goals.pop(0)
        if self.far is not None:
            self.far.reach(position)
        self.plan = None
        self._restart()
        return _still(Status.FOLLOWING, 'goes on to the next waypoint')

    def _turn(self, heading: float) -> NavigatorCommand | None:
        """Turn to the final heading; return None where it is that, or cannot be had."""
        if self._final_heading_rad is None:
            return None
        if self._turning_ns is None:
            self._turning_ns = self._now_ns
        off = math.remainder(self._final_heading_rad - heading, 2.0 * math.pi)
        if abs(off) <= math.radians(self._config.goal_heading_deg):
            return None
        if self._now_ns - self._turning_ns > _TURN_FOR_S * 1e9:
            self.notes.append(f'the final heading is missed by {math.degrees(off):.0f} deg')
            return None
        return NavigatorCommand(0.0, math.copysign(self._config.max_yaw_rate_radps, off),
                                Status.TURNING, 'turns to the final heading')

    def _arrive(self, at: str) -> NavigatorCommand:
        self._final = _still(Status.ARRIVED, f'at {at}')
        self.notes.append(f'arrived at {at}')
        return self._final

    def _fail(self, why: Failure, text: str, position: Array | None) -> NavigatorCommand:
        where = '' if position is None else f' at x {position[0]:.2f} m, y {position[1]:.2f} m'
        self._final = NavigatorCommand(0.0, 0.0, Status.FAILED, f'{why.value}: {text}{where}', why)
        self.notes.append(f'gives up: {self._final.reason}')
        self.plan = None
        return self._final

    # Backing off

    def _let_down(self) -> NavigatorCommand | None:
        """Return the command that lets the body down; None where it has not reared up."""
        velocity = self._rearing.let_down(self._now_ns)
        return None if velocity is None else NavigatorCommand(
            *velocity, Status.LETTING_DOWN, 'the body has reared up')

    def _edge(self, position: Array, heading: float, lean: Array) -> Disc | None:
        """Return the ground beyond an edge over which it leans, as over the rim of a crater.

        None where it does not lean ahead or sideways, or a goal lies there: it has to go there.

        Args:
            lean: (2,) level part of the axis that points up from the body.
        """
        size = float(np.linalg.norm(lean))
        ahead = lean[0] * math.cos(heading) + lean[1] * math.sin(heading)
        if size < 0.5 * math.sin(math.radians(self._config.tilt_limit_deg)) \
                or ahead < _BEHIND * size:
            return None
        x, y = position[:2] + _EDGE_RADIUS_M * lean / size
        if min(math.dist(goal, (x, y)) for goal in self._goals) < _EDGE_RADIUS_M + self._room_m:
            return None
        return Disc(float(x), float(y), _EDGE_RADIUS_M, Ground.BUMP,
                    self._now_ns + _REMEMBERED_NS)

    @property
    def _room_m(self) -> float:
        return self._radius_m + self._config.plan.margin_m

    def _recover(self, why: Failure, text: str, position: Array,
                 edge: Disc | None = None) -> NavigatorCommand:
        """Back off, and remember what is there.

        Args:
            edge: Ground of which it gets clear with all of its legs.
        """
        self._recoveries += 1
        if self._recoveries > self._config.recoveries:
            return self._go_another_way(
                why, f'{text}, and backed off {self._config.recoveries} times', position)
        self.backed_off += 1
        heading, wanted = self._heading, self._config.back_off_m
        if edge is not None:
            # It stands at the edge: straight back to where its circle and that ground just touch.
            off = edge.x_m - position[0], edge.y_m - position[1]
            ahead = off[0] * math.cos(heading) + off[1] * math.sin(heading)
            apart = edge.radius_m + self._room_m
            wanted = max(wanted, math.sqrt(ahead ** 2 + apart ** 2 - edge.radius_m ** 2) - ahead)
        way = 0.0 if self._planner is None else self._planner.clear_back_m(
            position, heading, wanted)
        place = self._trail_back(position, wanted, edge) if way < 0.5 * wanted else None
        bumps: tuple[float, ...] = _BUMP_AHEAD_M, _BUMP_AHEAD_M + _BUMP_RADIUS_M
        if place is not None:
            way, bumps = math.dist(place, position[:2]), (0.0,)
        self.notes.append(f'backs off by {way:.2f} m'
                          f'{"" if place is None else " on its trail"}: {text}')
        for ahead in bumps:
            self._discs.append(Disc(float(position[0]) + ahead * math.cos(heading),
                                    float(position[1]) + ahead * math.sin(heading),
                                    _BUMP_RADIUS_M, Ground.BUMP, self._now_ns + _REMEMBERED_NS))
        if edge is not None:
            self._discs.append(edge)
        self._look = None
        self._rearing.end(self._now_ns)
        if way < _LEAST_BACK_M:
            return self._plan_again()
        self._back = self._now_ns, position.copy(), way, text, place
        return self._go_back(position)

    def _trail_back(self, position: Array, least_m: float, edge: Disc | None) -> Array | None:
        """Return the place of its trail to which it backs off, and forget the trail from there on.

        It has been there: that ground carries it, whatever the map says. Of the places far enough
        off it is the last one with room around it, else the last one.
        """
        places = np.array([(disc.x_m, disc.y_m) for disc in self._trail]).reshape(-1, 2)
        far = np.linalg.norm(places - position[:2], axis=1) >= least_m
        if edge is not None:
            far &= np.linalg.norm(places - (edge.x_m, edge.y_m), axis=1) \
                >= edge.radius_m + self._room_m
        if not far.any():
            return None
        roomy = far & (self._planner is not None and self._planner.has_room(places))
        last = int(np.flatnonzero(roomy if roomy.any() else far)[-1])
        del self._trail[last + 1:]
        return np.asarray(places[last])

    def _go_back(self, position: Array) -> NavigatorCommand:
        assert self._back is not None
        since, start, way, text, place = self._back
        gone = float(np.linalg.norm(position[:2] - start[:2]))
        if gone >= way or self._now_ns - since >= 3.0e9 * way / -_BACK_MPS:
            return self._plan_again()
        if place is None:
            return NavigatorCommand(_BACK_MPS, 0.0, Status.BACKING, text)
        # On an arc to that place, with whichever end is nearer to it.
        off = place - position[:2]
        angle = math.remainder(math.atan2(off[1], off[0]) - self._heading, 2.0 * math.pi)
        forward = -_BACK_MPS if abs(angle) < 0.5 * math.pi else _BACK_MPS
        bend = math.sin(angle) if forward > 0.0 else -math.sin(angle)
        most = self._config.max_yaw_rate_radps
        rate = 2.0 * -_BACK_MPS * bend / max(float(np.linalg.norm(off)), _LEAST_BACK_M)
        return NavigatorCommand(forward, min(max(rate, -most), most), Status.BACKING, text)

    def _plan_again(self) -> NavigatorCommand:
        self._back = self._planned_ns = self.plan = self._pursuit = None
        self._history.clear()
        self._rearing.begin_anew(self._now_ns)
        return _still(Status.FOLLOWING, 'plans again')

    # Looking

    def _begin_to_look(self, heading: float, what: Array | None, text: str) -> NavigatorCommand:
        self._look = self._now_ns, heading, what
        self._facing_ns = None
        return _still(Status.LOOKING, text)

    def _go_on_looking(self, position: Array, heading: float) -> NavigatorCommand:
        assert self._look is not None
        since, wanted, what = self._look
        off = math.remainder(wanted - heading, 2.0 * math.pi)
        if self._facing_ns is None:
            if abs(off) > _FACING_RAD and self._now_ns - since < _LOOK_FOR_S * 1e9:
                return NavigatorCommand(
                    0.0, math.copysign(self._config.max_yaw_rate_radps, off), Status.LOOKING,
                    'turns towards what it does not know')
            self._facing_ns = self._now_ns
        if self._now_ns - self._facing_ns < self._config.look_s * 1e9:
            return _still(Status.LOOKING, 'looks')
        self._end_look()
        return _still(Status.LOOKING, 'looks')

    def _end_look(self) -> None:
        assert self._look is not None
        _, wanted, what = self._look
        self._look = self._facing_ns = self._planned_ns = None
        self._history.clear()
        if what is not None:
            # What is still unknown then is in shadow, or hidden.
            x, y = what + _SHADOW_BEYOND_M * np.array([math.cos(wanted), math.sin(wanted)])
            self._discs.append(Disc(float(x), float(y), _SHADOW_RADIUS_M, Ground.SHADOW,
                                    self._now_ns + _REMEMBERED_NS))

    # Following

    def _follow(self, position: Array, heading: float, new_map: bool) -> NavigatorCommand:
        self._discs = [disc for disc in self._discs if disc.until_ns > self._now_ns]
        failed = self._replan(position, heading, new_map)
        if failed is not None:
            return failed
        plan, planner = self.plan, self._planner
        assert plan is not None and planner is not None and self._pursuit is not None
        dark_m, first = planner.dark_along_m(self._rest_of(plan, position), 0.0,
                                             _LOOK_AHEAD_M)
        near_m = float(np.linalg.norm(first - position[:2])) if dark_m else math.inf
        if (dark_m > _LOOK_UNKNOWN_M or near_m < _CLOSE_M) \
                and not self._has_looked_at(first):
            towards = first - position[:2]
            return self._begin_to_look(math.atan2(towards[1], towards[0]), first,
                                       f'{dark_m:.2f} m of the way ahead are unknown')
        steering = self._steering(planner, position, heading)
        if steering is None:
            self._planned_ns = None
            return _still(Status.FOLLOWING, 'no arc along the plan is clear')
        if steering.done:
            if plan.off_goal_m > 0.0:
                return self._end_beside(planner, plan, position)
            self._planned_ns = None
            return _still(Status.FOLLOWING, 'plans on')
        speed, yaw_rate = steering.forward_mps, steering.yaw_rate_radps
        if near_m < _CLOSE_M and speed > self._config.creep_mps:
            yaw_rate *= self._config.creep_mps / speed
            speed = self._config.creep_mps
        return NavigatorCommand(speed, yaw_rate, Status.FOLLOWING)

    def _end_beside(self, planner: Planner, plan: Plan, position: Array) -> NavigatorCommand:
        """Look at a goal that cannot be stood on; give up if that is still so."""
        goal = self._target(position)
        what = ('on an obstacle' if planner.is_blocked(goal)
                else 'on ground that is not seen')
        if not self._has_looked_at(goal):
            towards = goal - position[:2]
            return self._begin_to_look(math.atan2(towards[1], towards[0]), goal,
                                       f'the goal seems to lie {what}')
        text = (f'the goal lies {what}; the nearest place that can be reached is '
                f'{plan.off_goal_m:.2f} m from it')
        if np.array_equal(goal, self._goals[0]):
            return self._fail(Failure.BLOCKED, text, position)
        return self._go_another_way(Failure.BLOCKED, text, position)

    def _steering(self, planner: Planner, position: Array, heading: float) -> Steering | None:
        """Return the steering with the longest lookahead that cuts no corner at an obstacle.

        Where no arc is clear it turns on the spot to the plan; None: it looks along it already.
        """
        assert self._pursuit is not None
        for share in _LOOKAHEAD_SHARES:
            ahead = share * self._config.lookahead_m
            steering = self._pursuit.update(position, heading, ahead)
            if steering.forward_mps <= 0.0 and not steering.done:
                return self._on_an_arc(planner, position, heading, steering)
            left = max(self._pursuit.route.length_m - steering.along_m, 0.0)
            if steering.done or planner.is_clear(
                    _arc(position, heading, steering, min(ahead, left))):
                return steering
        if abs(steering.heading_error_rad) < _ALIGNED_RAD:
            return None
        return self._on_an_arc(planner, position, heading, dataclasses.replace(
            steering, forward_mps=0.0, yaw_rate_radps=math.copysign(
                self._config.max_yaw_rate_radps, steering.heading_error_rad)))

    def _on_an_arc(self, planner: Planner, position: Array, heading: float,
                   turn: Steering) -> Steering:
        """Return a turn on the spot; on a slope, where there is room, on an arc."""
        if self._rearing.mean_deg < _SLOPE_DEG:
            return turn
        arc = dataclasses.replace(turn, forward_mps=self._config.speed_mps)
        length = self._config.speed_mps * abs(turn.heading_error_rad / turn.yaw_rate_radps)
        clear = planner.is_clear(_arc(position, heading, arc, length))
        return arc if clear else turn

    def _replan(self, position: Array, heading: float,
                new_map: bool) -> NavigatorCommand | None:
        """Make or keep a plan; return a command instead where there is none."""
        config, now = self._config, self._now_ns
        assert self._grid is not None
        due = self._planned_ns is None or now - self._planned_ns >= _PLAN_NS
        if not (due or new_map):
            return None
        if self._overview is None or self._overview.map_cell_m != self._grid.cell_m:
            self._overview = Overview(self._grid.cell_m, 1.0 + config.plan.unknown_cost)
        planner = Planner(self._without_holes(self._grid, position), config.plan, self._radius_m,
                          position[:2], (*self._trail, *self._discs), self._overview, config.creep)
        self._overview.add(self._grid.origin_m, planner.blocked, planner.unknown, planner.room_m)
        self._planner = planner
        old, target = math.inf, self._target(position)
        if self.plan is not None:
            old = planner.cost_along(self._rest_of(self.plan, position), target)
            if math.isfinite(old) and not due:
                return None
        self._planned_ns = now
        found = planner.plan(target)
        if found is None:
            return self._look_around(position, heading)
        self._around = 0
        if not np.ptp(found.points_m, axis=0).any():    # it stands there already
            return (self._end_beside(planner, found, position) if found.off_goal_m
                    else self._look_around(position, heading))
        if self.plan is None or found.cost < config.better * old or not math.isfinite(old) \
                or self._is_at_end(self.plan, position):
            self.plan = found
            # From the place that replaces a goal it must reach the goal's own tolerance.
            tolerance = self._config.goal_tolerance_m * (0.5 if found.off_goal_m else 1.0)
            self._pursuit = PurePursuit(dataclasses.replace(
                self._pursuit_config, goal_tolerance_m=tolerance), Route(found.points_m))
        return None

    def _look_around(self, position: Array, heading: float) -> NavigatorCommand:
        if self._around >= _AROUND_TURNS:
            return self._go_another_way(
                Failure.BLOCKED, 'no way to the goal is seen, all around', position)
        self._around += 1
        self.plan = self._pursuit = None
        return self._begin_to_look(heading + 2.0 * math.pi / _AROUND_TURNS, None,
                                   'sees no way to the goal, and looks around')

    def _is_at_end(self, plan: Plan, position: Array) -> bool:
        """Return whether a plan that ends before the goal is nearly driven."""
        return not plan.reaches_goal and len(self._rest_of(plan, position)) < 20

    def _rest_of(self, plan: Plan, position: Array) -> Array:
        """Return what is left of a plan, from the rover on, (n, 2)."""
        k = int(np.argmin(np.linalg.norm(plan.points_m - position[:2], axis=1)))
        return np.concatenate([position[None, :2], plan.points_m[k + 1:]]) \
            if k + 1 < len(plan.points_m) else np.stack([position[:2], plan.points_m[-1]])

    def _has_looked_at(self, xy: Array) -> bool:
        return any(disc.ground is Ground.SHADOW
                   and math.hypot(disc.x_m - xy[0], disc.y_m - xy[1]) < disc.radius_m
                   for disc in self._discs)


def _arc(position: Array, heading: float, steering: Steering, length_m: float) -> Array:
    """Return (n, 2) points of the arc that a steering follows [m]."""
    along = np.linspace(0.0, length_m, _ARC_POINTS)
    angle = heading + 0.5 * along * steering.yaw_rate_radps / steering.forward_mps
    # The chord from its start is turned by half the angle of the arc, and nearly as long.
    return position[:2] + along[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _still(status: Status, reason: str) -> NavigatorCommand:
    return NavigatorCommand(0.0, 0.0, status, reason)
