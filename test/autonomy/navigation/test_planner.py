"""What ground costs, and plans over it."""

import dataclasses
import math

import numpy as np
import pytest

from lunar_rover_sim.autonomy.navigation.config import PlanConfig, TraversabilityConfig
from lunar_rover_sim.autonomy.navigation.elevation_map import Elevation
from lunar_rover_sim.autonomy.navigation.planner import Disc, Ground, Planner
from lunar_rover_sim.autonomy.navigation.traversability import (belly_clearance_m, LETHAL, Limits,
                                                                Traversability, traversability,
                                                                UNKNOWN)
from lunar_rover_sim.rover.description import load_rover

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
    assert 0.15 < plan.off_goal_m < 0.35
    assert Planner(grid(), PLAIN, HALF_M, (9.0, 0.0)).plan((0.0, 0.0)) is None


def test_a_goal_on_what_seems_an_obstacle_amid_unknown_ground_is_approached():
    """From afar a rock in the dark is one cell; the ground around it was never looked at."""
    seen = grid((0.5, 3.2, -3.2, 3.2), value=UNKNOWN)
    seen.cost[64:66, 104:106] = LETHAL
    plan = Planner(seen, PLAIN, HALF_M, (-1.0, 0.0)).plan((2.05, 0.05))
    assert plan is not None and 0.0 < plan.off_goal_m < 0.3


def test_unknown_ground_costs_more_and_is_told():
    shadow = grid((0.6, 1.6, -0.4, 0.3), value=-1)
    planner = Planner(shadow, PLAIN, HALF_M, (-1.0, 0.0))
    around = planner.plan((2.5, 0.0)).points_m
    inside = (np.abs(around[:, 0] - 1.1) < 0.45) & (np.abs(around[:, 1] + 0.05) < 0.3)
    assert not inside.any()
    straight = np.stack([np.linspace(-1.0, 2.5, 50), np.zeros(50)], axis=-1)
    dark_m, first = planner.dark_along_m(straight, 0.3, 3.0)
    # Wherever a tenth of the circle around the rover lies on it.
    assert dark_m == pytest.approx(1.0 + HALF_M, abs=0.11)
    assert first == pytest.approx((0.6 - 0.5 * HALF_M, 0.0), abs=0.1)
    # Where it stands the ground is known: its cameras do not see there.
    near = Planner(shadow, PLAIN, HALF_M, (0.8, 0.0), (Disc(0.8, 0.0, 0.5, Ground.STOOD),))
    assert near.dark_along_m(np.array([[0.8, 0.0], [1.1, 0.0]]), 0.0, 0.3)[0] == 0.0


def test_discs_are_obstacles_or_cost_and_a_rover_that_stands_in_one_leaves_it():
    bump = Disc(0.5, 0.0, 0.2, Ground.BUMP)
    planner = Planner(grid(), PLAIN, HALF_M, (0.0, 0.0), (bump,))
    plan = planner.plan((2.0, 0.0))
    assert np.hypot(*(plan.points_m - (0.5, 0.0)).T).min() > 0.25
    straight = np.stack([np.linspace(0.0, 2.0, 50), np.zeros(50)], axis=-1)
    assert planner.cost_along(straight, (2.0, 0.0)) == float('inf')
    inside = Planner(grid((-0.1, 0.1, -0.1, 0.1)), PLAIN, 3.0 * HALF_M, (0.0, 0.0))
    assert inside.plan((2.0, 0.0)).reaches_goal


def test_a_disc_from_beyond_the_map_closes_what_of_it_lies_on_the_map():
    def lethal(*places):
        discs = tuple(Disc(x, y, 0.5, Ground.BUMP) for x, y in places)
        return Planner(grid(), PLAIN, HALF_M, (0.0, 0.0), discs).lethal

    rows, columns = np.nonzero(lethal((3.5, 0.0)))
    x, y = -3.175 + 0.05 * columns, -3.175 + 0.05 * rows
    assert len(x) and np.hypot(x - 3.5, y).max() <= 0.5
    assert not lethal((3.8, 0.0), (0.0, -3.8), (300.0, 0.0)).any()


def test_the_cost_of_a_plan_is_that_of_its_ground_and_of_the_rest_beyond_the_map():
    plan = Planner(grid(), PlanConfig(), HALF_M, (-2.0, 0.0)).plan((2.0, 0.0))
    assert plan.cost == pytest.approx(4.0, rel=0.01)
    everywhere = grid((-3.2, 3.2, -3.2, 3.2), value=33)     # of 99
    rough = Planner(everywhere, PlanConfig(rough_cost=6.0), HALF_M, (-2.0, 0.0))
    assert rough.plan((2.0, 0.0)).cost == pytest.approx(4.0 * 3.0, rel=0.01)
    beside = Planner(everywhere, PlanConfig(rough_cost=6.0), HALF_M, (2.0, 0.0))
    assert beside.plan((10.0, 0.0)).cost == pytest.approx(1.2 * 3.0 + 6.8, rel=0.02)


def test_a_rover_beside_a_rock_does_not_drive_onto_it():
    """It stands within its margin of the rock, 0.15 m before it; the goal is on it."""
    plan = Planner(grid((0.15, 0.6, -0.6, 0.6)), PLAIN, HALF_M, (0.0, 0.0)).plan((0.2, 0.0))
    assert plan is not None and not plan.reaches_goal and plan.off_goal_m > 0.04
    assert plan.points_m[:, 0].max() < 0.15


