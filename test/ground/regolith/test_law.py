"""The compiled law against sums over facets, plain formulae, and its own continuity."""

import dataclasses
import math

import numpy as np
from physics_scene import ROVER
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.compiled import read_only
from lunar_rover_sim.ground.regolith import law
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.regolith.resistive_force import (DEEPEST, dig_table, GENERIC,
                                                             POPPY_CLOSE, swept_bearing)
from lunar_rover_sim.ground.regolith.soil import PRESETS
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.rover.physics.soft_ground import soil_record

R, ZETA, STEP_S = ROVER.legs.tip_radius_m, 1.0e6, 0.001
ROD = ROVER.legs.spoke_radius_m
SAME = law.Heights(read_only(np.zeros((1, 1)), np.float32), 1.0, 0.0, 0.0)
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


def placed(position, attitude, angles, velocity, rate, rates, legs, offsets):
    """Return the records of two tips of each leg, for a body and legs that move."""
    tips = np.zeros(2 * len(legs), law.TIP)
    tips['leg'], tips['offset'] = np.repeat(np.arange(len(legs)), 2), offsets
    law.place_tips(np.concatenate([position, np.roll(attitude.as_quat(), 1), angles]),
                   np.concatenate([velocity, rate, rates]), legs, tips)
    return tips


