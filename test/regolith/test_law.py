"""The compiled law against sums over facets, plain formulae, and its own continuity."""

import dataclasses
import math

import numpy as np
from physics_scene import ROVER
import pytest

from lunar_rover_sim.physics.soft_ground import soil_record
from lunar_rover_sim.regolith import law
from lunar_rover_sim.regolith.dragged_ball import DEEPEST, dig_table, swept_bearing
from lunar_rover_sim.regolith.resistive_force import GENERIC, POPPY_CLOSE
from lunar_rover_sim.regolith.soil import PRESETS

R, ZETA, STEP_S = ROVER.legs.tip_radius_m, 1.0e6, 0.001
ROD = ROVER.legs.spoke_radius_m
DEPTHS = (0.0005, 0.003, 0.008, 0.0095, 0.016, 0.03)


def record(preset='highland', **changes):
    """Return the record of a soil for the law."""
    return soil_record(dataclasses.replace(PRESETS[preset], **changes), ROVER, STEP_S)[0]


@pytest.mark.parametrize('depth', DEPTHS)
def test_bearing_is_the_depth_summed_over_the_projected_cap(depth):
    radius = np.linspace(0.0, R, 20001)
    below = np.maximum(depth - R + np.sqrt(R ** 2 - radius ** 2), 0.0)
    total = ZETA * np.trapezoid(below * 2.0 * np.pi * radius, radius)
    assert law.bearing_n(depth, R, ZETA) == pytest.approx(total, rel=1e-5)


@pytest.mark.parametrize('depth', DEPTHS)
def test_silhouette_is_the_depth_summed_over_the_upright_section(depth):
    h = np.linspace(0.0, min(depth, 2.0 * R), 200001)
    width = 2.0 * np.sqrt(np.maximum(h * (2.0 * R - h), 0.0))
    assert law.silhouette_m3(depth, R) == pytest.approx(np.trapezoid((depth - h) * width, h),
                                                        rel=1e-5)


def test_nothing_bears_above_the_surface():
    assert law.bearing_n(-0.001, R, ZETA) == law.silhouette_m3(-0.001, R) == 0.0
    assert law.bears_n(-0.001, 0.3, record()) == law.ploughs_n(-0.001, 1.0, record()) == 0.0


@pytest.mark.parametrize('lean', [0.0, 0.4])
def test_the_rod_bears_and_ploughs_below_the_tip(lean):
    """Above z = 2 R it adds nothing; below, its wetted length times the mean depth."""
    for depth in (0.9 * 2.0 * R, 0.03, 0.05):
        below = max(depth - 2.0 * R, 0.0)
        assert law.bears_n(depth, lean, record()) == pytest.approx(
            law.bearing_n(depth, R, ZETA) + ZETA * ROD * lean * below ** 2)
        assert law.ploughs_n(depth, 0.5, record()) == pytest.approx(
            0.5 * ZETA * GENERIC.side_ratio * (law.silhouette_m3(depth, R) + ROD * below ** 2))


def test_cohesion_bears_by_the_area_of_the_cap():
    soil = dataclasses.replace(PRESETS['highland'], cohesion_pa=2000.0)
    cohesive = record(cohesion_pa=2000.0)
    for depth, area in ((0.003, math.pi * 0.003 * (2.0 * R - 0.003)), (0.02, math.pi * R * R)):
        assert law.bears_n(depth, 0.0, cohesive) - law.bears_n(depth, 0.0, record()) \
            == pytest.approx(soil.cohesive_bearing_pa * area)
        assert law.ploughs_n(depth, 0.0, cohesive) == pytest.approx(2000.0 * area)


def test_a_dragged_ball_bears_between_a_tenth_and_a_half_of_one_pressed_down():
    gamma = np.radians([-60.0, 0.0, 45.0, 90.0])
    for shape in (GENERIC, POPPY_CLOSE):
        for depth in (0.1, 1.0, 2.0):
            lift = swept_bearing(shape, depth, gamma)
            assert lift[0] < 0.1 < lift[1] < 0.5 < lift[2] < lift[3]
            assert lift[3] == pytest.approx(1.0)


def test_a_loaded_tip_digs_in_and_a_light_one_climbs():
    table = dig_table(GENERIC)
    slopes = [law.dig_slope(load, 1.0, table, DEEPEST) for load in np.linspace(0.0, 1.0, 21)]
    assert slopes[0] < 0.0 < slopes[-1]
    assert np.all(np.diff(slopes) >= 0.0)
    # Between them a tip slides on level, where its lift is that of a motion straight forward.
    level = float(swept_bearing(GENERIC, 1.125, np.zeros(1))[0])
    assert law.dig_slope(level, 1.125, table, DEEPEST) == pytest.approx(0.0, abs=0.05)


