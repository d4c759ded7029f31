"""Sweep and slip of the feet, from states alone."""

import dataclasses
import math

import numpy as np
from physics_scene import make_world, plane_heights, ROVER, simulate, trot
import pytest

from lunar_rover_sim.base.frames import wxyz_from_rpy
from lunar_rover_sim.rover.physics.config import ContactConfig
from lunar_rover_sim.rover.physics.foot_motion import FootMotion, FootObserver, SlipMeter

L = ROVER.legs.spoke_length_m


def standing(world=None, **changes):
    """Return observer and a state of a rover that stands on level ground, legs upright."""
    world = world or make_world()
    with simulate(world) as simulation:
        state = dataclasses.replace(simulation.state, angular_velocity_radps=np.zeros(3),
                                    linear_velocity_mps=np.zeros(3),
                                    joint_velocity_radps=np.zeros(4),
                                    contact_force_n=np.tile([0.0, 0.0, 0.9], (4, 1)))
    return FootObserver(ROVER, world.ground, 1.62), dataclasses.replace(state, **changes)


def test_a_wheel_like_leg_slips_as_a_wheel():
    """i = 1 - v / (r omega): none at v = r omega, all at v = 0, a half between."""
    for speed, ratio in ((0.08, 0.0), (0.04, 0.5), (0.0, 1.0), (0.1, -0.25)):
        observer, state = standing(joint_velocity_radps=np.full(4, 1.0),
                                   linear_velocity_mps=np.array([speed, 0.0, 0.0]))
        motion = observer.observe(state)
        assert motion.sweep_mps == pytest.approx(np.full(4, L), rel=1e-3)
        meter = SlipMeter(4)
        meter.add(motion, 0.005)
        assert meter.ratio == pytest.approx(np.full(4, ratio), abs=2e-3)
        assert meter.total == pytest.approx(ratio, abs=2e-3)


def test_a_slipping_turn_has_opposite_slip_on_both_sides():
    observer, state = standing(angular_velocity_radps=np.array([0.0, 0.0, 0.5]))
    slip = observer.observe(state).slip_mps
    # The feet of the left side go backward as the rover turns left about its middle.
    assert slip == pytest.approx(0.5 * 0.105 * np.array([1, -1, 1, -1]), rel=0.01)


def test_beyond_the_ground_it_counts_as_level():
    observer, state = standing(joint_velocity_radps=np.full(4, 1.0),
                               orientation_wxyz=wxyz_from_rpy(0.0, 0.0, 0.8))
    away = dataclasses.replace(state, position_m=state.position_m + [1e3, 0.0, 0.0])
    assert observer.observe(away).sweep_mps == pytest.approx(observer.observe(state).sweep_mps,
                                                             rel=1e-3)


def test_a_leg_in_the_air_neither_sweeps_nor_slips():
    observer, state = standing(joint_velocity_radps=np.full(4, 1.0))
    force = state.contact_force_n.copy()
    force[2] = 0.0
    motion = observer.observe(dataclasses.replace(state, contact_force_n=force))
    assert motion.loaded.tolist() == [True, True, False, True]
    assert motion.sweep_mps[2] == motion.slip_mps[2] == 0.0 < motion.slip_mps[0]
    assert math.isnan(SlipMeter(4).ratio[0]) and math.isnan(SlipMeter(4).total)


def test_the_rover_slips_by_the_way_that_it_does_not_get_on():
    """It walks 0.08 m on four feet, slides back by 0.05 m on one, and by 0.03 m on none."""
    meter = SlipMeter(4)
    all_legs, one = np.ones(4, bool), np.array([True, False, False, False])
    for loaded, axle_mps in ((all_legs, 0.08), (one, -0.05), (~all_legs, -0.03)):
        sweep_mps = 0.1 * loaded
        meter.add(FootMotion(loaded, sweep_mps, (sweep_mps - axle_mps) * loaded,
                             np.full(4, axle_mps)), 1.0)
    assert meter.driven_m == pytest.approx(0.2) and meter.way_m == pytest.approx(0.0)
    assert meter.total == pytest.approx(1.0)
    assert meter.ratio == pytest.approx([0.85, 0.2, 0.2, 0.2])


def test_slip_is_measured_along_the_slope():
    """A rover that slides down a slope of 20 deg with its legs held, tilted as the slope is."""
    slope = math.radians(20.0)
    world = make_world(plane_heights(20.0))
    observer, state = standing()
    observer = FootObserver(ROVER, world.ground, 1.62)
    tilted = dataclasses.replace(state, orientation_wxyz=wxyz_from_rpy(0.0, -slope, 0.0),
                                 linear_velocity_mps=np.array([-0.3, 0.0, 0.0]))
    assert observer.observe(tilted).slip_mps == pytest.approx(np.full(4, 0.3), rel=1e-6)


def test_slip_grows_as_friction_falls():
    ratios = []
    for friction in (0.8, 0.05):
        with simulate(contact=ContactConfig(sliding_friction=friction)) as simulation:
            meter, expected = SlipMeter(4), []

            def observe(state):
                motion = simulation.foot_motion
                meter.add(motion, 0.005)
                expected.append(state.linear_velocity_mps[0] * 0.005 * motion.loaded.sum())

            trot(simulation, 2.0, observe=observe)
            # Above a foot on the ground the rover goes on by what it sweeps and does not slip.
            went = np.sum(meter.swept_m - meter.slipped_m)
            assert went == pytest.approx(sum(expected), rel=0.1)
            ratios.append(float(meter.slipped_m.sum() / meter.swept_m.sum()))
    assert -0.05 < ratios[0] < 0.15 and ratios[1] > ratios[0] + 0.1
