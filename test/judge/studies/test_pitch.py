"""The locomotion study: what it reads from curves, and what our physics shows."""

import dataclasses

import numpy as np
import pytest

from lunar_rover_sim.judge.studies.locomotion import (analyse, claims, PitchCurve, study,
                                                      velocity_interface)
from lunar_rover_sim.rover.description import Chassis, RoverDescription
from lunar_rover_sim.rover.physics.config import ContactConfig, PhysicsConfig
from lunar_rover_sim.run.scenario import Scenario

TIME = np.arange(0.0, 31.0, 0.005)


def curve(pitch):
    return PitchCurve('made', TIME, pitch)


def test_a_sine_is_read_as_it_was_made():
    after = np.clip(TIME - 1.0, 0.0, None)
    report = analyse(curve(-3.0 + 2.0 * np.sin(2.0 * np.pi * 1.8 * after)), 1.0, 0.9, 1.8)
    assert report.dominant_hz == pytest.approx(1.8, abs=0.01)
    assert report.steady_amplitude_deg == pytest.approx(2.0, abs=0.01)
    assert report.periodicity == pytest.approx(1.0, abs=1e-3)
    assert report.step_share > 0.99
    assert report.overshoot_deg < 0.001 and report.transient == pytest.approx(1.0, abs=1e-3)
    assert report.decay_s == 0.0


def test_an_overshoot_at_the_start_is_read_with_its_decay():
    after = np.clip(TIME - 1.0, 0.0, None)
    pitch = np.sin(2.0 * np.pi * 1.5 * after) * (1.0 + 2.0 * np.exp(-after / 1.0))
    report = analyse(curve(pitch), 1.0, 0.75, 1.5)
    # The first crest comes at 1/6 s: 1 + 2 exp(-1/6) = 2.69.
    assert report.transient == pytest.approx(2.69, abs=0.03)
    # 2 exp(-t) falls below a tenth at 3 s; the last crest before is at most a period earlier.
    assert 2.3 < report.decay_s < 3.1


def test_leaving_the_rest_position_is_no_overshoot():
    after = np.clip(TIME - 1.0, 0.0, None)
    settled = -5.0 * (1.0 - np.exp(-after / 0.5)) + 0.5 * np.sin(2.0 * np.pi * after)
    report = analyse(curve(np.where(TIME < 1.0, 0.0, settled)), 1.0, 0.5, 1.0)
    # The sine itself rises a little before the settling takes it down.
    assert report.transient < 1.6 and report.overshoot_deg < 0.3


def test_noise_is_not_periodic():
    noise = np.random.default_rng(1).normal(size=len(TIME))
    report = analyse(curve(noise), 1.0, 0.9, 1.8)
    assert abs(report.periodicity) < 0.1 and report.step_share < 0.1


def test_the_velocity_interface_pitches_by_inertia_over_stiffness():
    # Stiff support follows the load: m h a = 4 x^2 k p, with a = v / tau at the start.
    rover = RoverDescription()
    stiff = PhysicsConfig(contact=dataclasses.replace(ContactConfig(), stiffness_npm=2e4,
                                                      damping_nspm=200.0))
    pitch = np.radians(velocity_interface(TIME, 0.12, 1.0, rover, stiff).pitch_deg)
    mass, x = 2.24, 0.115
    height = 0.08 + 0.02 + (2.0 * -0.01 + 0.24 * -0.02) / mass
    static = mass * height * 1.2 / (4.0 * x * x * 2e4)
    assert np.all(pitch[TIME < 1.0] == 0.0)
    # A load that comes at once and decays: nose up, not below half nor above twice its static
    # value (an undamped spring doubles it).
    assert 0.5 * static < -pitch.min() < 2.0 * static
    assert abs(pitch[-1]) < 1e-9


def test_a_heavier_chassis_on_the_same_support_pitches_more():
    light = velocity_interface(TIME, 0.1, 1.0, RoverDescription(), PhysicsConfig())
    heavy = velocity_interface(TIME, 0.1, 1.0, RoverDescription(chassis=Chassis(mass_kg=4.0)),
                               PhysicsConfig())
    assert np.abs(heavy.pitch_deg).max() > 1.3 * np.abs(light.pitch_deg).max()


@pytest.fixture(scope='module')
def case():
    return study(Scenario.load('flat'), (0.12,), (1.62,), duration_s=15.0)[0]


def test_what_our_physics_shows(case):
    """The claims at 0.12 m/s on the Moon, as far as contact and gait bear them."""
    shown = {claim.name: claim for claim in claims(case)}
    assert shown['start transient'].value > 1.1
    assert shown['step frequency'].value == pytest.approx(1.0, abs=0.05)
    assert shown['smooth interface'].value < 0.1
    assert shown['no interface peak'].value < 0.2
    assert all(claim.holds for claim in shown.values())
    # Nearly periodic by the gait cycle, and most of it at the step frequency.
    assert case.gait_report.periodicity > 0.8
    assert case.gait_report.step_share > 0.5
