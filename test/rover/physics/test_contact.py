"""Feet on the ground: stiffness, friction, energy, forces."""

import re

import mujoco
import numpy as np
from physics_scene import make_world, plane_heights, rough_heights, ROVER, simulate, trot, WEIGHT_N
import pytest
from tip_penetration import TipPenetration

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import matrix_from_wxyz
from lunar_rover_sim.ground.regolith.config import GroundConfig
from lunar_rover_sim.rover.physics.config import ContactConfig, PhysicsConfig, StartPose

# No tip of the default rover penetrates deeper under lunar gravity, except after a fall by more
# than 0.3 m. At rest it is 0.5 mm. At a tip radius of 8 mm the ground is nearly rigid, and from
# about 10 mm on a tip would be caught in it (`rover/physics/contact.py`).
PENETRATION_BOUND_M = 0.0095


@pytest.mark.parametrize('stiffness', [1000.0, 2000.0, 8000.0])
def test_a_foot_sinks_by_load_over_stiffness(stiffness):
    contact = ContactConfig(stiffness_npm=stiffness, damping_nspm=60.0)
    # Cells so wide that each tip touches one facet: one contact point each.
    with simulate(make_world(np.zeros((11, 11)), 1.0), contact=contact) as simulation:
        assert simulation.data.ncon == 4
        np.testing.assert_allclose(simulation.data.contact.dist, -WEIGHT_N / 4 / stiffness,
                                   rtol=0.01)


def test_a_friction_that_does_not_hold_for_the_feet_is_told():
    soft = GroundConfig(model='regolith', friction=0.5)
    assert PhysicsConfig().without_effect() == PhysicsConfig(ground=soft).without_effect() == []
    assert PhysicsConfig(contact=ContactConfig(sliding_friction=0.5)).without_effect() == []
    told, = PhysicsConfig(contact=ContactConfig(sliding_friction=0.5), ground=soft
                          ).without_effect()
    assert told.startswith('contact.sliding_friction: holds for rocks and chassis; feet')
    rigid = PhysicsConfig(ground=GroundConfig(friction=0.5, shear_mm=3.0))
    assert rigid.without_effect() == ['ground.friction: has no effect on rigid ground',
                                      'ground.shear_mm: has no effect on rigid ground']


def test_resting_forces_carry_the_weight():
    with simulate() as simulation:
        state = simulation.advance(100)
    total = state.contact_force_n.sum(axis=0)
    assert total[2] == pytest.approx(WEIGHT_N, rel=0.005)
    np.testing.assert_allclose(total[:2], 0.0, atol=0.005 * WEIGHT_N)
    # Upright spokes: the reaction goes through the axles.
    np.testing.assert_allclose(state.contact_torque_nm, 0.0, atol=1e-3)


def test_contact_torque_is_that_of_the_force_at_the_tip():
    start = StartPose(joint_angle_rad=(0.4, 0.4, 0.4, 0.4))
    with simulate(start=start) as simulation:
        state = simulation.advance(5)
        legs = simulation.rover.legs
    # Tips stand behind the axles: with sinkage and lean small, the lever is known.
    reach = legs.spoke_length_m - legs.tip_radius_m
    for angle, force, torque in zip(state.joint_angle_rad, state.contact_force_n,
                                    state.contact_torque_nm):
        arm = np.array([-reach * np.sin(angle), 0.0, -reach * np.cos(angle) - legs.tip_radius_m])
        np.testing.assert_allclose(torque, np.cross(arm, force), atol=0.002 * WEIGHT_N)


def slide_m(world, friction, yaw_deg):
    """Return how far the rover slides in a second, standing across the slope."""
    with simulate(world, contact=ContactConfig(sliding_friction=friction),
                  start=StartPose(yaw_deg=yaw_deg)) as simulation:
        before = simulation.state.position_m
        return np.linalg.norm(simulation.advance(1000).position_m - before)


@pytest.mark.parametrize('friction', [0.5, 0.8])
@pytest.mark.parametrize('yaw_deg', [90.0, -90.0])
def test_a_slope_holds_up_to_the_friction_angle(friction, yaw_deg):
    """Across the slope, so that no leg turns: at rest below atan(mu), sliding above it."""
    limit = np.degrees(np.arctan(friction))
    held, free = (slide_m(make_world(plane_heights(slope, 11, 1.0), 1.0), friction, yaw_deg)
                  for slope in (limit - 1.0, limit + 1.0))
    # Held: only the creep of the shear damper, load / (4 x 30 kN s/m), about 0.02 mm/s.
    assert held < 1e-4
    # Free: g (sin - mu cos) t^2 / 2 from rest, and more since it slid before.
    slope = np.radians(limit + 1.0)
    assert free > 0.5 * 1.62 * (np.sin(slope) - friction * np.cos(slope))


