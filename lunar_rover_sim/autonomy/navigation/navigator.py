"""The navigator: plans over the newest map, follows, looks, backs off, and gives up with a reason.

It reads no clock and no random number: the same calls give the same commands.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.autonomy.navigation.config import NavigatorConfig
from lunar_rover_sim.autonomy.navigation.overview import Overview
from lunar_rover_sim.autonomy.navigation.planner import Disc, Plan, Planner
from lunar_rover_sim.autonomy.navigation.traversability import Traversability
from lunar_rover_sim.autonomy.path_following.config import DriveConfig
from lunar_rover_sim.autonomy.path_following.driver import PurePursuit, Steering
from lunar_rover_sim.autonomy.path_following.route import Route
from lunar_rover_sim.base.arguments import brief
from lunar_rover_sim.base.errors import NavigationError
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, tilt_deg
from lunar_rover_sim.base.seconds import NS_PER_S

IDLE, WAITING, FOLLOWING, LOOKING, BACKING, ARRIVED, FAILED = (
    'idle', 'waiting', 'following', 'looking', 'backing off', 'arrived', 'failed')
BLOCKED, STUCK, LOST, TILT = 'blocked', 'stuck', 'lost', 'tilt'     # why it gives up

_BACK_MPS = -0.08
_FACING_RAD = math.radians(12.0)
_LOOK_FOR_S = 30.0          # of turning towards what is unknown, at most
_REMEMBERED_NS = 180 * NS_PER_S
_BUMP_AHEAD_M, _BUMP_RADIUS_M = 0.28, 0.10
_SHADOW_RADIUS_M, _SHADOW_COST = 0.45, 3.0
_AROUND_TURNS = 6           # of a sixth of a circle each, where no way is seen
_METRES_PER_RADIAN = 0.3    # weight of turning, where motion is looked at
_LOOKAHEAD_SHARES, _ARC_POINTS = (1.0, 0.5, 0.25), 9    # of the pursuit near obstacles
_CHECK_NS = 100_000_000
_NEARER_M = 0.3             # progress to the goal that counts
_RECOVERED_M = 1.0          # nearer by this, earlier recoveries do not count any more


@dataclasses.dataclass(frozen=True)
class NavigatorCommand:
    """A velocity, and what the navigator is doing.

    Attributes:
        status: idle, waiting, following, looking, backing off, arrived or failed.
        reason: One line; where failed it begins with blocked, stuck, lost or tilt.
    """

    forward_mps: float
    yaw_rate_radps: float
    status: str
    reason: str = ''

    @property
    def failure(self) -> str:
        """blocked, stuck, lost or tilt where it has failed, else ''."""
        return self.reason.partition(':')[0] if self.status == FAILED else ''


class Navigator:
    """Drives to one goal after the other over maps that change.

    Attributes:
        plan: What it follows; None without one.
        notes: Lines on what has happened since they were last taken, oldest first.
    """

    def __init__(self, config: NavigatorConfig, half_width_m: float,
                 half_extent_m: float | None = None) -> None:
        """Make a navigator for a rover of a half width [m].

        Args:
            half_extent_m: The world extends to +-half_extent_m [m]; None has no edge.

        Raises:
            NavigationError: If a goal of the configuration is outside the world.
        """
        self._config = config
        self._half_width_m = half_width_m
        self._half_extent_m = math.inf if half_extent_m is None else half_extent_m
        self._pursuit_config = DriveConfig(
            speed_mps=config.speed_mps, max_yaw_rate_radps=config.max_yaw_rate_radps,
            lookahead_m=config.lookahead_m, turn_in_place_deg=config.turn_in_place_deg,
            goal_tolerance_m=config.goal_tolerance_m)
        self.notes: list[str] = []
        self.reset()

    def reset(self) -> None:
        """Start again with the goals of the configuration."""
        self._goals: list[Array] = []
        self.plan: Plan | None = None
        self._start_ns: int | None = None
        self._now_ns = 0
        self._final: NavigatorCommand | None = None
        self._grid: Traversability | None = None
        self._overview: Overview | None = None
        self._discs: list[Disc] = []
        self._restart()
        if self._config.goals:
            self.set_goals(self._config.goals)

    def set_goals(self, goals_m: Sequence[ArrayLike]) -> None:
        """Drive to these goals, each (2,) or (3,) [m], one after the other; none: stand still.

        Raises:
            NavigationError: If a goal is not finite or outside the world; the old ones stay.
        """
        checked = [self._checked(goal) for goal in goals_m]
        self._goals, self._final, self.plan = checked, None, None
        self._restart()

    @property
    def goals_m(self) -> tuple[Array, ...]:
        """What is still to be reached, (2,) [m] each."""
        return tuple(self._goals)

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
        self._back: tuple[int, Array, str] | None = None    # since, from where, why
        self._history: deque[tuple[int, float, float, float]] = deque()
        self._turned, self._heading = 0.0, 0.0
        self._recoveries = 0
        self._best_m, self._best_ns, self._recovered_m = math.inf, self._now_ns, math.inf
        self._missing_ns: int | None = None
        self._level_ns = self._now_ns

    def update(self, stamp_ns: int, pose_ns: int | None, position_m: ArrayLike,
               orientation_wxyz: ArrayLike, grid: Traversability | None) -> NavigatorCommand:
        """Return the command at a stamp.

        Args:
            stamp_ns: Of the command [ns]. If time goes backward, everything starts again.
            pose_ns: Stamp of the newest pose [ns]; None: there is none.
            position_m: (3,) of that pose.
            orientation_wxyz: (4,) of that pose.
            grid: The newest map; None: there is none.
        """
        if self._start_ns is not None and stamp_ns < self._now_ns:
            self.reset()
        self._now_ns = stamp_ns
        if self._start_ns is None:
            self._start_ns = self._best_ns = stamp_ns
        if not self._goals:
            return self._final or _still(IDLE, 'no goal')
        if self._final is not None:
            return self._final
        if stamp_ns - self._start_ns < self._config.start_delay_s * 1e9:
            self._best_ns = stamp_ns
            return _still(WAITING, f'until start_delay_s {self._config.start_delay_s:g} is over')
        missing = self._what_is_missing(pose_ns, position_m, orientation_wxyz, grid)
        if missing:
            return self._wait_for(missing)
        self._missing_ns = None
        assert grid is not None
        position = np.asarray(position_m, float)
        rotation = matrix_from_wxyz(orientation_wxyz)
        heading = math.atan2(rotation[1, 0], rotation[0, 0])
        tilt = float(tilt_deg(rotation))
        self._note_motion(position, heading)
        if tilt > self._config.tipped_deg:
            return self._fail(TILT, f'tilted by {tilt:.0f} deg, more than tipped_deg '
                              f'{self._config.tipped_deg:g}', position)
        reached = self._reach(position)
        if reached is not None:
            return reached
        if self._back is not None:
            return self._go_back(position, heading)
        if tilt <= self._config.tilt_limit_deg:
            self._level_ns = self._now_ns
        elif self._now_ns - self._level_ns >= self._config.tilt_time_s * 1e9:
            return self._recover(TILT, f'tilted by {tilt:.0f} deg', position)
        if self._is_stuck():
            return self._recover(STUCK, f'moved less than {self._config.stuck_distance_m:g} m in '
                                 f'{self._config.stuck_time_s:g} s', position)
        late = self._patience(position)
        if late is not None:
            return late
        new_map = grid is not self._grid
        self._grid = grid
        if self._look is not None:
            return self._go_on_looking(position, heading)
        return self._follow(position, heading, new_map)

    # What is missing

    def _what_is_missing(self, pose_ns: int | None, position: ArrayLike, orientation: ArrayLike,
                         grid: Traversability | None) -> str:
        now, config = self._now_ns, self._config
        if pose_ns is None:
            return 'no pose yet'
        if now - pose_ns > config.pose_age_s * 1e9:
            return f'no pose for {(now - pose_ns) * 1e-9:.1f} s'
        if not (np.isfinite(np.asarray(position, float)).all()
                and np.isfinite(np.asarray(orientation, float)).all()):
            return 'the pose is not finite'
        if grid is None:
            return 'no map yet'
        if now - grid.stamp_ns > config.map_age_s * 1e9:
            return f'no map for {(now - grid.stamp_ns) * 1e-9:.1f} s'
        return ''

    def _wait_for(self, missing: str) -> NavigatorCommand:
        if self._missing_ns is None:
            self._missing_ns = self._now_ns
            self.notes.append(f'stands still: {missing}')
        self._history.clear()
        if self._now_ns - self._missing_ns > self._config.lost_s * 1e9:
            return self._fail(LOST, missing, None)
        return _still(WAITING, missing)

    # Progress

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
        return moved < self._config.stuck_distance_m

    def _patience(self, position: Array) -> NavigatorCommand | None:
        left = float(np.linalg.norm(self._goals[0] - position[:2]))
        if left < self._best_m - _NEARER_M:
            self._best_m, self._best_ns = left, self._now_ns
        if left < self._recovered_m - _RECOVERED_M:
            self._recovered_m, self._recoveries = left, 0
        if self._now_ns - self._best_ns > self._config.patience_s * 1e9:
            return self._fail(BLOCKED, f'not nearer than {self._best_m:.1f} m for '
                              f'{self._config.patience_s:g} s', position)
        return None

    def _reach(self, position: Array) -> NavigatorCommand | None:
        last = len(self._goals) == 1
        limit = self._config.goal_tolerance_m if last else self._config.waypoint_tolerance_m
        if float(np.linalg.norm(self._goals[0] - position[:2])) > limit:
            return None
        at = f'x {position[0]:.2f} m, y {position[1]:.2f} m'
        if last:
            self._final = _still(ARRIVED, f'at {at}')
            self.notes.append(f'arrived at {at}')
            return self._final
        self.notes.append(f'waypoint reached at {at}; {len(self._goals) - 1} to go')
        self._goals.pop(0)
        self.plan = None
        self._restart()
        return _still(FOLLOWING, 'goes on to the next waypoint')

    def _fail(self, why: str, text: str, position: Array | None) -> NavigatorCommand:
        where = '' if position is None else f' at x {position[0]:.2f} m, y {position[1]:.2f} m'
        self._final = _still(FAILED, f'{why}: {text}{where}')
        self.notes.append(f'gives up: {self._final.reason}')
        self.plan = None
        return self._final

    # Backing off

    def _recover(self, why: str, text: str, position: Array) -> NavigatorCommand:
        self._recoveries += 1
        if self._recoveries > self._config.recoveries:
            return self._fail(why, f'{text}, and backed off {self._config.recoveries} times',
                              position)
        self.notes.append(f'backs off: {text}')
        heading = self._heading
        for ahead in (_BUMP_AHEAD_M, _BUMP_AHEAD_M + _BUMP_RADIUS_M):
            self._discs.append(Disc(float(position[0]) + ahead * math.cos(heading),
                                    float(position[1]) + ahead * math.sin(heading),
                                    _BUMP_RADIUS_M, math.inf, self._now_ns + _REMEMBERED_NS))
        self._back = self._now_ns, position.copy(), text
        self._look = None
        return NavigatorCommand(_BACK_MPS, 0.0, BACKING, text)

    def _go_back(self, position: Array, heading: float) -> NavigatorCommand:
        assert self._back is not None
        since, start, text = self._back
        gone = float(np.linalg.norm(position[:2] - start[:2]))
        limit_s = 3.0 * self._config.back_off_m / -_BACK_MPS
        if gone < self._config.back_off_m and self._now_ns - since < limit_s * 1e9:
            return NavigatorCommand(_BACK_MPS, 0.0, BACKING, text)
        self._back = self._planned_ns = self.plan = self._pursuit = None
        self._history.clear()
        self._level_ns = self._now_ns
        return _still(FOLLOWING, 'plans again')

    # Looking

    def _begin_to_look(self, heading: float, what: Array | None, text: str) -> NavigatorCommand:
        self._look = self._now_ns, heading, what
        self._facing_ns = None
        return _still(LOOKING, text)

    def _go_on_looking(self, position: Array, heading: float) -> NavigatorCommand:
        assert self._look is not None
        since, wanted, what = self._look
        off = math.remainder(wanted - heading, 2.0 * math.pi)
        if self._facing_ns is None:
            if abs(off) > _FACING_RAD and self._now_ns - since < _LOOK_FOR_S * 1e9:
                return NavigatorCommand(
                    0.0, math.copysign(self._config.max_yaw_rate_radps, off), LOOKING,
                    'turns towards what it does not know')
            self._facing_ns = self._now_ns
        if self._now_ns - self._facing_ns < self._config.look_s * 1e9:
            return _still(LOOKING, 'looks')
        self._look = self._facing_ns = self._planned_ns = None
        self._history.clear()
        if what is not None:
            # What is still unknown then is in shadow: go around it where possible, else through.
            self._discs.append(Disc(float(what[0]), float(what[1]), _SHADOW_RADIUS_M,
                                    _SHADOW_COST, self._now_ns + _REMEMBERED_NS))
        return _still(LOOKING, 'looks')

    # Following

    def _follow(self, position: Array, heading: float, new_map: bool) -> NavigatorCommand:
        self._discs = [disc for disc in self._discs if disc.until_ns > self._now_ns]
        failed = self._replan(position, heading, new_map)
        if failed is not None:
            return failed
        plan, planner = self.plan, self._planner
        assert plan is not None and planner is not None and self._pursuit is not None
        unknown_m, first = planner.unknown_along_m(
            self._rest_of(plan, position), self._config.plan.blind_m, self._config.look_ahead_m)
        if unknown_m > self._config.look_unknown_m and not self._has_looked_at(first):
            towards = first - position[:2]
            return self._begin_to_look(math.atan2(towards[1], towards[0]), first,
                                       f'{unknown_m:.2f} m of the way ahead are unknown')
        steering = self._steering(planner, position, heading)
        if steering.done:
            if plan.off_goal_m > 0.0 and not self._has_looked_at(self._goals[0]):
                towards = self._goals[0] - position[:2]
                return self._begin_to_look(math.atan2(towards[1], towards[0]), self._goals[0],
                                           'the goal seems to lie on an obstacle')
            if plan.off_goal_m > 0.0:
                return self._fail(BLOCKED, f'the goal lies on an obstacle; the nearest place that '
                                  f'can be reached is {plan.off_goal_m:.2f} m from it', position)
            self._planned_ns = None
            return _still(FOLLOWING, 'plans on')
        return NavigatorCommand(steering.forward_mps, steering.yaw_rate_radps, FOLLOWING)

    def _steering(self, planner: Planner, position: Array, heading: float) -> Steering:
        """Return the steering with the longest lookahead that cuts no corner at an obstacle."""
        assert self._pursuit is not None
        for share in _LOOKAHEAD_SHARES:
            ahead = share * self._config.lookahead_m
            steering = self._pursuit.update(position, heading, ahead)
            if steering.forward_mps <= 0.0 or planner.is_clear(
                    _arc(position, heading, steering, ahead)):
                break
        return steering

    def _replan(self, position: Array, heading: float,
                new_map: bool) -> NavigatorCommand | None:
        """Make or keep a plan; return a command instead where there is none."""
        config, now = self._config, self._now_ns
        assert self._grid is not None
        due = self._planned_ns is None or now - self._planned_ns >= config.plan_period_s * 1e9
        if not (due or new_map):
            return None
        if self._overview is None or self._overview.map_cell_m != self._grid.cell_m:
            self._overview = Overview(self._grid.cell_m, 1.0 + config.plan.unknown_cost)
        planner = Planner(self._grid, config.plan, self._half_width_m, position[:2],
                          tuple(self._discs), self._overview)
        self._overview.add(self._grid.origin_m, planner.blocked, planner.unknown, planner.room_m)
        self._planner = planner
        old = math.inf
        if self.plan is not None:
            old = planner.cost_along(self._rest_of(self.plan, position), self._goals[0])
            if math.isfinite(old) and not due:
                return None
        self._planned_ns = now
        found = planner.plan(self._goals[0])
        if found is None:
            return self._look_around(position, heading)
        self._around = 0
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
            return self._fail(BLOCKED, 'no way to the goal is seen, all around', position)
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
        return any(math.isfinite(disc.cost)
                   and math.hypot(disc.x_m - xy[0], disc.y_m - xy[1]) < 1.5 * disc.radius_m
                   for disc in self._discs)


def _arc(position: Array, heading: float, steering: Steering, length_m: float) -> Array:
    """Return (n, 2) points of the arc that a steering follows [m]."""
    along = np.linspace(0.0, length_m, _ARC_POINTS)
    angle = heading + 0.5 * along * steering.yaw_rate_radps / steering.forward_mps
    # The chord from its start is turned by half the angle of the arc, and nearly as long.
    return position[:2] + along[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _still(status: str, reason: str) -> NavigatorCommand:
    return NavigatorCommand(0.0, 0.0, status, reason)
