"""What was seen is kept beyond the rolling map, and costs there what it costs on the map."""

import numpy as np
import pytest

from lunar_rover_sim.autonomy.navigation.command import Status
from lunar_rover_sim.autonomy.navigation.config import NavigatorConfig, PlanConfig
from lunar_rover_sim.autonomy.navigation.navigator import Navigator
from lunar_rover_sim.autonomy.navigation.overview import Overview, WALL_COST
from lunar_rover_sim.autonomy.navigation.planner import Planner
from lunar_rover_sim.autonomy.navigation.traversability import Traversability
from lunar_rover_sim.base.frames import wxyz_from_rpy

CELL, N = 0.05, 128     # windows of 6.4 m


def seen(overview, x_m, y_m, *walls, known=True):
    """Add a window around x, y with boxes (x0, x1, y0, y1) [m] that block."""
    origin = np.round(np.array([x_m, y_m]) / CELL) * CELL - 3.2
    blocked = np.zeros((N, N), bool)
    x, y = (origin[k] + (np.arange(N) + 0.5) * CELL for k in (0, 1))
    for x0, x1, y0, y1 in walls:
        blocked |= ((y >= y0) & (y < y1))[:, None] & ((x >= x0) & (x < x1))
    overview.add(origin, blocked, np.full((N, N), not known), 0.15)
    return overview


def test_a_wall_that_has_rolled_off_the_map_costs_the_way_around_it():
    overview = seen(Overview(CELL, 1.0), 0.0, 0.0, (2.0, 2.5, -3.2, 1.0))
    seen(overview, -3.0, 0.0)
    straight, past = overview.detour_m([(-1.0, -1.0), (-1.0, 3.0)], (5.0, -1.0))
    # Over the upper end at y = 1: 2 m aside and back, of eight directions, which is 0.41 of each.
    assert straight == pytest.approx(2.0 * 0.414 * 2.0, abs=0.4)
    assert past < 0.2
    assert overview.detour_m([(-1.0, -1.0)], (1.0, -1.0)) == pytest.approx([0.0], abs=1e-9)


def test_ground_that_no_map_knows_costs_the_same_everywhere():
    overview = seen(Overview(CELL, 4.0), 0.0, 0.0, known=False)
    assert overview.detour_m([(0.1, 0.1), (0.1, 7.1)], (10.1, 0.1)) == pytest.approx(
        [30.0, 3.0 * (10.0 + 0.414 * 7.0)], rel=1e-3)
    seen(overview, 0.0, 0.0)
    # Three metres of the way are known to be free now.
    assert overview.detour_m([(0.1, 0.1)], (10.1, 0.1)) == pytest.approx([21.0], abs=0.7)


def test_a_rover_near_an_edge_of_the_map_does_not_turn_back_to_leave_it():
    unknown = Traversability(1, np.array([-3.2, -3.2]), CELL, np.full((N, N), -1, np.int8))
    config = PlanConfig()
    overview = Overview(CELL, 1.0 + config.unknown_cost)
    planner = Planner(unknown, config, 0.1, (-2.6, 0.0), overview=overview)
    overview.add(unknown.origin_m, planner.blocked, planner.unknown, planner.room_m)
    assert planner.plan((7.0, 0.0)).points_m[-1, 0] > 3.1


def test_what_the_map_does_not_know_is_what_it_was():
    wall = (1.0, 1.4, -2.0, 2.0)
    overview = seen(Overview(CELL, 4.0), 0.0, 0.0, wall)
    seen(overview, 5.0, 0.0)
    again = Traversability(1, np.array([-3.2, -3.2]), CELL, np.full((N, N), -1, np.int8))
    plan = Planner(again, PlanConfig(near_cost=0.0), 0.1, (-1.0, 0.0),
                   overview=overview).plan((3.0, 0.0))
    at_wall = (plan.points_m[:, 0] > 1.0) & (plan.points_m[:, 0] < 1.4)
    assert np.abs(plan.points_m[at_wall, 1]).min() > 1.9
    x = np.array([0.5, 1.2, 40.0])
    assert overview.closed_at(x, np.array([0.0])).tolist() == [[False, True, False]]


def test_a_free_look_takes_an_obstacle_back():
    overview = seen(Overview(CELL, 1.0), 0.0, 0.0, (1.0, 1.4, -2.0, 2.0))
    assert overview.detour_m([(-1.0, 0.0)], (3.0, 0.0))[0] > 0.5
    seen(overview, 0.0, 0.0)
    assert overview.detour_m([(-1.0, 0.0)], (3.0, 0.0)) == pytest.approx([0.0], abs=1e-9)