@pytest.mark.parametrize('damping', [100.0, 1000.0])
def test_held_feet_creep_by_load_over_shear_damping(damping):
    slope = np.radians(10.0)
    with simulate(make_world(plane_heights(10.0)),
                  contact=ContactConfig(shear_damping_nspm=damping)) as simulation:
        before, contacts = simulation.advance(50).position_m, simulation.data.ncon
        after = simulation.advance(200).position_m
        creep_mps = np.linalg.norm(after - before) / (200 * simulation.config.step_s)
    assert creep_mps == pytest.approx(WEIGHT_N * np.sin(slope) / (contacts * damping), rel=0.3)


def test_facet_edges_hold_a_little_more():
    """On 2.5 cm cells a tip may rest against an edge of a facet: free 2 deg beyond atan(mu)."""
    limit = np.degrees(np.arctan(0.5))
    assert slide_m(make_world(plane_heights(limit - 1.0)), 0.5, 90.0) < 1e-4
    assert slide_m(make_world(plane_heights(limit + 2.0)), 0.5, 90.0) > 0.03


@pytest.mark.parametrize('seed', range(4))
def test_a_dropped_rover_never_gains_energy(seed):
    rng = np.random.default_rng(seed)
    with simulate() as simulation:
        model, data = simulation.model, simulation.data
        model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
        mujoco.mj_resetData(model, data)
        data.qpos[2] = 0.4
        if seed:
            data.qpos[3:7] = rng.normal(size=4)
            data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
            data.qvel[3:6] = rng.normal(size=3)
        flight, last = [], 0.0
        for _ in range(6000):
            mujoco.mj_step(model, data)
            last = float(data.energy.sum())
            # In contact the ground stores energy; in flight all of it is the rover's.
            if data.ncon == 0:
                flight.append(last)
        assert len(flight) > 300
        assert np.all(np.diff(flight) < 1e-9)
        # Landed: what it fell by, about 0.3 m, is gone, and it lies still.
        assert last < 0.6 * flight[0]
        assert np.abs(data.qvel).max() < 0.1


def test_tips_stay_near_the_surface_of_rough_ground():
    world = make_world(rough_heights())
    with simulate(world) as simulation:
        tips, deepest = TipPenetration(simulation), []
        trot(simulation, 20.0, observe=lambda _: deepest.append(tips.deepest_m()))
        # It does touch down harder than it stands.
        assert 2.0 * WEIGHT_N / 4 / 2000.0 < max(deepest) < PENETRATION_BOUND_M
        assert simulation.state.position_m[0] > 1.5


@pytest.mark.parametrize('step_s', [0.001, 0.005])
@pytest.mark.parametrize('quat', [(1.0, 0.0, 0.0, 0.0), (0.98, 0.15, 0.12, 0.0),
                                  (0.92, 0.3, 0.25, 0.1)])
def test_no_foot_is_caught_in_the_ground_after_a_fall(quat, step_s):
    """A fall by nearly four lengths of a spoke, feet first or one foot first."""
    world = make_world()
    with simulate(world, step_s=step_s) as simulation:
        tips, data = TipPenetration(simulation), simulation.data
        data.qpos[2] += 0.3
        data.qpos[3:7] = quat
        deepest = 0.0
        for _ in range(round(2.5 / step_s)):
            simulation.advance(1)
            deepest = max(deepest, tips.deepest_m())
        assert 0.004 < deepest < PENETRATION_BOUND_M + (0.002 if step_s > 0.001 else 0.0)
        assert tips.deepest_m() < 0.0015


def test_penetration_is_that_of_the_tips_however_deep():
    world = make_world()
    with simulate(world) as simulation:
        tips = TipPenetration(simulation)
        resting = tips.deepest_m()
        assert resting == pytest.approx(WEIGHT_N / 4 / 2000.0, rel=0.6)
        # Beyond a tip radius MuJoCo reports the way out to the side; below, the belly touches too.
        for depth in (0.003, 0.007, 0.02, 0.07):
            simulation.data.qpos[2] -= depth
            mujoco.mj_forward(simulation.model, simulation.data)
            assert tips.deepest_m() == pytest.approx(resting + depth, abs=2e-4)
            simulation.data.qpos[2] += depth
        simulation.data.qpos[2] += 1.0
        mujoco.mj_forward(simulation.model, simulation.data)
        assert tips.deepest_m() == 0.0


def test_friction_parameters_reach_every_contact():
    with simulate(contact=ContactConfig(sliding_friction=0.6)) as simulation:
        for touch in simulation.data.contact:
            assert touch.dim == 6
            np.testing.assert_allclose(touch.friction, [0.6, 0.6, 0.004, 0.0005, 0.0005])


def test_a_step_too_long_for_the_contact_is_refused():
    with pytest.raises(ConfigError, match=r'contact.damping_nspm: 400 is not valid with step_s = '
                       r'0.005; valid is <= [\d.e+]+ .* or step_s <= [\d.e-]+$'):
        simulate(step_s=0.005, contact=ContactConfig(stiffness_npm=2e4, damping_nspm=400.0))


