"""Parameters of mapping, of what the rover can cross, of planning and of the navigator."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import group, param, Parameters

TRUTH, WHEELS, SLAM = 'truth', 'wheels', 'slam'
POSES = (TRUTH, WHEELS, SLAM)


@dataclasses.dataclass(frozen=True)
class MapConfig(Parameters):
    """The rolling elevation map, and how depth enters it."""

    gone = {'range_stddev_m': 0.01, 'least_hits': 2, 'contradictions': 4, 'least_share': 0.005,
            'jump_m': 0.5}

    size_m: float = param(12.8, 'side length', unit='m', low=2.0, high=51.2)
    cell_m: float = param(0.05, 'cell size', unit='m', low=0.02, high=0.5)
    min_range_m: float = param(0.3, 'nearest depth that is used', unit='m', low=0.0, high=10.0)
    max_range_m: float = param(5.0, 'farthest depth that is used', unit='m', low=0.5, high=50.0)
    disparity_stddev_px: float = param(
        0.3, 'error of a disparity: that of a depth is depth^2 / (focal length baseline) times '
        'it; 0: depth without noise', unit='px', low=0.0, high=10.0)
    grazing: float = param(
        0.6, 'steeper surfaces, which fall away by more than this share of the line of sight, '
        'are not used; 1: all are', low=0.05, high=1.0)
    hole_px: float = param(
        2.0, 'depth this near to a pixel without any is not used; of an image of 640 px, in '
        'proportion of others', unit='px', low=0.0, high=20.0)
    height_stddev_m: float = param(0.005, 'error of a height in a frame, however near', unit='m',
                                   low=1e-4, high=0.5)
    gate: float = param(3.0, 'a height that differs by more standard deviations contradicts the '
                        'map and does not enter it', low=1.0, high=20.0)
    drift: float = param(0.01, 'error of height that an estimated pose gains per metre', low=0.0,
                         high=1.0)
    level_stddev_m: float = param(
        0.02, 'error of height of an estimated pose, corrected by fitting the frame to the map; '
        '0: the pose is trusted', unit='m', low=0.0, high=1.0)
    level_stddev_deg: float = param(
        1.0, 'error of pitch and roll of the pose, corrected likewise; 0: the pose is trusted',
        unit='deg', low=0.0, high=20.0)

    def validate(self) -> None:
        """Raise ConfigError unless the map has a sensible number of cells and ranges fit it."""
        cells = self.size_m / self.cell_m
        if abs(cells - round(cells)) > 1e-6 or round(cells) % 2 or not 16 <= cells <= 1024:
            raise ConfigError(f'size_m: {self.size_m:g} is not valid with cell_m = '
                              f'{self.cell_m:g}; valid is an even number of 16 to 1024 cells')
        if self.min_range_m >= self.max_range_m:
            raise ConfigError(f'min_range_m: {self.min_range_m:g} is not valid; valid is < '
                              f'max_range_m = {self.max_range_m:g} [m]')

    def by_pose(self, pose: str) -> MapConfig:
        """Return the parameters for a source of poses: the truth needs no correction."""
        if pose != TRUTH:
            return self
        return dataclasses.replace(self, drift=0.0, level_stddev_m=0.0, level_stddev_deg=0.0)

    @property
    def cells(self) -> int:
        """Cells along a side."""
        return round(self.size_m / self.cell_m)


@dataclasses.dataclass(frozen=True)
class TraversabilityConfig(Parameters):
    """What the rover can cross; 0: the limit that follows from its description."""

    gone = {'max_roughness_m': 0.0, 'window_m': 0.0}

    max_step_m: float = param(0.0, 'greatest height over the ground around it that is crossed; '
                              '0: the belly clearance of the walk, or 0.6 of a spoke, whichever '
                              'is less', unit='m', low=0.0, high=2.0)
    max_slope_deg: float = param(16.0, 'slope that it must not cross', unit='deg', low=1.0,
                                 high=60.0)
    fill_cells: int = param(3, 'holes of a map up to twice as wide are filled from their '
                            'edges', unit='cells', low=0, high=10)


@dataclasses.dataclass(frozen=True)
class PlanConfig(Parameters):
    """Costs of a plan: a metre over free ground costs 1."""

    gone = {'blind_m': 0.6}

    margin_m: float = param(0.0, 'distance from obstacles beyond the circle around the rover and '
                            'its spokes', unit='m', low=0.0, high=2.0)
    near_m: float = param(0.35, 'distance from obstacles up to which a way costs more', unit='m',
                          low=0.0, high=5.0)
    near_cost: float = param(6.0, 'what it costs more at most', low=0.0, high=100.0)
    rough_cost: float = param(12.0, 'what ground just below the limits costs more', low=0.0,
                              high=100.0)
    unknown_cost: float = param(3.0, 'what unknown ground costs more in a plan; it is looked at '
                                'before the rover drives there', low=0.0, high=100.0)
    unknown_share: float = param(0.1, 'share of the circle around the rover and its spokes that '
                                 'may be unknown', low=0.0, high=1.0)
    start_m: float = param(0.6, 'ground this near to the start is known: the rover stands there, '
                           'and its cameras do not see it', unit='m', low=0.0, high=5.0)


@dataclasses.dataclass(frozen=True)
class GlobalPlanConfig(Parameters):
    """Costs of a plan over maps from orbit, and how the local planner follows it.

    A metre over smooth, level ground costs 1.
    """

    gone = {'slope_cost': 6.0, 'rough_m': 0.5, 'rough_cost': 2.0, 'crater_cost': 3.0,
            'dark_cost': 10.0, 'blocked_cost': 20.0}

    cell_m: float = param(5.0, 'cell of the plan', unit='m', low=1.0, high=50.0)
    max_slope_deg: float = param(20.0, 'slope over a cell that it does not cross', unit='deg',
                                 low=1.0, high=60.0)
    from_m: float = param(20.0, 'goals and legs of a route farther than this are planned over '
                          'the map from orbit', unit='m', low=1.0)
    ahead_m: float = param(8.0, 'distance along the plan to the place that the local plan leads '
                           'to', unit='m', low=0.5, high=16.0)
    patience_s: float = param(90.0, 'time without getting nearer along the plan after which it is '
                              'made anew', unit='s', low=10.0, high=1e5)
    plans: int = param(6, 'new plans within 10 m after which it gives up', low=0, high=100)


@dataclasses.dataclass(frozen=True)
class NavigatorConfig(Parameters):
    """How the navigator drives, looks, backs off and gives up."""

    gone = {'half_width_m': 0.0, 'turn_in_place_deg': 60.0, 'waypoint_tolerance_m': 0.4,
            'plan_period_s': 1.0, 'look_ahead_m': 1.1, 'look_unknown_m': 0.15, 'tilt_time_s': 0.6,
            'tipped_deg': 65.0, 'stuck_distance_m': 0.12}

    goal_x_m: float = param(0.0, 'goal at the start, x in odom', unit='m')
    goal_y_m: float = param(0.0, 'goal at the start, y in odom', unit='m')
    has_goal: bool = param(False, 'drive to goal_x_m, goal_y_m; false: wait for a goal')
    waypoints_x_m: tuple[float, ...] = param((), 'x of waypoints at the start, before the goal',
                                             unit='m')
    waypoints_y_m: tuple[float, ...] = param((), 'y of them', unit='m')
    speed_mps: float = param(0.12, 'forward speed', unit='m/s', low=0.0, open_low=True, high=2.0)
    max_yaw_rate_radps: float = param(0.15, 'greatest yaw rate', unit='rad/s', low=0.0,
                                      open_low=True, high=2.0)
    lookahead_m: float = param(0.4, 'distance along the plan to the point steered towards',
                               unit='m', low=0.0, open_low=True, high=5.0)
    goal_tolerance_m: float = param(0.2, 'a goal is reached at this distance', unit='m', low=0.0,
                                    open_low=True, high=10.0)
    goal_heading_deg: float = param(8.0, 'error of a final heading that is good enough; goals of '
                                    'NavigateToPose have one', unit='deg', low=1.0, high=180.0)
    start_delay_s: float = param(1.0, 'time at rest before the drive starts', unit='s', low=0.0,
                                 high=3600.0)
    better: float = param(0.85, 'a new plan replaces one that can still be driven if it costs '
                          'less than this share of it', low=0.0, high=1.0)
    look_s: float = param(1.5, 'time that it looks', unit='s', low=0.1, high=60.0)
    stop_every_m: float = param(0.0, 'way between stops to look, each until the map has a frame '
                                'taken at rest; 0: it looks as it walks',
                                unit='m', low=0.0, high=100.0)
    creep: bool = param(False, 'drive slowly over ground that stays unknown after a look, such '
                        'as a shadow; false: around it')
    creep_mps: float = param(0.05, 'forward speed there', unit='m/s', low=0.0, open_low=True,
                             high=2.0)
    tilt_limit_deg: float = param(28.0, 'tilt at which it backs off', unit='deg', low=5.0,
                                  high=60.0)
    stuck_time_s: float = param(8.0, 'time without motion after which it backs off', unit='s',
                                low=0.5, high=600.0)
    back_off_m: float = param(0.3, 'way back', unit='m', low=0.05, high=5.0)
    recoveries: int = param(6, 'times that it backs off without getting a metre nearer before it '
                            'gives up', low=0, high=100)
    patience_s: float = param(240.0, 'time without getting nearer after which it gives up',
                              unit='s', low=10.0, high=1e5)
    lost_s: float = param(10.0, 'time without a pose, or without depth after a look around, at '
                          'which it gives up; it stands still meanwhile', unit='s',
                          low=0.1, high=600.0)
    pose_age_s: float = param(0.5, 'age at which a pose counts as missing', unit='s', low=0.05,
                              high=10.0)
    map_age_s: float = param(1.5, 'age of the newest depth at which a map counts as missing',
                             unit='s', low=0.2, high=600.0)
    border_m: float = param(1.0, 'goals nearer than this to the edge of the world are refused',
                            unit='m', low=0.0, high=100.0)
    plan: PlanConfig = group(PlanConfig)
    far: GlobalPlanConfig = group(GlobalPlanConfig)

    def validate(self) -> None:
        """Raise ConfigError if lists differ in length."""
        if len(self.waypoints_x_m) != len(self.waypoints_y_m):
            raise ConfigError(f'waypoints_y_m: {len(self.waypoints_y_m)} elements given; valid is '
                              f'{len(self.waypoints_x_m)}, as many as waypoints_x_m')

    @property
    def goals(self) -> tuple[tuple[float, float], ...]:
        """The waypoints and the goal at the start, in order."""
        end = ((self.goal_x_m, self.goal_y_m),) if self.has_goal else ()
        return (*zip(self.waypoints_x_m, self.waypoints_y_m), *end)