LIMITS = Limits.of(load_rover(None), TraversabilityConfig())


def elevation(height, known=None):
    values = np.broadcast_to(np.asarray(height, np.float32), (64, 64)).copy()
    if known is not None:
        values[~known] = np.nan
    variance = np.where(np.isfinite(values), np.float32(1e-8), np.float32(np.nan))
    return Elevation(7, np.array([-1.6, -1.6]), 0.05, values, variance)


def rock(height_m, width=2):
    values = np.zeros((64, 64), np.float32)
    values[30:30 + width, 30:30 + width] = height_m
    return elevation(values)


def test_the_limits_are_those_of_the_rover():
    rover = load_rover(None)
    # Spokes of 8 cm, 30 degrees from the vertical at most; the chassis hangs 2 cm below the axle.
    assert belly_clearance_m(rover) == pytest.approx(0.08 * math.cos(math.pi / 6) - 0.02)
    assert LIMITS.step_m == pytest.approx(0.048)
    assert LIMITS.radius_m == pytest.approx(0.232, abs=1e-3)
    longer = dataclasses.replace(rover, legs=dataclasses.replace(rover.legs, spoke_length_m=0.16))
    assert Limits.of(longer, TraversabilityConfig()).step_m > 0.09
    assert Limits.of(rover, TraversabilityConfig(max_step_m=0.1)).step_m == 0.1


@pytest.mark.parametrize('height_m, lethal', [(0.02, False), (0.035, False), (0.06, True),
                                              (0.3, True), (-0.08, True)])
def test_rocks_and_holes_are_judged_by_their_height(height_m, lethal):
    grid = traversability(rock(height_m), LIMITS)
    assert (grid.cost[30:32, 30:32] == LETHAL).all() == lethal
    assert (grid.cost == LETHAL).any() == lethal
    assert grid.cost[5, 5] == 0 and grid.stamp_ns == 7


def test_a_low_rock_costs_more_than_the_plain():
    cost = traversability(rock(0.035), LIMITS).cost
    assert cost[30, 30] > 20 > cost[50, 50]


@pytest.mark.parametrize('slope_deg, lethal', [(10.0, False), (15.0, False), (18.0, True)])
def test_slopes(slope_deg, lethal):
    x = np.arange(64) * 0.05 * math.tan(math.radians(slope_deg))
    cost = traversability(elevation(np.broadcast_to(x, (64, 64))), LIMITS).cost
    assert (cost[10:-10, 10:-10] == LETHAL).all() == lethal


def test_unknown_is_unknown_but_small_holes_are_filled():
    known = np.ones((64, 64), bool)
    known[20:22, 20:22] = False
    known[40:60, 40:60] = False
    known[5:38, 30:36] = False      # a shadow
    known[:, :4] = False            # what lies beyond what was seen
    cost = traversability(elevation(0.0, known), LIMITS).cost
    assert (cost[20:22, 20:22] == 0).all()
    assert (cost[5:38, 30:36] == 0).all()
    assert (cost[:, :4] == UNKNOWN).all()
    assert (cost[45:55, 45:55] == UNKNOWN).all()
    nothing = traversability(elevation(0.0, np.zeros((64, 64), bool)), LIMITS).cost
    assert (nothing == UNKNOWN).all()


def test_heights_that_may_be_errors_forbid_nothing():
    high = rock(0.06)
    unsure = dataclasses.replace(high, variance_m2=np.full((64, 64), 0.03 ** 2, np.float32))
    assert not (traversability(unsure, LIMITS).cost == LETHAL).any()


def test_costs_are_those_of_a_plane_fitted_to_each_square():
    """Sums that move along give what a fit at each cell gives, holes and edges included."""
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.arange(40.0), np.arange(40.0))
    height = 0.006 * x - 0.004 * y + 0.006 * rng.standard_normal(x.shape)
    height[rng.random(x.shape) < 0.25] = np.nan
    values = height.astype(np.float32)
    found = traversability(Elevation(0, np.zeros(2), 0.05, values, 0.0 * values), LIMITS, 0).cost
    half = round(0.5 * LIMITS.window_m / 0.05)
    known, compared = np.isfinite(values), 0
    for r, c in np.argwhere(known):
        box = np.s_[max(r - half, 0):r + half + 1, max(c - half, 0):c + half + 1]
        near = np.s_[max(r - 1, 0):r + 2, max(c - 1, 0):c + 2]
        chosen = known[box]
        if np.count_nonzero(chosen) < 0.4 * (2 * half + 1) ** 2:
            assert found[r, c] in (UNKNOWN, LETHAL)
            continue
        z = values[box][chosen].astype(float)
        A = np.column_stack([x[box][chosen] - c, y[box][chosen] - r, np.ones(len(z))])
        fit = np.linalg.lstsq(A, z, rcond=None)[0]
        slope = np.hypot(*fit[:2]) / 0.05
        roughness = np.sqrt(np.mean((z - A @ fit) ** 2)) / LIMITS.roughness_m
        relief = np.nanmax(values[near]) - np.nanmin(values[near]) - 0.1 * slope
        step = max(abs(values[r, c] - fit[2]), relief) / LIMITS.step_m
        worst = max(step, slope / LIMITS.slope, min(roughness, 0.95))
        # The fit of the package is drawn towards level ground by a hundredth or two.
        assert abs(found[r, c] - min(99.0 * worst ** 2, 100.0)) < 3.0
        compared += 1
    assert compared > 800
