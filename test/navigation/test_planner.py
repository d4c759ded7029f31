"""Plans over maps: around obstacles, to the edge, and none where there is none."""

import numpy as np
import pytest

from lunar_rover_sim.navigation.config import PlanConfig
from lunar_rover_sim.navigation.planner import Disc, Planner
from lunar_rover_sim.navigation.traversability import Traversability

PLAIN = PlanConfig(near_cost=0.0, rough_cost=0.0)
HALF_M = 0.1


def grid(*walls, value=100, n=128):
    """Return a map of 6.4 m around 0 with boxes (x0, x1, y0, y1) [m] of a cost."""
    cost = np.zeros((n, n), np.int8)
    for x0, x1, y0, y1 in walls:
        r0, r1, c0, c1 = (round((v + 3.2) / 0.05) for v in (y0, y1, x0, x1))
        cost[r0:r1, c0:c1] = value
    return Traversability(1, np.array([-3.2, -3.2]), 0.05, cost)


def test_over_free_ground_the_plan_is_nearly_straight():
    plan = Planner(grid(), PLAIN, HALF_M, (-2.0, -1.0)).plan((2.0, 1.4))
    assert plan.reaches_goal and tuple(plan.points_m[-1]) == (2.0, 1.4)
    assert plan.length_m < 1.09 * np.hypot(4.0, 2.4)     # steps of eight directions: 8 %


def test_a_wall_is_driven_around_at_the_distance_of_the_rover():
    wall = (-0.1, 0.1, -3.2, 1.0)
    plan = Planner(grid(wall), PLAIN, HALF_M, (-2.0, 0.0)).plan((2.0, 0.0))
    x, y = plan.points_m.T
    apart = np.hypot(np.maximum(np.abs(x) - 0.1, 0.0), np.maximum(y - 1.0, 0.0))
    assert np.where(y < 1.0, np.abs(x) - 0.1, apart).min() > HALF_M + PLAIN.margin_m - 0.07
    assert 4.4 < plan.length_m < 5.2


def test_a_goal_beyond_the_map_is_approached_at_its_edge():
    wall = (0.5, 0.7, -1.0, 3.2)
    plan = Planner(grid(wall), PLAIN, HALF_M, (0.0, 0.0)).plan((20.0, 4.0))
    assert not plan.reaches_goal and plan.off_goal_m == 0.0
    assert np.abs(plan.points_m[-1]).max() > 3.1
    assert plan.points_m[:, 1].min() < -1.0


def test_an_enclosed_goal_has_no_plan_and_one_on_a_rock_has_the_place_beside_it():
    ring = [(1.0, 3.0, -1.0, -0.8), (1.0, 3.0, 0.8, 1.0), (1.0, 1.2, -1.0, 1.0),
            (2.8, 3.0, -1.0, 1.0)]
    assert Planner(grid(*ring, n=128), PLAIN, 0.1, (-2.0, 0.0)).plan((2.0, 0.0)) is None
    rock = (1.9, 2.1, -0.1, 0.1)
    plan = Planner(grid(rock), PLAIN, HALF_M, (0.0, 0.0)).plan((2.0, 0.0))
    assert not plan.reaches_goal
    assert 0.2 < plan.off_goal_m < 0.35
    assert Planner(grid(), PLAIN, HALF_M, (9.0, 0.0)).plan((0.0, 0.0)) is None


def test_unknown_ground_costs_more_and_is_told():
    shadow = grid((0.6, 1.6, -0.4, 0.3), value=-1)
    planner = Planner(shadow, PLAIN, HALF_M, (-1.0, 0.0))
    around = planner.plan((2.5, 0.0)).points_m
    inside = (np.abs(around[:, 0] - 1.1) < 0.45) & (np.abs(around[:, 1] + 0.05) < 0.3)
    assert not inside.any()
    straight = np.stack([np.linspace(-1.0, 2.5, 50), np.zeros(50)], axis=-1)
    unknown_m, first = planner.unknown_along_m(straight, 0.3, 3.0)
    assert unknown_m == pytest.approx(1.0, abs=0.1)
    assert first == pytest.approx((0.6, 0.0), abs=0.1)
    # Right before the rover it counts as free: its cameras do not see there.
    near = Planner(shadow, PLAIN, HALF_M, (0.5, 0.0))
    assert near.unknown_along_m(straight[22:], 0.0, 0.5)[0] == 0.0


def test_discs_are_obstacles_or_cost_and_a_rover_that_stands_in_one_leaves_it():
    bump = Disc(0.5, 0.0, 0.2, float('inf'), 10)
    planner = Planner(grid(), PLAIN, HALF_M, (0.0, 0.0), (bump,))
    plan = planner.plan((2.0, 0.0))
    assert np.hypot(*(plan.points_m - (0.5, 0.0)).T).min() > 0.25
    straight = np.stack([np.linspace(0.0, 2.0, 50), np.zeros(50)], axis=-1)
    assert planner.cost_along(straight, (2.0, 0.0)) == float('inf')
    inside = Planner(grid((-0.1, 0.1, -0.1, 0.1)), PLAIN, HALF_M, (0.0, 0.0))
    assert inside.plan((2.0, 0.0)).reaches_goal


def test_the_cost_of_a_plan_is_that_along_it():
    planner = Planner(grid((0.5, 1.0, -1.0, 1.0), value=60), PlanConfig(), HALF_M, (-2.0, 0.0))
    plan = planner.plan((2.0, 0.2))
    assert planner.cost_along(plan.points_m, (2.0, 0.2)) == pytest.approx(plan.cost, rel=0.1)


def test_a_rover_beside_a_rock_does_not_drive_onto_it():
    """It stands within its margin of the rock, 0.15 m before it; the goal is on it."""
    plan = Planner(grid((0.15, 0.6, -0.6, 0.6)), PLAIN, HALF_M, (0.0, 0.0)).plan((0.2, 0.0))
    assert plan is not None and not plan.reaches_goal and plan.off_goal_m > 0.04
    assert plan.points_m[:, 0].max() < 0.15
