"""Far goals: a point rover on ground that a map from orbit shows in part, its sight the rest."""

import numpy as np
import pytest

from lunar_rover_sim.autonomy.navigation.command import Failure, Status
from lunar_rover_sim.autonomy.navigation.config import GlobalPlanConfig, NavigatorConfig
from lunar_rover_sim.autonomy.navigation.global_plan import GlobalPlan, GroundCosts
from lunar_rover_sim.autonomy.navigation.navigator import Navigator
from lunar_rover_sim.autonomy.navigation.traversability import Traversability
from lunar_rover_sim.base.errors import NavigationError
from lunar_rover_sim.base.frames import wxyz_from_rpy
from lunar_rover_sim.ground.world.orbital_map import MappedCraters, OrbitalConfig, OrbitalMap

CELL, N, HALF_M = 0.2, 64, 80.0         # a map of 12.8 m that rolls over 160 m
PERIOD_NS = 200_000_000
EXACT = OrbitalConfig(pixel_m=5.0, height_stddev_m=0.0, bias_stddev_m=0.0, tilt_stddev_deg=0.0)


def from_orbit(*holes, walls=()):
    """Costs of a flat map of 160 m; holes and steep walls are boxes x0, x1, y0, y1 [m]."""
    n = round(2.0 * HALF_M / EXACT.pixel_m)
    heights, first = np.zeros((n, n), np.float32), 0.5 * (1 - n) * EXACT.pixel_m
    for boxes, value in ((walls, 20.0), (holes, np.nan)):
        for x0, x1, y0, y1 in boxes:
            r0, r1, c0, c1 = (round((v + HALF_M) / EXACT.pixel_m) for v in (y0, y1, x0, x1))
            heights[r0:r1, c0:c1] = value
    none = MappedCraters(np.zeros((0, 2)), np.zeros(0))
    return GroundCosts.of(OrbitalMap(heights, (first, first), none, np.zeros((0, 0), np.uint8),
                                     (0.0, 0.0), EXACT))