def elastic(depth, plastic=0.01, before=0.0003, way=0.0, part=1.0, lean=0.0, soil=None):
    return law.yielded(depth, plastic, before, way, part, lean, record() if soil is None else soil,
                       dig_table(GENERIC), DEEPEST)


@pytest.mark.parametrize('part', [1.0, 0.4])
@pytest.mark.parametrize('depth', [0.004, 0.02, 0.05])
def test_soil_yields_until_it_bears_spring_and_damper(depth, part):
    """A step deeper than what held before."""
    soil = record()
    e = elastic(depth, 0.9 * depth, 0.0, part=part, lean=0.3)
    carried = soil['elastic_npm'] * e + soil['damping_nspm'] * law.onset(e) * e / STEP_S
    assert carried == pytest.approx(part * law.bears_n(depth - e, 0.3, soil), rel=1e-6)
    assert depth - e > 0.9 * depth


def test_soil_holds_what_presses_less_than_it_bears():
    """Then all motion is elastic: down, up, and off the ground."""
    for depth in (0.01028, 0.01001, 0.0099):
        assert elastic(depth, plastic=0.01, before=0.00029) == pytest.approx(depth - 0.01,
                                                                             abs=1e-12)


def test_a_slip_digs_by_the_slope_of_its_load():
    """With the load that the soil carries at the end of the step."""
    soil, table, way = record(), dig_table(GENERIC), 2e-5
    depth, plastic, before = 0.0106, 0.01, 0.0006
    e = elastic(depth, plastic, before, way)
    force = soil['elastic_npm'] * e + soil['damping_nspm'] * (e - before) / STEP_S
    load = force / law.bears_n(depth - e, 0.0, soil)
    assert 0.0 < load < 1.0
    assert depth - e - plastic == pytest.approx(
        way * law.dig_slope(load, plastic / R, table, DEEPEST), abs=1e-9)


def test_the_law_is_continuous_in_all_that_it_is_given():
    """Steps of a millionth of the range change the result by no more than a bound of its slope.

    Along random lines through depth, plastic and elastic depth and way: across the onset of
    yielding, of digging and of climbing, and through the surface.
    """
    rng = np.random.default_rng(4)
    low = np.array([-0.001, 0.0, 0.0, 0.0])
    high = np.array([0.03, 0.03, 0.002, 1e-4])
    worst = 0.0
    for _ in range(60):
        a, b = (low + (high - low) * rng.random(4) for _ in range(2))
        for at in rng.random(30):
            one, other = (a + (b - a) * s for s in (at, at + 1e-6))
            change = abs(elastic(*one) - elastic(*other))
            worst = max(worst, change / np.abs(other - one).sum())
    # The elastic depth moves at most as far as the tip, and ten times as far as the way slipped.
    assert worst < 12.0


def test_a_rod_leans_by_the_angle_to_the_normal_of_the_ground():
    tip = np.zeros(1, law.TIP)[0]
    for slope_deg, rod_deg in ((0.0, 0.0), (0.0, 30.0), (20.0, 30.0), (20.0, -15.0)):
        slope, rod = np.radians([slope_deg, rod_deg])
        tip['normal'] = np.sin(slope), 0.0, np.cos(slope)
        tip['rod'] = 0.08 * np.array([np.sin(rod), 0.0, np.cos(rod)])
        assert law.lean_of(tip) == pytest.approx(np.tan(abs(rod - slope)), abs=1e-6)
    tip['normal'], tip['rod'] = (0.0, 0.0, 1.0), (1.0, 0.0, 0.1)
    assert law.lean_of(tip) == 2.0     # all but flat


def test_a_tip_slips_with_the_speed_of_its_lowest_point_along_the_surface():
    rng = np.random.default_rng(6)
    tip = np.zeros(1, law.TIP)[0]
    for _ in range(5):
        normal, rate, velocity = rng.normal(size=(3, 3))
        normal /= np.linalg.norm(normal)
        tip['normal'], tip['rate'], tip['velocity'] = normal, rate, velocity
        lowest = velocity + np.cross(rate, -R * normal)
        along = lowest - normal * (normal @ lowest)
        assert law.slip_mps(tip, R) == pytest.approx(np.linalg.norm(along))