def test_tips_are_carried_by_body_and_legs():
    """Legs with any axle, axis and attitude, on a body at any attitude: places by SciPy's
    rotations, velocities and rates as the derivatives of places."""
    rng = np.random.default_rng(4)
    turned, axis = Rotation.random(3, rng), rng.standard_normal((3, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    legs = np.zeros(3, law.LEG)
    legs['axle'], legs['attitude'], legs['axis'] = rng.uniform(-0.3, 0.3, (3, 3)), \
        turned.as_matrix(), axis
    position, velocity, rate = rng.uniform(-1.0, 1.0, (3, 3))
    angles, rates = rng.uniform(-3.0, 3.0, (2, 3))
    attitude, offsets = Rotation.random(None, rng), rng.uniform(-0.1, 0.1, (6, 3))

    def after(t):
        return placed(position + t * velocity, attitude * Rotation.from_rotvec(t * rate),
                      angles + t * rates, velocity, rate, rates, legs, offsets)

    now, before, later = after(0.0), after(-1e-5), after(1e-5)
    leg = now['leg']
    arm = attitude.apply((turned * Rotation.from_rotvec(axis * angles[:, None]))[leg]
                         .apply(offsets))
    np.testing.assert_allclose(now['rod'], -arm, atol=1e-14)
    np.testing.assert_allclose(now['centre'],
                               position + attitude.apply(legs['axle'][leg]) + arm, atol=1e-14)
    np.testing.assert_allclose((later['centre'] - before['centre']) / 2e-5, now['velocity'],
                               atol=1e-8)
    np.testing.assert_allclose((later['rod'] - before['rod']) / 2e-5,
                               np.cross(now['rate'], now['rod']), atol=1e-8)
    # Along the rod, too, which its derivative does not tell.
    np.testing.assert_allclose(now['rate'], attitude.apply(
        rate + (turned.apply(axis) * rates[:, None])[leg]), atol=1e-13)


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


@pytest.mark.parametrize('depth', [2.25, DEEPEST])
def test_a_dragged_tip_moves_where_it_is_borne(depth):
    """The way of a load is the one on which the swept ball bears that load."""
    table = dig_table(GENERIC)
    loads = np.linspace(0.125, 0.75, 11)
    slopes = np.array([law.dig_slope(load, depth, table, DEEPEST) for load in loads])
    inner = np.abs(slopes) < 1.9        # a way is no steeper than 2
    assert inner.sum() > 5
    off = np.abs(swept_bearing(GENERIC, depth, np.arctan(slopes[inner])) - loads[inner])
    assert np.median(off) < 5e-4 and off.max() < 0.01      # facets come into play one by one


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


def flat_ground(slope_x=0.0, slope_y=0.0):
    """Return a plane of 1 m, as the law takes it."""
    axis = np.linspace(-0.5, 0.5, 41)
    plane = (slope_x * axis[None, :] + slope_y * axis[:, None]).astype(np.float32)
    return law.Heights.of(HeightGrid(plane, 0.025))


def tip_at(x, y, z, **fields):
    """Return the record of a tip with its centre there, its rod upright."""
    tip = np.zeros(1, law.TIP)[0]
    tip['centre'], tip['rod'], tip['pressed'] = (x, y, z), (0.0, 0.0, 0.08), np.nan
    for name, value in fields.items():
        tip[name] = value
    return tip


def let_yield(tip, soil, ground, overlay):
    """Make one step of the law."""
    overlay.gather(0.0, 0.0, 0.5, 1.0)
    law.support(tip, soil, dig_table(GENERIC), DEEPEST, ground, SAME, overlay.near)


@pytest.mark.parametrize('former', [0.0, 0.004])
def test_a_tip_meets_what_lies_ahead_in_proportion_to_its_way(former):
    """In a print that leans; ahead of the ball, the ground is as it was, or an earlier print."""
    soil, overlay, way = record(), Overlay(), np.array([3e-4, -4e-4])
    i = np.arange(-20, 21) * 0.005
    bank = 0.1 * i[None, :] - 0.2 * i[:, None] if former == 0.0 else np.zeros((41, 41))
    overlay.put(-20, -20, bank - 2.0 * former, np.full((41, 41), former * soil['compacted']))
    lean, change, depth = np.array([0.2, -0.1]), -0.003, 0.005
    tip = tip_at(*way, R - depth + change, change=change, tilt=lean, in_ground=True, depth=depth,
                 plastic=depth, normal=(0.0, 0.0, 1.0))
    let_yield(tip, soil, flat_ground(), overlay)
    # Ahead is a cell and a half beyond the ball at the surface; all is met after twice as far.
    ahead = math.sqrt(depth * (2.0 * R - depth)) + 0.0075
    part, place = 5e-4 / (2.0 * ahead), way + ahead * way / 5e-4
    met = 0.1 * place[0] - 0.2 * place[1] if former == 0.0 else -former
    along = change + lean @ way
    assert tip['change'] == pytest.approx(along + part * (met - along), abs=1e-9)
    np.testing.assert_allclose(tip['tilt'], (1.0 - part) * lean)


def test_a_tip_touches_down_on_the_changed_ground():
    """On a bank it takes height and tilt of it; in an earlier print it finds the soil firm."""
    soil, overlay = record(), Overlay()
    i = np.arange(-10, 11) * 0.005
    bank = 0.2 * i[None, :] - 0.1 * i[:, None] - 0.02
    overlay.put(-10, -10, bank, np.where(bank < -0.02, 0.006 * soil['compacted'], 0.0))
    for x, former, above in ((0.02, 0.0, 5e-4), (0.02, 0.0, -5e-4),
                             (-0.02, 0.006, 5e-4), (-0.02, 0.006, -5e-4)):
        tip = tip_at(x, 0.0, R + 0.2 * x - 0.02 + above)
        let_yield(tip, soil, flat_ground(), overlay)
        assert tip['change'] == pytest.approx(0.2 * x - 0.02 + former, abs=1e-8)
        np.testing.assert_allclose(tip['tilt'], (0.2, -0.1), atol=1e-6)
        normal = np.array([-0.2, 0.1, 1.0]) / math.sqrt(1.05)
        np.testing.assert_allclose(tip['normal'], normal, atol=1e-6)
        assert tip['in_ground'] == (above < 0.0)
        if above < 0.0:
            depth = R - (R + above - former) * normal[2]
            assert tip['depth'] == pytest.approx(depth, abs=1e-8)
            assert former * normal[2] < tip['plastic'] < depth
