"""The navigator: plans over the newest map, follows, looks, backs off, and gives up with a reason.

It reads no clock and no random number: the same calls give the same commands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.autonomy.navigation.backing import Backing
from lunar_rover_sim.autonomy.navigation.command import Failure, NavigatorCommand, Status, still
from lunar_rover_sim.autonomy.navigation.config import NavigatorConfig
from lunar_rover_sim.autonomy.navigation.far_goals import CostsAround, FarGoals
from lunar_rover_sim.autonomy.navigation.global_plan import GlobalPlan
from lunar_rover_sim.autonomy.navigation.local_plan import LocalPlan
from lunar_rover_sim.autonomy.navigation.looking import Looking
from lunar_rover_sim.autonomy.navigation.planner import Disc, Ground, Plan
from lunar_rover_sim.autonomy.navigation.poses import JUMP_M
from lunar_rover_sim.autonomy.navigation.progress import Progress, STUCK_M
from lunar_rover_sim.autonomy.navigation.rearing import Rearing
from lunar_rover_sim.autonomy.navigation.traversability import Traversability
from lunar_rover_sim.autonomy.navigation.waiting import Waiting
from lunar_rover_sim.base.errors import brief, NavigationError
from lunar_rover_sim.base.files.state_file import attributes_but, restore_attributes
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, path_length, tilt_deg

_GIVEN = '_config', '_radius_m', '_half_extent_m', '_costs'
_WAYPOINT_M = 0.4           # a waypoint before the last is reached at this distance
_TIPPED_DEG = 65.0          # tilt at which it gives up
_LOOK_UNKNOWN_M = 0.15      # of the way just ahead: it looks where more is unknown
_CLOSE_M = 0.4              # dark ground this near is looked at, however little of it there is
_TURN_FOR_S = 60.0          # to the final heading, at most


class Navigator:
    """Drives to one goal after the other over maps that change.

    Attributes:
        notes: Lines on what has happened since they were last taken, oldest first.
        backed_off: How often it has backed off, or tried to, since the last goals.
    """

    def __init__(self, config: NavigatorConfig, radius_m: float,
                 half_extent_m: float | None = None,
                 costs: CostsAround | None = None) -> None:
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
        self.notes: list[str] = []
        self.reset()

    def reset(self) -> None:
        """Start again with the goals of the configuration."""
        self._goals: list[Array] = []
        self._final_heading_rad: float | None = None
        self._start_ns: int | None = None
        self._now_ns = 0
        self._final: NavigatorCommand | None = None
        self._discs: list[Disc] = []
        self._grid: Traversability | None = None
        self._position: Array | None = None
        self._waiting = Waiting(self._config)
        self._far = FarGoals(self._config.far)
        self._local = LocalPlan(self._config, self._radius_m)
        self._looking = Looking(self._config)
        self._backing = Backing(self._config, self._radius_m)
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
        self._goals, self._final = checked, None
        self._far.drop()
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
        self._far.follow(far)

    @property
    def plan(self) -> Plan | None:
        """What it follows over the newest map."""
        return self._local.plan

    @property
    def far(self) -> GlobalPlan | None:
        """The plan over the map from orbit that `plan` leads along; None: it leads straight on."""
        return self._far.plan

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
        return path_length(np.concatenate([self._local.left(position), self._goals]))

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
        self._local.drop()
        self._looking.forget()
        self._backing.stop()
        self._progress = Progress(self._config.stuck_time_s, self._now_ns)
        self._turning_ns: int | None = None
        self._waiting.end()
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
            self._start_ns = stamp_ns
            self._progress.wait(stamp_ns)
        if not self._goals:
            return self._final or still(Status.IDLE, 'no goal')
        if self._final is not None:
            return self._final
        if stamp_ns - self._start_ns < self._config.start_delay_s * 1e9:
            self._progress.wait(stamp_ns)
            return still(Status.WAITING,
                         f'until start_delay_s {self._config.start_delay_s:g} is over')
        missing = self._waiting.missing_pose(stamp_ns, pose_ns, position_m, orientation_wxyz)
        if missing is not None:
            return self._wait_for(missing)
        position = np.asarray(position_m, float)
        rotation = matrix_from_wxyz(orientation_wxyz)
        heading = math.atan2(rotation[1, 0], rotation[0, 0])
        tilt = float(tilt_deg(rotation)) if tilt_of_imu_deg is None else tilt_of_imu_deg
        self._rearing.note_tilt(stamp_ns, tilt)
        missing = self._waiting.missing_depth(stamp_ns, grid)
        if missing is not None:
            return self._let_down() or self._wait_for(missing, heading)
        self._waiting.end()
        assert grid is not None
        if self._grid is None or grid.stamp_ns != self._grid.stamp_ns:
            self._waiting.note_seeing(heading)
        self._note_place(position)
        self._progress.note_motion(stamp_ns, position, heading)
        if not self._far.is_known:
            refused = self._plan_far(position)
            if refused is not None:
                return refused
        if tilt > _TIPPED_DEG:
            return self._fail(Failure.TILT, f'tilted by {tilt:.0f} deg, more than '
                              f'{_TIPPED_DEG:g}', position)
        reached = self._reach(position, heading)
        if reached is not None:
            return reached
        lean = rotation[:2, 2]
        if self._rearing.lasts(stamp_ns) and not self._backing.is_on:
            return self._recover(Failure.TILT, f'tilted by {tilt:.0f} deg', position, heading,
                                 lean)
        reared = self._let_down()
        if reared is not None:
            return reared
        if self._backing.is_on:
            return self._go_back(position)
        if not self._looking.stands and self._progress.is_stuck:
            return self._recover(
                Failure.STUCK, f'moved less than {STUCK_M:g} m in '
                f'{self._config.stuck_time_s:g} s', position, heading, lean)
        late = self._patience(position)
        if late is not None:
            return late
        new_map = grid is not self._grid
        self._grid = grid
        if self._looking.is_on:
            return self._go_on_looking(heading)
        if self._looking.stops(stamp_ns, position, grid.stamp_ns):
            self._progress.stand()
            return still(Status.LOOKING, 'stops and looks')
        return self._follow(position, heading, grid, new_map)

    # Far goals

    def _plan_far(self, position: Array) -> NavigatorCommand | None:
        """Plan over the map from orbit where a goal is far; return a command without a way."""
        try:
            plan = self._far.make(self._costs, position, self._goals)
        except NavigationError as error:
            return self._fail(Failure.BLOCKED, str(error), None)
        if plan is not None:
            self.notes.append(f'plans over the map from orbit: {plan.length_m:.0f} m')
        return None

    def _target(self, position: Array) -> Array:
        """Return the place (2,) that the local plan leads to."""
        return self._goals[0] if self.far is None else self.far.ahead(position)

    def _go_another_way(self, why: Failure, text: str, position: Array) -> NavigatorCommand:
        """Plan anew over the map from orbit, since no way leads along the plan; else give up."""
        if self.far is None:
            return self._fail(why, text, position)
        refused = self._far.make_anew(position)
        if refused is not None:
            return self._fail(why, text + refused, position)
        self.notes.append(f'{why.value}: {text}; another plan over the map from orbit, '
                          f'{self.far.length_m:.0f} m')
        self._looking.forget()
        self._progress.begin_anew(self._now_ns)
        return self._plan_again()

    def _wait_for(self, missing: str, heading: float | None = None) -> NavigatorCommand:
        """Stand still, or turn to where something is seen; return the command."""
        if not self._waiting.is_on:
            self.notes.append(f'stands still: {missing}')
        self._progress.stand()
        command = self._waiting.go_on(self._now_ns, missing, heading)
        if command is None:
            return self._fail(Failure.LOST, missing, None)
        if self._waiting.turns_back and self._looking.is_on:
            self._end_look()
        return command

    # Progress

    def _note_place(self, position: Array) -> None:
        """Take note of where it stands: that ground is known."""
        at = position[:2].copy()
        moved = 0.0 if self._position is None else float(np.linalg.norm(at - self._position))
        if moved > JUMP_M:
            self._begin_elsewhere(moved)
        if self._position is None or moved > JUMP_M:
            self._backing.begin_trail(at)
        else:
            self._backing.add_to_trail(at)
        self._position = at

    def _begin_elsewhere(self, moved_m: float) -> None:
        """Forget what was seen where the rover was believed to be, and plan to the same goals."""
        self.notes.append(f'the pose has jumped by {moved_m:.1f} m: plans anew')
        self._discs = []
        self._far.drop()
        self._local.forget_overview()
        self._restart()

    def _patience(self, position: Array) -> NavigatorCommand | None:
        left, patience_s = (
            (float(np.linalg.norm(self._goals[0] - position[:2])), self._config.patience_s)
            if self.far is None else (self.far.left_m(position), self._config.far.patience_s))
        if self._progress.note_left(self._now_ns, left) > patience_s:
            return self._go_another_way(
                Failure.BLOCKED, f'not nearer than {self._progress.best_m:.1f} m for '
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
        self._restart()
        return still(Status.FOLLOWING, 'goes on to the next waypoint')

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
        self._final = still(Status.ARRIVED, f'at {at}')
        self.notes.append(f'arrived at {at}')
        return self._final

    def _fail(self, why: Failure, text: str, position: Array | None) -> NavigatorCommand:
        where = '' if position is None else f' at x {position[0]:.2f} m, y {position[1]:.2f} m'
        self._final = NavigatorCommand(0.0, 0.0, Status.FAILED, f'{why.value}: {text}{where}', why)
        self.notes.append(f'gives up: {self._final.reason}')
        self._local.drop_plan()
        return self._final

    # Backing off

    def _let_down(self) -> NavigatorCommand | None:
        """Return the command that lets the body down; None where it has not reared up."""
        velocity = self._rearing.let_down(self._now_ns)
        return None if velocity is None else NavigatorCommand(
            *velocity, Status.LETTING_DOWN, 'the body has reared up')

    def _recover(self, why: Failure, text: str, position: Array, heading: float,
                 lean: Array) -> NavigatorCommand:
        """Back off, and remember what is there.

        Args:
            lean: As of `Backing.edge`.
        """
        self._progress.recoveries += 1
        if self._progress.recoveries > self._config.recoveries:
            return self._go_another_way(
                why, f'{text}, and backed off {self._config.recoveries} times', position)
        self.backed_off += 1
        edge = self._backing.edge(self._now_ns, position, heading, lean, self._goals)
        note, discs = self._backing.begin(self._now_ns, position, self._progress.heading_rad,
                                          self._local.planner, text, edge)
        self.notes.append(note)
        self._discs += discs
        self._looking.cancel()
        self._rearing.end(self._now_ns)
        return self._go_back(position) if self._backing.is_on else self._plan_again()

    def _go_back(self, position: Array) -> NavigatorCommand:
        return self._backing.go_on(self._now_ns, position, self._progress.heading_rad) \
            or self._plan_again()

    def _plan_again(self) -> NavigatorCommand:
        self._backing.stop()
        self._local.drop_plan()
        self._progress.stand()
        self._rearing.begin_anew(self._now_ns)
        return still(Status.FOLLOWING, 'plans again')

    # Looking

    def _look_at(self, place: Array, position: Array, text: str) -> NavigatorCommand:
        towards = place - position[:2]
        return self._looking.begin(self._now_ns, math.atan2(towards[1], towards[0]), text, place)

    def _look_around(self, position: Array, heading: float) -> NavigatorCommand:
        command = self._looking.begin_around(self._now_ns, heading)
        if command is None:
            return self._go_another_way(
                Failure.BLOCKED, 'no way to the goal is seen, all around', position)
        self._local.drop_plan()
        return command

    def _go_on_looking(self, heading: float) -> NavigatorCommand:
        command = self._looking.go_on(self._now_ns, heading)
        if command is not None:
            return command
        self._end_look()
        return still(Status.LOOKING, 'looks')

    def _end_look(self) -> None:
        self._discs += self._looking.end(self._now_ns)
        self._local.plan_again()
        self._progress.stand()

    def _has_looked_at(self, xy: Array) -> bool:
        return any(disc.ground is Ground.SHADOW
                   and math.hypot(disc.x_m - xy[0], disc.y_m - xy[1]) < disc.radius_m
                   for disc in self._discs)

    # Following

    def _follow(self, position: Array, heading: float, grid: Traversability,
                new_map: bool) -> NavigatorCommand:
        self._discs = [disc for disc in self._discs if disc.until_ns > self._now_ns]
        local = self._local
        instead = self._replan(position, heading, grid, new_map)
        if instead is not None:
            return instead
        dark_m, first, near_m = local.dark_ahead(position)
        if (dark_m > _LOOK_UNKNOWN_M or near_m < _CLOSE_M) and not self._has_looked_at(first):
            return self._look_at(first, position, f'{dark_m:.2f} m of the way ahead are unknown')
        steering = local.steering(position, heading, self._rearing)
        if steering is None:
            local.plan_again()
            return still(Status.FOLLOWING, 'no arc along the plan is clear')
        if steering.done:
            assert local.plan is not None
            if local.plan.off_goal_m > 0.0:
                return self._end_beside(local.plan, position)
            local.plan_again()
            return still(Status.FOLLOWING, 'plans on')
        speed, yaw_rate = steering.forward_mps, steering.yaw_rate_radps
        if near_m < _CLOSE_M and speed > self._config.creep_mps:
            yaw_rate *= self._config.creep_mps / speed
            speed = self._config.creep_mps
        return NavigatorCommand(speed, yaw_rate, Status.FOLLOWING)

    def _replan(self, position: Array, heading: float, grid: Traversability,
                new_map: bool) -> NavigatorCommand | None:
        """Make or keep a plan; return a command instead where there is none."""
        local, target = self._local, self._target(position)
        due = local.is_due(self._now_ns)
        if not (due or new_map):
            return None
        grid, notes = self._far.without_holes(grid, position)
        self.notes += notes
        old_cost = local.take(grid, position, target, (*self._backing.trail, *self._discs))
        if math.isfinite(old_cost) and not due:
            return None
        found = local.search(self._now_ns, target)
        if found is None:
            return self._look_around(position, heading)
        self._looking.found_way()
        if not np.ptp(found.points_m, axis=0).any():    # it stands there already
            return (self._end_beside(found, position) if found.off_goal_m
                    else self._look_around(position, heading))
        local.adopt(found, old_cost, position)
        return None

    def _end_beside(self, plan: Plan, position: Array) -> NavigatorCommand:
        """Look at a goal that cannot be stood on; give up if that is still so."""
        goal, planner = self._target(position), self._local.planner
        assert planner is not None
        what = ('on an obstacle' if planner.is_blocked(goal)
                else 'on ground that is not seen')
        if not self._has_looked_at(goal):
            return self._look_at(goal, position, f'the goal seems to lie {what}')
        text = (f'the goal lies {what}; the nearest place that can be reached is '
                f'{plan.off_goal_m:.2f} m from it')
        if np.array_equal(goal, self._goals[0]):
            return self._fail(Failure.BLOCKED, text, position)
        return self._go_another_way(Failure.BLOCKED, text, position)