class Drive:
    """A point that does what it is told, on ground with walls that are seen from near alone."""

    def __init__(self, costs, goal, *walls, start=(-40.0, 0.0), off_m=(0.0, 0.0), **values):
        self.asked = 0
        # Off by so much it believes to be, until its place is found after 15 m.
        self.off_m = np.array(off_m)
        self.cost = np.zeros((round(2.0 * HALF_M / CELL),) * 2, np.int8)
        for x0, x1, y0, y1 in walls:
            r0, r1, c0, c1 = (round((v + HALF_M) / CELL) for v in (y0, y1, x0, x1))
            self.cost[r0:r1, c0:c1] = 100

        def asked(_places):
            self.asked += 1
            return costs

        config = NavigatorConfig(**{'has_goal': True, 'goal_x_m': goal[0], 'goal_y_m': goal[1],
                                    'start_delay_s': 0.0, 'speed_mps': 0.5,
                                    'max_yaw_rate_radps': 0.6, 'look_s': 0.5, **values})
        self.navigator = Navigator(config, 0.2, HALF_M, asked)
        self.way, self.yaw, self.notes, self.far = [np.array(start)], 0.0, [], []

    def drive(self, seconds=1200.0):
        navigator, (x, y) = self.navigator, self.way[0]
        for k in range(round(seconds / (PERIOD_NS * 1e-9))):
            now = k * PERIOD_NS
            if k % 3 == 0:
                column, row = (round((v + HALF_M) / CELL) - N // 2 for v in (x, y))
                part = self.cost[row:row + N, column:column + N]
                if self.off_m.any() and self.way_m > 15.0:
                    self.off_m = np.zeros(2)
                grid = Traversability(now, np.array([column, row]) * CELL - HALF_M + self.off_m,
                                      CELL, part)
            command = navigator.update(now, now, (*(np.array([x, y]) + self.off_m), 0.0),
                                       wxyz_from_rpy(0.0, 0.0, self.yaw), grid)
            if navigator.far is not None:
                if not self.far or self.far[-1] is not navigator.far.points_m:
                    self.far.append(navigator.far.points_m)
            if command.status.is_end:
                break
            self.yaw += PERIOD_NS * 1e-9 * command.yaw_rate_radps
            x += PERIOD_NS * 1e-9 * command.forward_mps * np.cos(self.yaw)
            y += PERIOD_NS * 1e-9 * command.forward_mps * np.sin(self.yaw)
            self.way.append(np.array([x, y]))
        self.notes += navigator.notes
        return command

    @property
    def way_m(self):
        return np.linalg.norm(np.diff(self.way, axis=0), axis=1).sum()


def test_a_far_goal_is_reached_along_a_plan_over_the_map_from_orbit():
    """Steep ground that is seen from orbit alone: the way leads around it from the start on."""
    drive = Drive(from_orbit(walls=[(-30.0, -20.0, -10.0, 60.0)]), (-5.0, 0.0))
    end = drive.drive()
    assert end.status is Status.ARRIVED and drive.asked == 1 and len(drive.far) == 1
    way = np.array(drive.way)
    assert way[np.abs(way[:, 0] + 25.0) < 5.0, 1].max() < -10.0
    assert drive.way_m < 1.1 * drive.navigator.far.length_m


def test_a_place_that_is_found_on_the_way_makes_another_plan_to_the_same_goal():
    """Its belief was 20 m off, so that the wall that is known from orbit seemed elsewhere."""
    walls = [(-10.0, -5.0, -30.0, 15.0)]
    drive = Drive(from_orbit(walls=walls), (20.0, 0.0), *walls, off_m=(12.0, -16.0))
    end = drive.drive()
    assert end.status is Status.ARRIVED, end
    assert np.linalg.norm(drive.way[-1] - (20.0, 0.0)) < 0.3
    assert [note for note in drive.notes if note.startswith('the pose has jumped by ')]
    assert len(drive.far) == 2 and drive.way_m < 110.0


def test_a_near_goal_is_driven_to_as_without_a_map():
    drive = Drive(from_orbit(walls=[(-30.0, -25.0, -5.0, 5.0)]), (-22.0, 0.0))
    assert drive.drive().status is Status.ARRIVED
    assert drive.asked == 0 and drive.navigator.far is None
    assert drive.way_m < 19.0


def test_way_points_are_passed_in_their_order():
    drive = Drive(from_orbit(), (0.0, 0.0), waypoints_x_m=(-25.0, -10.0),
                  waypoints_y_m=(15.0, -15.0))
    assert drive.drive().status is Status.ARRIVED
    apart = [np.linalg.norm(np.array(drive.way) - p, axis=1) for p in ((-25, 15), (-10, -15))]
    assert max(d.min() for d in apart) < 0.4 and apart[0].argmin() < apart[1].argmin()
    assert drive.navigator.left_m((0.0, 0.0)) < 1.0


def test_what_is_seen_from_near_alone_makes_another_plan():
    """A wall that is longer than the rover sees; its ends are 15 m beside the way."""
    drive = Drive(from_orbit(), (-10.0, 0.0), (-30.0, -29.4, -15.0, 15.0),
                  far=GlobalPlanConfig(patience_s=30.0))
    end = drive.drive(600.0)
    assert end.status is Status.ARRIVED, end
    assert len(drive.far) > 1 and drive.way_m < 110.0


def test_it_gives_up_after_so_many_plans_at_one_place():
    """The start is enclosed by what is not seen from orbit."""
    box = [(-44.0, -36.0, 3.5, 4.0), (-44.0, -36.0, -4.0, -3.5), (-44.0, -43.5, -4.0, 4.0),
           (-36.5, -36.0, -4.0, 4.0)]
    drive = Drive(from_orbit(), (40.0, 0.0), *box, far=GlobalPlanConfig(plans=3))
    end = drive.drive()
    assert end.failure is Failure.BLOCKED and 'made 3 plans within 10 m' in end.reason
    assert len(drive.far) == 4
    way = np.array(drive.way)
    assert np.abs(way - (-40.0, 0.0)).max() < 3.6


def test_ground_without_heights_is_not_driven_and_that_is_said():
    """A hole that begins a metre beside the way: a wall leads the rover towards it."""
    costs = from_orbit((-30.0, -20.0, 5.0, 60.0))
    drive = Drive(costs, (-10.0, 2.0), (-25.0, -24.5, -1.0, 4.0), start=(-40.0, 2.0))
    assert drive.drive().status is Status.ARRIVED
    way = np.array(drive.way)
    assert all(costs.has_ground(x, y) for x, y in way)
    assert any('the map from orbit has no heights there' in note for note in drive.notes)


@pytest.mark.parametrize('goal, said', [
    ((90.0, 0.0), 'x 90 m, y 0 m is outside the world; valid is within +-79 m'),
    ((40.0, 0.0), 'x 40 m, y 0 m is in a hole of the map'),
    ((-30.0, 60.0), 'no way leads from x -40 m, y 0 m to x -30 m, y 60 m'),
])
def test_goals_that_no_way_leads_to_are_refused_with_numbers(goal, said):
    costs = from_orbit((30.0, 50.0, -10.0, 10.0), (-80.0, 80.0, 30.0, 40.0))
    try:
        end = Drive(costs, goal).drive().reason
    except NavigationError as error:
        end = str(error)
    assert said in end


def test_a_plan_of_ones_own_is_followed():
    costs = from_orbit()
    drive = Drive(costs, (-30.0, 0.0))
    drive.navigator.follow(GlobalPlan(costs, (-40.0, 0.0), [(-20.0, 20.0), (0.0, 0.0)]))
    assert drive.drive().status is Status.ARRIVED
    assert np.linalg.norm(drive.way[-1]) < 0.3 and drive.asked == 0
