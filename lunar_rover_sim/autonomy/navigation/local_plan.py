"""The plan over the newest map, and how the rover is steered along it. It reads no clock."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import math

import numpy as np

from lunar_rover_sim.autonomy.navigation.config import NavigatorConfig
from lunar_rover_sim.autonomy.navigation.overview import Overview
from lunar_rover_sim.autonomy.navigation.planner import Disc, Plan, Planner
from lunar_rover_sim.autonomy.navigation.rearing import Rearing
from lunar_rover_sim.autonomy.navigation.traversability import Traversability
from lunar_rover_sim.autonomy.path_following.config import DriveConfig
from lunar_rover_sim.autonomy.path_following.driver import PurePursuit, Steering
from lunar_rover_sim.autonomy.path_following.route import Route
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.seconds import NS_PER_S

ALIGNED_RAD = math.radians(5.0)
_TURN_IN_PLACE_DEG = 60.0   # error of heading above which the rover turns in place
_PLAN_NS = NS_PER_S         # from plan to plan; at once where the way is blocked
_LOOK_AHEAD_M = 1.1         # so far a plan is to be known
_LOOKAHEAD_SHARES, _ARC_POINTS = (1.0, 0.5, 0.25), 9    # of the pursuit near obstacles
_SLOPE_DEG = 8.0            # on which it turns on an arc, not on the spot, where there is room


class LocalPlan:
    """Plans over one map after the other, keeps what serves, and steers along it.

    Attributes:
        plan: What it follows; None without one.
        planner: Of the newest map; None: it knows none.
    """

    def __init__(self, config: NavigatorConfig, radius_m: float) -> None:
        """Begin without a map.

        Args:
            radius_m: Of the circle around the rover and its spokes.
        """
        self._config, self._radius_m = config, radius_m
        self._pursuit_config = DriveConfig(
            speed_mps=config.speed_mps, max_yaw_rate_radps=config.max_yaw_rate_radps,
            lookahead_m=config.lookahead_m, turn_in_place_deg=_TURN_IN_PLACE_DEG,
            goal_tolerance_m=config.goal_tolerance_m)
        self._overview: Overview | None = None
        self.drop()

    def drop(self) -> None:
        """Forget the plan, and the map that it was made over."""
        self.drop_plan()
        self.planner: Planner | None = None

    def drop_plan(self) -> None:
        """Forget the plan, and plan again at once."""
        self.plan: Plan | None = None
        self._pursuit: PurePursuit | None = None
        self.plan_again()

    def plan_again(self) -> None:
        """Plan again at once."""
        self._planned_ns: int | None = None

    def forget_overview(self) -> None:
        """Forget what was seen beyond the map."""
        self._overview = None

    def is_due(self, now_ns: int) -> bool:
        """Return whether it is time to plan again."""
        return self._planned_ns is None or now_ns - self._planned_ns >= _PLAN_NS

    def take(self, grid: Traversability, position: Array, target: Array,
             discs: Sequence[Disc]) -> float:
        """Take in a map; return what is left of the plan over it costs; inf: it is blocked.

        Args:
            target: (2,) that plans lead to.
            discs: Ground that is known beside the map.
        """
        config = self._config
        if self._overview is None or self._overview.map_cell_m != grid.cell_m:
            self._overview = Overview(grid.cell_m, 1.0 + config.plan.unknown_cost)
        self.planner = Planner(grid, config.plan, self._radius_m, position[:2], tuple(discs),
                               self._overview, config.creep)
        self._overview.add(grid.origin_m, self.planner.blocked, self.planner.unknown,
                           self.planner.room_m)
        return (math.inf if self.plan is None
                else self.planner.cost_along(self._rest(position), target))

    def search(self, now_ns: int, target: Array) -> Plan | None:
        """Return the best plan over the map that was taken in; None: there is none."""
        assert self.planner is not None
        self._planned_ns = now_ns
        return self.planner.plan(target)

    def adopt(self, found: Plan, old_cost: float, position: Array) -> None:
        """Follow a plan if it is better than the one that is followed, of this cost."""
        if self.plan is None or found.cost < self._config.better * old_cost \
                or not math.isfinite(old_cost) or self._is_at_end(position):
            self.plan = found
            # From the place that replaces a goal it must reach the goal's own tolerance.
            tolerance = self._config.goal_tolerance_m * (0.5 if found.off_goal_m else 1.0)
            self._pursuit = PurePursuit(dataclasses.replace(
                self._pursuit_config, goal_tolerance_m=tolerance), Route(found.points_m))

    def dark_ahead(self, position: Array) -> tuple[float, Array, float]:
        """Return how much of the way just ahead is unknown [m], where that begins, how far off."""
        assert self.planner is not None
        dark_m, first = self.planner.dark_along_m(self._rest(position), 0.0, _LOOK_AHEAD_M)
        return dark_m, first, float(np.linalg.norm(first - position[:2])) if dark_m else math.inf

    def left(self, position: Array) -> Array:
        """Return the way from the rover to the end of the plan, (n, 2); n is 1 without a plan."""
        return position[None, :2] if self.plan is None else self._rest(position)

    def steering(self, position: Array, heading_rad: float, rearing: Rearing) -> Steering | None:
        """Return the steering with the longest lookahead that cuts no corner at an obstacle.

        Where no arc is clear it turns on the spot to the plan; None: it looks along it already.
        """
        assert self._pursuit is not None and self.planner is not None
        for share in _LOOKAHEAD_SHARES:
            ahead = share * self._config.lookahead_m
            steering = self._pursuit.update(position, heading_rad, ahead)
            if steering.forward_mps <= 0.0 and not steering.done:
                return self._on_an_arc(position, heading_rad, steering, rearing)
            left = max(self._pursuit.route.length_m - steering.along_m, 0.0)
            if steering.done or self.planner.is_clear(
                    _arc(position, heading_rad, steering, min(ahead, left))):
                return steering
        if abs(steering.heading_error_rad) < ALIGNED_RAD:
            return None
        return self._on_an_arc(position, heading_rad, dataclasses.replace(
            steering, forward_mps=0.0, yaw_rate_radps=math.copysign(
                self._config.max_yaw_rate_radps, steering.heading_error_rad)), rearing)

    def _on_an_arc(self, position: Array, heading_rad: float, turn: Steering,
                   rearing: Rearing) -> Steering:
        """Return a turn on the spot; on a slope, where there is room, on an arc."""
        assert self.planner is not None
        if rearing.mean_deg < _SLOPE_DEG:
            return turn
        arc = dataclasses.replace(turn, forward_mps=self._config.speed_mps)
        length = self._config.speed_mps * abs(turn.heading_error_rad / turn.yaw_rate_radps)
        clear = self.planner.is_clear(_arc(position, heading_rad, arc, length))
        return arc if clear else turn

    def _is_at_end(self, position: Array) -> bool:
        """Return whether a plan that ends before the goal is nearly driven."""
        assert self.plan is not None
        return not self.plan.reaches_goal and len(self._rest(position)) < 20

    def _rest(self, position: Array) -> Array:
        """Return what is left of the plan, from the rover on, (n, 2)."""
        assert self.plan is not None
        points = self.plan.points_m
        k = int(np.argmin(np.linalg.norm(points - position[:2], axis=1)))
        return np.concatenate([position[None, :2], points[k + 1:]]) \
            if k + 1 < len(points) else np.stack([position[:2], points[-1]])


def _arc(position: Array, heading: float, steering: Steering, length_m: float) -> Array:
    """Return (n, 2) points of the arc that a steering follows [m]."""
    along = np.linspace(0.0, length_m, _ARC_POINTS)
    angle = heading + 0.5 * along * steering.yaw_rate_radps / steering.forward_mps
    # The chord from its start is turned by half the angle of the arc, and nearly as long.
    return position[:2] + along[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
