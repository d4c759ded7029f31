"""Feet in soil: they sink as far as it bears, hold on slopes, leave prints, and stand in them."""

import re

import numpy as np
from physics_scene import (depth_m, GRAVITY, make_world, plane_heights, ROVER, simulate, soft,
                           trot, WEIGHT_N)
import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.ground.regolith.law import bearing_n, bearing_on_slope
from lunar_rover_sim.ground.regolith.soil import PRESETS
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.rover.physics.config import StartPose
from lunar_rover_sim.rover.physics.soft_ground import soil_record
from lunar_rover_sim.rover.physics.soil_contact import BALL_RADIUS_M, BALL_SPACING_M

R = ROVER.legs.tip_radius_m


def drop(preset, step_s, height_m):
    """Return the sinkage of a rover that falls from a height above flat ground."""
    start = StartPose(settle_s=0.0)
    with simulate(ground=soft(preset), step_s=step_s, start=start) as simulation:
        model, data = simulation.model, simulation.data
        low = min(data.geom_xpos[g][2] for g in range(model.ngeom)
                  if '_tip_' in model.geom(g).name and model.geom(g).bodyid[0] <= 5)
        data.qpos[2] += height_m - (low - R)
        data.qvel[:] = 0.0
        for _ in range(round(0.5 / step_s)):
            simulation.advance(1)
        # At rest the tips are pressed on by the weight, elastically.
        elastic_m = 0.25 * WEIGHT_N / PRESETS[preset].elastic_npm
        return float(simulation.ground_contact.sinkage_m.mean()) - elastic_m


@pytest.mark.parametrize('preset', ['highland', 'highland_dense'])
@pytest.mark.parametrize('step_s, tolerance', [(0.001, 0.10), (0.00025, 0.03)])
def test_a_fall_sinks_as_deep_as_its_energy(preset, step_s, tolerance):
    """2 mm: the depth where the integral of F is m g h, with m g z on the way."""
    z = np.linspace(0.0, 0.05, 50001)
    force = np.array([bearing_n(v, R, PRESETS[preset].zeta_npm3) for v in z])
    work = np.cumsum(force) * (z[1] - z[0])
    expected = z[np.argmax(work > 0.25 * WEIGHT_N * (z + 0.002))]
    assert drop(preset, step_s, 0.002) == pytest.approx(expected, rel=tolerance)


def test_sinkage_at_rest_lies_between_that_of_a_load_laid_down_and_one_let_go():
    with simulate(ground=soft()) as simulation:
        sinkage = simulation.ground_contact.sinkage_m
        assert simulation.state.contact_force_n[:, 2] == pytest.approx(WEIGHT_N / 4, rel=0.01)
    least = depth_m(WEIGHT_N / 4, PRESETS['highland'].zeta_npm3)
    assert np.all(sinkage >= least)
    assert np.all(sinkage < 2.5 * least)


def test_a_rover_at_rest_does_not_sink_on():
    with simulate(ground=soft('highland_loose')) as simulation:
        before = simulation.ground_contact.sinkage_m, simulation.state.position_m
        simulation.advance(5000)
        assert np.abs(simulation.ground_contact.sinkage_m - before[0]).max() < 1e-6
        assert np.abs(simulation.state.position_m - before[1]).max() < 1e-6


@pytest.mark.parametrize('gravity', [3.71, 9.81])
def test_static_sinkage_does_not_depend_on_gravity(gravity):
    """Scaling: zeta and stiffness in proportion to g, damping to its root; time shrinks by it."""
    sinkages = []
    for g in (1.62, gravity):
        step_s = round(0.0005 * (1.62 / g) ** 0.5, 6)
        with simulate(ground=soft(), gravity_mps2=g, step_s=step_s) as simulation:
            sinkages.append(simulation.ground_contact.sinkage_m)
    np.testing.assert_allclose(sinkages[1], sinkages[0], rtol=0.02)


def slide_m(preset, slope_deg):
    """Return how far a rover across a slope slides in a second; infinity if it tumbles."""
    world = make_world(plane_heights(slope_deg, 11, 1.0), 1.0)
    start = StartPose(yaw_deg=90.0, settle_s=3.0)
    ground = soft(preset, weak_slopes=False)
    try:
        with simulate(world, ground=ground, start=start) as simulation:
            before = simulation.state.position_m
            return np.linalg.norm(simulation.advance(1000).position_m - before)
    except ConfigError as error:
        assert 'tilted' in str(error)
        return np.inf


