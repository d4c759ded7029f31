"""The shaping function keeps its promises: continuity, slope, stance share, sweep, one pitch."""

import math

import numpy as np
import pytest

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.gait.shaping import ShapingFunction

PITCH = 2.0 * math.pi / 3.0
WIDTH = math.radians(60.0)
SHAPES = [(0.6, 60.0, 0.2, 0.6), (0.6, 60.0, 0.0, 1.0), (0.6, 60.0, 1.0, 0.0),
          (0.5, 60.0, 0.5, 0.5), (0.3, 45.0, 1.0, 1.0), (0.85, 100.0, 0.3, 0.7),
          (0.6, 5.0, 0.2, 0.6)]


def shape(duty, width_deg, stance, flight, pitch=PITCH):
    return ShapingFunction(duty, math.radians(width_deg), stance, flight, pitch)


@pytest.mark.parametrize('values', SHAPES)
def test_angle_and_slope_are_continuous_across_every_boundary(values):
    s = shape(*values)
    edges = [0.0, 0.5, 1.0, 1.5, s.duty / 2, 1.0 - s.duty / 2, -s.duty / 2]
    edges += list(np.linspace(-1.0, 2.0, 601))
    step = 1e-9
    for edge in edges:
        angle, slope = s.angle([edge - step, edge + step]), s.slope([edge - step, edge + step])
        # Slopes stay below 30 rad per cycle here, their own slopes below 1e4.
        assert abs(angle[1] - angle[0]) < 30.0 * 2.0 * step + 1e-12
        assert abs(slope[1] - slope[0]) < 1e4 * 2.0 * step


@pytest.mark.parametrize('values', SHAPES)
def test_slope_is_the_derivative_of_the_angle(values):
    s = shape(*values)
    phase = np.linspace(-1.2, 2.3, 997)
    h = 1e-5
    difference = (s.angle(phase + h) - s.angle(phase - h)) / (2.0 * h)
    np.testing.assert_allclose(s.slope(phase), difference, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize('values', SHAPES)
def test_one_cycle_turns_by_one_spoke_pitch(values):
    s = shape(*values)
    phase = np.linspace(-3.0, 3.0, 301)
    np.testing.assert_allclose(s.angle(phase + 1.0) - s.angle(phase), PITCH, atol=1e-12)
    # Exactly so far from zero: a long drive does not drift.
    assert s.angle_at(100000.25) - s.angle_at(0.25) == pytest.approx(100000 * PITCH, abs=1e-6)


@pytest.mark.parametrize('values', SHAPES)
def test_stance_takes_its_share_and_sweeps_the_foot_width_about_straight_down(values):
    s = shape(*values)
    n = 10000
    swept = np.abs(s.angle((np.arange(n) + 0.5) / n - 0.5))
    assert abs(np.mean(swept <= math.radians(values[1]) / 2.0) - values[0]) <= 1.0 / n
    half = s.duty / 2.0
    assert s.angle_at(0.0) == 0.0
    assert s.angle_at(half) == pytest.approx(math.radians(values[1]) / 2.0, abs=1e-12)
    assert s.angle_at(-half) == pytest.approx(-math.radians(values[1]) / 2.0, abs=1e-12)
    assert s.angle_at(1.0 - half) == pytest.approx(PITCH - math.radians(values[1]) / 2.0)


def test_the_function_is_odd_so_that_backward_is_the_same_in_reverse():
    s = shape(0.6, 60.0, 0.2, 0.6)
    phase = np.linspace(0.0, 2.0, 401)
    np.testing.assert_allclose(s.angle(-phase), -s.angle(phase), atol=1e-12)
    np.testing.assert_allclose(s.slope(-phase), s.slope(phase), atol=1e-9)


def test_without_stance_smoothing_the_foot_moves_uniformly():
    s = shape(0.6, 60.0, 0.0, 1.0)
    stance = np.linspace(-0.3, 0.3, 101)
    np.testing.assert_allclose(s.slope(stance), WIDTH / 0.6, rtol=1e-12)


def test_the_leg_never_turns_back():
    rng = np.random.default_rng(1)
    phase = np.linspace(0.0, 1.0, 1001)
    for _ in range(200):
        s = shape(rng.uniform(0.05, 0.95), rng.uniform(0.5, 119.5), *rng.uniform(0.0, 1.0, 2))
        assert np.min(s.slope(phase)) > 0.0


def test_phase_is_the_inverse_of_angle():
    s = shape(0.6, 60.0, 0.2, 0.6)
    angle = np.linspace(-7.0, 9.0, 333)
    np.testing.assert_allclose(s.angle(s.phase(angle)), angle, atol=1e-9)


@pytest.mark.parametrize(('values', 'message'), [
    ((0.0, 60.0, 0.2, 0.6), r'duty_factor: 0 .*> 0 and < 1'),
    ((1.0, 60.0, 0.2, 0.6), r'duty_factor: 1 '),
    ((0.6, 120.0, 0.2, 0.6), r'foot_width_deg: 120 .*< 120'),
    ((0.6, 130.0, 0.2, 0.6), r'foot_width_deg: 130 '),
    ((0.6, 0.0, 0.2, 0.6), r'foot_width_deg: 0 '),
    ((0.6, 60.0, -0.1, 0.6), r'stance_smoothing: -0.1'),
    ((0.6, 60.0, 0.1, 1.6), r'flight_smoothing: 1.6'),
    ((0.6, 60.0, 0.0, 0.0), r'both are 0'),
])
def test_refuses_what_has_no_shape(values, message):
    with pytest.raises(ConfigError, match=message):
        shape(*values)