def test_a_map_that_was_begun_anew_begins_it_anew():
    overview = seen(Overview(CELL, 1.0), 0.0, 0.0, (2.0, 2.4, -3.0, 3.0))
    seen(overview, -2.0, 0.0)
    assert overview.detour_m([(0.0, 0.0)], (4.0, 0.0))[0] > 1.0
    seen(overview, -2.0, 0.0, known=False)
    assert overview.detour_m([(0.0, 0.0)], (4.0, 0.0)) == pytest.approx([0.0], abs=1e-9)


@pytest.mark.parametrize('goal_m', [(2.5, 0.5), (5.0, 0.5)])
def test_a_goal_behind_a_wall_across_the_map_is_approached_at_its_edge(goal_m):
    """The way around the wall, if there is one, lies beyond the map, and so may the goal."""
    cost = np.zeros((N, N), np.int8)
    cost[:, round(4.2 / CELL):round(4.6 / CELL)] = 100       # x from 1.0 to 1.4 m
    grid, overview = Traversability(1, np.array([-3.2, -3.2]), CELL, cost), Overview(CELL, 4.0)
    planner = Planner(grid, PlanConfig(), 0.1, (-1.0, 0.0), overview=overview)
    overview.add(grid.origin_m, planner.blocked, planner.unknown, planner.room_m)
    plan = planner.plan(goal_m)
    assert plan is not None and not plan.reaches_goal and plan.off_goal_m == 0.0
    # At the end of the wall that is nearer to the goal, on this side of it.
    assert plan.points_m[-1, 1] > 3.1 and -1.0 < plan.points_m[-1, 0] < 1.0


def test_an_obstacle_is_dear_but_not_the_end():
    """Wrong matches may enclose a goal: the rover goes and looks."""
    overview = seen(Overview(CELL, 1.0), 0.0, 0.0, (1.0, 3.0, 1.0, 1.4), (1.0, 3.0, -1.4, -1.0),
                    (1.0, 1.4, -1.4, 1.4), (2.6, 3.0, -1.4, 1.4))
    assert overview.detour_m([(0.0, 0.0)], (2.0, 0.0)) == pytest.approx(
        [0.4 * WALL_COST], rel=0.1)


def test_a_bay_is_left_and_not_entered_again():
    """The wall at its end has rolled off the map of 4.8 m before the rover is out of the bay."""
    half = 8.0
    n = round(2.0 * half / CELL)
    world = np.zeros((n, n), np.int8)
    for x0, x1, y0, y1 in ((3.0, 3.3, -2.5, 2.5), (-1.5, 3.3, 2.5, 2.8), (-1.5, 3.3, -2.8, -2.5)):
        r0, r1, c0, c1 = (round((v + half) / CELL) for v in (y0, y1, x0, x1))
        world[r0:r1, c0:c1] = 100
    middle = -half + (np.arange(n) + 0.5) * CELL
    known = np.zeros((n, n), bool)
    navigator = Navigator(NavigatorConfig(has_goal=True, goal_x_m=6.0, start_delay_s=0.0), 0.113)
    x, y, yaw, way, size = 0.0, 0.0, 0.0, 0.0, 96
    for k in range(3000):
        now = k * 100_000_000
        if k % 5 == 0:
            ahead = (middle - x) * np.cos(yaw) + (middle[:, None] - y) * np.sin(yaw)
            aside = (middle[:, None] - y) * np.cos(yaw) - (middle - x) * np.sin(yaw)
            known |= (ahead > 0.0) & (ahead < 2.2) & (np.abs(aside) < 0.6 + 0.6 * ahead)
            column, row = (int(np.clip(round((v + half) / CELL) - size // 2, 0, n - size))
                           for v in (x, y))
            part = np.s_[row:row + size, column:column + size]
            grid = Traversability(now, np.array([column, row]) * CELL - half, CELL,
                                  np.where(known[part], world[part], -1).astype(np.int8))
        command = navigator.update(now, now, (x, y, 0.0), wxyz_from_rpy(0.0, 0.0, yaw), grid)
        if command.status.is_end:
            break
        yaw += 0.1 * command.yaw_rate_radps
        x += 0.1 * command.forward_mps * np.cos(yaw)
        y += 0.1 * command.forward_mps * np.sin(yaw)
        way += 0.1 * abs(command.forward_mps)
    assert command.status is Status.ARRIVED
    # Out of the bay and around an arm are 14.5 m.
    assert way < 20.0