@pytest.mark.parametrize('preset', ['highland_loose', 'highland', 'highland_dense'])
def test_a_slope_holds_up_to_the_friction_angle(preset):
    limit = np.degrees(np.arctan(PRESETS[preset].friction))
    # Creep below 0.05 mm/s, three degrees below; free, three degrees above.
    assert slide_m(preset, limit - 3.0) < 5e-5
    assert slide_m(preset, limit + 3.0) > 0.02


def test_slopes_bear_less():
    """Vesic: (1 - tan 20 deg)^2 = 0.40 of the bearing, so feet stand deeper; on request only."""
    record = soil_record(PRESETS['highland'], ROVER, 0.001)[0]
    assert bearing_on_slope(np.tan(np.radians(20.0)), record) == pytest.approx(0.404, abs=0.001)
    world = make_world(plane_heights(20.0, 11, 1.0), 1.0)
    sinkage = []
    for weak in (False, True):
        with simulate(world, ground=soft(weak_slopes=weak)) as simulation:
            sinkage.append(float(simulation.ground_contact.sinkage_m.mean()))
    assert sinkage[1] > 1.4 * sinkage[0]


def test_prints_lie_below_the_feet_and_are_as_deep_as_they_sank():
    with simulate(ground=soft()) as simulation:
        model, data = simulation.model, simulation.data
        for geom in range(model.ngeom):
            if model.geom(geom).name.endswith('_tip_0') and model.geom(geom).bodyid[0] <= 5:
                x, y, z = data.geom_xpos[geom]
                around = np.round(np.array([x, y]) / 0.005) * 0.005
                distance2 = np.sum((around - [x, y]) ** 2)
                bottom = z - np.sqrt(R ** 2 - distance2)
                assert simulation.overlay.height_change(around) == pytest.approx(bottom, abs=1e-3)


def test_a_leg_stands_higher_in_its_own_print_than_it_would_sink_anew():
    """Compacted soil bears what it bore: put back into its prints the rover hardly sinks more."""
    with simulate(ground=soft()) as simulation:
        first = simulation.state.position_m[2]
        simulation.data.qpos[2] += 0.03
        simulation.data.qvel[:] = 0.0
        simulation.advance(20)
        assert np.all(simulation.ground_contact.sinkage_m == 0.0)
        simulation.data.qpos[2] = first + 0.001
        simulation.data.qvel[:] = 0.0
        simulation.advance(1000)
        assert simulation.state.position_m[2] == pytest.approx(first, abs=0.0015)


def test_cohesion_bears():
    with simulate(ground=soft('highland_loose')) as loose, \
            simulate(ground=soft('highland_loose', cohesion_kpa=0.3)) as cohesive:
        assert np.all(cohesive.ground_contact.sinkage_m
                      < 0.5 * loose.ground_contact.sinkage_m)


def test_soil_that_does_not_bear_digs_the_rover_in_with_a_name(caplog):
    with simulate(ground=soft('highland_loose', bearing_mnpm3=0.03)) as simulation:
        assert simulation.ground_contact.dug_in
        assert caplog.text.count('has dug itself in') == 1
        trot(simulation, 1.0)
        # Its belly carries it.
        assert simulation.state.position_m[2] > -0.01


def test_balls_below_the_chassis_leave_no_wider_gap_than_stated():
    with simulate(ground=soft()) as simulation:
        model = simulation.model
        balls = np.array([model.geom_pos[k] for k in range(model.ngeom)
                          if '_ball_' in model.geom(k).name])
    half = model.geom('chassis').size - BALL_RADIUS_M
    assert sorted((balls[balls[:, 2] > 0.0] / half).round(6).tolist()) == [
        [x, y, 1.0] for x in (-1.0, 1.0) for y in (-1.0, 1.0)], 'at the upper corners'
    low = balls[balls[:, 2] < 0.0]
    for k in (0, 1):
        along = np.unique(low[:, k].round(6))
        assert along[[0, -1]] == pytest.approx([-half[k], half[k]])
        assert np.diff(along).max() <= BALL_SPACING_M
        assert len(along) <= 2.0 * half[k] / BALL_SPACING_M + 3.0


