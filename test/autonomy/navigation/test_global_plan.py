"""Plans over maps from orbit: optimal, around what is steep, anew on news at a local price."""

import numpy as np
import pytest
import scipy.ndimage
from skimage.graph import MCP_Geometric

from lunar_rover_sim.autonomy.navigation.config import GlobalPlanConfig
from lunar_rover_sim.autonomy.navigation.global_plan import GlobalPlan, GroundCosts
from lunar_rover_sim.autonomy.navigation.incremental_search import IncrementalSearch
from lunar_rover_sim.base.errors import NavigationError
from lunar_rover_sim.ground.world.orbital_map import MappedCraters, OrbitalConfig, OrbitalMap

EXACT = OrbitalConfig(pixel_m=5.0, height_stddev_m=0.0, bias_stddev_m=0.0, tilt_stddev_deg=0.0,
                      crater_place_m=0.0)


def on_map(heights, craters=(), config=EXACT):
    """A map whose middle is the origin; craters: (x, y, diameter) [m]."""
    first = tuple(0.5 * (1 - n) * config.pixel_m for n in heights.shape[::-1])
    table = np.array(craters, float).reshape(-1, 3)
    return OrbitalMap(np.asarray(heights, np.float32), first,
                      MappedCraters(table[:, :2], table[:, 2]), np.zeros((0, 0), np.uint8),
                      (0.0, 0.0), config)


def rough(n, seed=1):
    noise = scipy.ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal((n, n)), 3)
    return (1.0 + 60.0 * np.abs(noise)).astype(np.float32)


def reference(cost, start, goal):
    """The cost of the best way, by scikit-image."""
    total, _ = MCP_Geometric(np.where(np.isfinite(cost), cost, -1.0).astype(float)).find_costs(
        [start], [goal])
    return total[goal]


def test_ways_are_the_cheapest_also_after_changes_and_moves():
    cost, goal, rng = rough(60), (55, 50), np.random.default_rng(2)
    cost[20:50, 25] = np.inf
    search, start = IncrementalSearch(cost, goal), (3, 4)
    for _ in range(25):
        way = search.way(start)
        assert tuple(way[0]) == start and tuple(way[-1]) == goal
        assert np.abs(np.diff(way, axis=0)).max() == 1
        assert search.cost_from(start) == pytest.approx(reference(cost, start, goal), rel=1e-6)
        cells = rng.integers(0, 60, (40, 2))
        cells = np.concatenate([cells, way[2:6]])
        cells = np.unique(cells[(cells != start).any(axis=1) & (cells != goal).any(axis=1)],
                          axis=0)
        rows, columns = cells.T
        cost[rows, columns] = rng.choice([1.0, 3.0, 30.0, np.inf], len(rows))
        search.changed(rows, columns)
        if np.isfinite(cost[tuple(way[1])]) and tuple(way[1]) != goal:
            start = tuple(int(v) for v in way[1])
        if np.isinf(reference(cost, start, goal)):
            assert search.way(start) is None
            break


def test_a_goal_behind_a_closed_wall_has_no_way():
    cost = np.ones((20, 20), np.float32)
    cost[:, 10] = np.inf
    search = IncrementalSearch(cost, (5, 15))
    assert search.way((5, 3)) is None
    cost[7, 10] = 1.0
    search.changed(np.array([7]), np.array([10]))
    assert len(search.way((5, 3))) == 13


def test_news_cost_the_same_however_far_the_goal_is():
    """Cells looked at, not time: a corridor of 5 m cells, 2 km long."""
    plan = GlobalPlan(GroundCosts.of(on_map(np.zeros((81, 400)))), (-970.0, 0.0), [(970.0, 0.0)])
    before, length = plan.expanded, plan.length_m
    position = plan.points_m[0]
    wall = position + np.stack([np.full(9, 12.5), np.arange(-20.0, 21.0, 5.0)], axis=-1)
    assert plan.report_blocked(wall, position)
    assert 0 < plan.expanded - before < 1500
    # Around the end of the wall of nine cells: 22.5 m aside.
    assert 1.0 < plan.length_m - length < 45.0
    off = np.abs(np.interp(position[0] + 12.5, *plan.points_m.T) - position[1])
    assert off > 20.0


def test_a_field_of_craters_is_driven_around():
    """Craters of 12 m are too small for the pixels, which show level ground."""
    field = [(x, y, 12.0) for x in range(-60, 61, 12) for y in range(-60, 61, 12)]
    plan = GlobalPlan(GroundCosts.of(on_map(np.zeros((100, 100)), field)), (-200.0, 0.0),
                      [(200.0, 0.0)])
    s = np.linspace(0.0, plan.length_m, 2000)
    along = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(plan.points_m, axis=0), axis=1))]
    points = np.stack([np.interp(s, along, plan.points_m[:, k]) for k in (0, 1)], axis=-1)
    inside = [(np.linalg.norm(points - c[:2], axis=1) < 6.0).mean() for c in field]
    assert sum(inside) < 0.03       # a straight way: 0.33
    # Around the square of 132 m: at least 2 sqrt(134^2 + 66^2) + 132 m.
    assert 430.0 < plan.length_m < 470.0