def longest_step_s(stiffness_npm, damping_nspm):
    """Return the longest step that is accepted for a contact, read from a refusal."""
    contact = ContactConfig(stiffness_npm=stiffness_npm, damping_nspm=damping_nspm)
    with pytest.raises(ConfigError, match='or step_s <= ') as caught:
        simulate(step_s=0.005, contact=contact)
    return float(re.search(r'or step_s <= ([\d.e-]+)', str(caught.value))[1])


def test_the_longest_step_is_that_of_the_stiffness_or_of_the_damping():
    """Half a radian of the bare oscillation, or the time in which the damper alone decays.

    sqrt(m / K) / 2 and m / C, m the mass that a contact feels. Texts are rounded down to two
    digits.
    """
    with simulate() as simulation:
        model = simulation.model
        mass = 1.0 / model.body_invweight0[model.body('front_left').id, 0]
    for stiffness in (2e4, 8e4):
        assert longest_step_s(stiffness, 1.0) == pytest.approx(0.5 * (mass / stiffness) ** 0.5,
                                                               rel=0.06)
    for damping in (200.0, 800.0):
        assert longest_step_s(1000.0, damping) == pytest.approx(mass / damping, rel=0.06)


def test_a_step_within_the_bound_is_taken_and_one_beyond_it_refused():
    bound = longest_step_s(2e4, 30.0)
    contact = ContactConfig(stiffness_npm=2e4, damping_nspm=30.0)
    simulate(step_s=bound, contact=contact).close()
    with pytest.raises(ConfigError, match='is not valid with step_s'):
        simulate(step_s=1.03 * bound, contact=contact)


def sloping_world(east, north, n=41, cell_m=0.25):
    axis = (np.arange(n) - (n - 1) / 2) * cell_m
    return make_world(east * axis + north * axis[:, None], cell_m)


@pytest.mark.parametrize('east,north', [(0.0, 0.0), (0.3, 0.0), (0.0, -0.3), (0.2, 0.25)])
def test_a_deep_tip_is_measured_square_to_the_slope(east, north):
    """Lowered by a length, a tip goes in by that length times the cosine of the slope.

    The least of the lowered tips is known from geometry: centre and radius against the plane.
    """
    world = sloping_world(east, north)
    cosine = 1.0 / np.sqrt(1.0 + east**2 + north**2)
    with simulate(world, start=StartPose(settle_s=0.0)) as simulation:
        tips, data, model = TipPenetration(simulation), simulation.data, \
            simulation.model
        geoms = [g for g in range(model.ngeom) if '_tip_' in model.geom(g).name]
        assert len(geoms) == 12
        for depth in (0.02, 0.05):
            data.qpos[2] -= depth
            mujoco.mj_forward(model, data)
            centre = data.geom_xpos[geoms]
            above = (centre[:, 2] - east * centre[:, 0] - north * centre[:, 1]) * cosine
            expected = ROVER.legs.tip_radius_m - above.min()
            assert expected > 0.8 * depth * cosine
            assert tips.deepest_m() == pytest.approx(expected, abs=1e-4)
            data.qpos[2] += depth


def test_nothing_touched_is_no_depth():
    world = sloping_world(0.0, 0.0)
    with simulate(world) as simulation:
        tips = TipPenetration(simulation)
        simulation.data.qpos[2] += 0.5
        mujoco.mj_forward(simulation.model, simulation.data)
        assert simulation.data.ncon == 0 and tips.deepest_m() == 0.0


@pytest.mark.parametrize('east,north', [(0.0, 0.0), (0.25, 0.0), (0.0, 0.25), (-0.15, 0.2)])
@pytest.mark.parametrize('yaw_deg', [0.0, 50.0])
def test_the_rover_starts_square_to_the_slope_just_above_it(east, north, yaw_deg):
    world = sloping_world(east, north)
    with simulate(world, start=StartPose(yaw_deg=yaw_deg, settle_s=0.0)) as simulation:
        state = simulation.state
        rotation = matrix_from_wxyz(state.orientation_wxyz)
        normal = np.array([-east, -north, 1.0]) / np.sqrt(1.0 + east**2 + north**2)
        np.testing.assert_allclose(rotation[:, 2], normal, atol=1e-6)
        heading = np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]))
        assert heading == pytest.approx(yaw_deg, abs=1e-6)
        # All upright spokes are as far from the ground: 1 mm of clearance, and no contact.
        assert simulation.data.ncon == 0 or simulation.data.contact.dist.min() > 0.0
        data, model = simulation.data, simulation.model
        geoms = [g for g in range(model.ngeom) if '_tip_' in model.geom(g).name]
        centre = data.geom_xpos[geoms]
        gap = (centre @ normal) - ROVER.legs.tip_radius_m
        # A millimetre on level ground; on a slope the least that surely touches nothing.
        assert 0.0 < gap.min() < 0.006
        assert east or north or gap.min() == pytest.approx(0.001, abs=1e-5)
        np.testing.assert_allclose(np.sort(gap)[:4], gap.min(), atol=1e-6)