@pytest.mark.parametrize('roll_deg', [0.0, 90.0, 180.0])
def test_soft_ground_carries_the_chassis_on_any_side(roll_deg):
    """Dropped upright, on its side, and upside down, no corner of it is in the ground."""
    with simulate(ground=soft()) as simulation:
        model, data = simulation.model, simulation.data
        data.qpos[:3] = 0.0, 0.0, 0.3
        half = np.radians(roll_deg) / 2.0
        data.qpos[3:7] = np.cos(half), np.sin(half), 0.0, 0.0
        data.qvel[:] = 0.0
        simulation.advance(3000)
        box = model.geom('chassis').id
        corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), -1).reshape(-1, 3)
        rotation = data.geom_xmat[box].reshape(3, 3)
        lowest = data.geom_xpos[box][2] + (corners * model.geom_size[box] @ rotation.T)[:, 2].min()
        # Contacts of 2 kN/m become stiff at the depth of a tip radius.
        assert lowest > -0.01


def test_rigid_ground_has_no_overlay():
    with simulate() as simulation:
        assert simulation.overlay is None and simulation.ground_contact is None


def test_soil_too_stiff_for_a_step_is_refused_and_the_valid_bound_is_valid():
    for name in 'elastic_npm', 'damping_nspm':
        for gravity_mps2 in 1.62, 3.7:
            with pytest.raises(ConfigError, match=f'ground.{name}: .* is not valid with') as error:
                simulate(ground=soft(**{name: 1e4 if name == 'damping_nspm' else 1e6}),
                         gravity_mps2=gravity_mps2)
            bound = float(re.search('valid is <= ([0-9.e+]+)', str(error.value))[1])
            with simulate(ground=soft(**{name: bound}), gravity_mps2=gravity_mps2) as simulation:
                simulation.advance(200)
            with pytest.raises(ConfigError, match=f'ground.{name}: .* is not valid with'):
                simulate(ground=soft(**{name: 1.1 * bound}), gravity_mps2=gravity_mps2)
    with pytest.raises(ConfigError, match='gravity_mps2: 0 is not valid'):
        simulate(ground=soft(), gravity_mps2=0.0)


@pytest.mark.parametrize('slope_deg, height_m, speed_mps', [(0.0, 0.35, 1.6), (25.0, 0.5, 1.0)])
def test_no_tip_gets_into_the_ground_before_soil_carries_it(slope_deg, height_m, speed_mps):
    """A tip that falls is seen before it is deeper than it falls in two steps."""
    heights = plane_heights(slope_deg)
    ground = HeightGrid(np.asarray(heights, np.float32), 0.025)
    start = StartPose(settle_s=0.0)
    with simulate(make_world(heights), ground=soft('highland'), start=start) as simulation:
        model, data = simulation.model, simulation.data
        tips = [g for g in range(model.ngeom) if '_tip_' in model.geom(g).name
                and model.geom(g).type[0] == 2]
        data.qpos[2] += height_m
        data.qvel[2] = -speed_mps
        cosine = np.cos(np.radians(slope_deg))
        touched = np.zeros(4, bool)
        for _ in range(round(1.3 * height_m / speed_mps / 0.001)):
            before = data.geom_xpos[tips].copy()
            state = simulation.advance(1)
            depth = R - (before[:, 2] - ground.height_at(before[:, :2])) * cosine
            fall = np.abs(data.geom_xpos[tips] - before).max()
            touched |= np.linalg.norm(state.contact_force_n, axis=1) > 0.0
            assert np.all(touched | (depth.reshape(4, -1).max(axis=1) < 2.0 * fall))
        assert touched.any()


@pytest.mark.parametrize('falls_mps', [0.0, 0.05])
def test_the_force_on_a_tip_begins_with_0_where_it_comes_back_to_its_print(falls_mps):
    """A rover raised off its prints, by 2 µm more each time, and let go for a step.

    Its speed after that step jumps by 0.9 mm/s where contacts carry a mass at once, and by
    0.2 mm/s where their spring presses by the depth at the end of the step.
    """
    with simulate(ground=soft()) as simulation:
        speeds = []
        for raised_m in np.arange(0.0002, 0.0007, 2e-6):
            simulation.reset()
            simulation.data.qpos[2] += raised_m
            simulation.data.qvel[2] = -falls_mps
            simulation.advance(1)
            speeds.append(simulation.data.qvel[2])
    assert speeds[-1] == pytest.approx(-falls_mps - GRAVITY * 0.001, abs=1e-8)
    assert np.ptp(speeds) > 0.001
    assert np.abs(np.diff(speeds)).max() < 1e-4