def test_steep_ground_is_not_crossed_and_its_gap_is_found():
    x = 5.0 * np.arange(80) - 197.5
    ridge = 30.0 * np.exp(-(x / 12.0) ** 2)
    heights = np.tile(ridge, (80, 1))
    heights[60:66] = 0.0
    plan = GlobalPlan(GroundCosts.of(on_map(heights)), (-150.0, 0.0), [(150.0, 0.0)])
    y = np.interp(0.0, *plan.points_m.T)
    assert 100.0 <= y <= 132.5
    with pytest.raises(NavigationError, match='no way leads from .* far.max_slope_deg'):
        GlobalPlan(GroundCosts.of(on_map(np.tile(ridge, (80, 1)))), (-150.0, 0.0),
                   [(150.0, 0.0)])


def test_costs_count_slopes_less_by_what_errors_of_the_map_make():
    errors = OrbitalConfig(pixel_m=5.0, height_stddev_m=0.5, correlation_m=20.0)
    noise = scipy.ndimage.gaussian_filter(np.random.default_rng(4).standard_normal((400, 400)),
                                          2.0)
    heights = 0.5 * noise / noise.std()
    level = GroundCosts.of(on_map(heights, config=errors)).cost
    naive = GroundCosts.of(on_map(heights)).cost
    assert level.mean() - 1.0 < 0.6 * (naive.mean() - 1.0)
    tilted = GroundCosts.of(on_map(heights + 0.25 * 5.0 * np.arange(400), config=errors)).cost
    share = 0.25 / np.tan(np.radians(20.0))
    assert np.median(tilted) == pytest.approx(1.0 + 6.0 * share ** 2, rel=0.05)


def test_the_shadow_of_relief_is_dear():
    """A ridge of 20 m at y = 0 throws a shadow of 74 m westward, under a sun in the east."""
    heights = np.zeros((60, 60))
    heights[20:40, 32:34] = 20.0
    level = on_map(heights)
    free, lit = (GroundCosts.of(level, sun_deg=sun) for sun in (None, (0.0, 15.0)))
    dark = lit.cost > free.cost
    x, y = (np.arange(60) + 0.5) * 5.0 - 150.0, slice(22, 38)
    assert dark[y, (x > -60.0) & (x < 5.0)].all() and not dark[y, x < -70.0].any()
    assert not dark[:, x > 20.0].any() and not dark[:15].any()
    plan = GlobalPlan(lit, (-30.0, -100.0), [(-30.0, 100.0)])
    assert np.interp(0.0, plan.points_m[:, 1], plan.points_m[:, 0]) < -60.0


def test_a_hole_of_the_map_is_driven_around_and_refused_as_a_goal():
    heights = np.zeros((60, 60))
    heights[25:35, 25:35] = np.nan
    costs = GroundCosts.of(on_map(heights))
    plan = GlobalPlan(costs, (-100.0, 0.0), [(100.0, 0.0)])
    assert np.abs(np.interp(0.0, *plan.points_m.T)) >= 25.0
    assert not plan.has_ground(0.0, 0.0) and plan.has_ground(-50.0, 0.0)
    assert not plan.has_ground(-151.0, 0.0)
    with pytest.raises(NavigationError, match='goal: x 10 m, y 0 m is in a hole of the map'):
        GlobalPlan(costs, (-100.0, 0.0), [(10.0, 0.0)])


@pytest.mark.parametrize('goal, words', [
    ((400.0, 0.0), 'goal: x 400 m, y 0 m is beyond the map of the site; valid are x of -149 to '
     '149 m'), ((np.nan, 0.0), 'goal: .* valid are finite'), ((1.0,), 'goal: .* valid are')])
def test_goals_that_cannot_be_had_are_refused(goal, words):
    with pytest.raises(NavigationError, match=words):
        GlobalPlan(GroundCosts.of(on_map(np.zeros((60, 60)))), (0.0, 0.0), [goal], border_m=1.0)


def test_way_points_come_one_after_the_other():
    plan = GlobalPlan(GroundCosts.of(on_map(np.zeros((60, 60)))), (-100.0, -100.0),
                      [(0.0, 100.0), (100.0, -100.0)])
    assert plan.length_m == pytest.approx(2.0 * np.hypot(100.0, 200.0), rel=0.06)
    assert plan.left_m((-100.0, -100.0)) == pytest.approx(plan.length_m)
    # It aims at most as far as the next way point.
    assert plan.ahead((-100.0, -100.0), 1e4) == pytest.approx([0.0, 100.0])
    np.testing.assert_allclose(np.linalg.norm(plan.ahead((-100.0, -100.0)) - (-100.0, -100.0)),
                               GlobalPlanConfig().ahead_m, rtol=0.05)
    for s in np.arange(0.0, np.hypot(100.0, 200.0), 3.0):
        plan.ahead(np.array([-100.0, -100.0]) + s * np.array([100.0, 200.0]) / np.hypot(100, 200))
    plan.reach((0.0, 99.8))
    assert [tuple(goal) for goal in plan.goals_m] == [(100.0, -100.0)]
    assert plan.left_m((0.0, 99.8)) == pytest.approx(np.hypot(100.0, 200.0), rel=0.06)


def test_a_rover_that_stands_on_what_is_forbidden_leaves_it():
    heights = np.zeros((60, 60))
    heights[30, 30] = 40.0
    plan = GlobalPlan(GroundCosts.of(on_map(heights)), (2.5, 2.5), [(100.0, 0.0)])
    assert plan.length_m < 130.0
