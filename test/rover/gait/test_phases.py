"""The phases of legs, and the shape of a cycle of one."""

import dataclasses
import math

import numpy as np
import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.gait.calibration import STAND, Stride
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.gait.controller import LegPhases
from lunar_rover_sim.rover.gait.shaping import ShapingFunction

DT = 0.005
LEGS = RoverDescription().legs
# Offsets without symmetry: half cycles would look the same added and subtracted.
CRAWL = (0.0, 0.5, 0.75, 0.25)
RIPPLE = (0.1, 0.35, 0.6, 0.85)
UNEVEN = (0.0, 0.1, 0.3, 0.7)


def config(offsets, **values):
    return GaitConfig(gait='custom', phase_offsets=offsets, **values)


def wrapped(phase):
    return (np.asarray(phase) + 0.5) % 1.0 - 0.5


def walked(start, gait, stride, seconds):
    """Return the times, phases (n, 4) and rates (n, 4) of legs that start at rest."""
    legs = LegPhases(LEGS.on_left)
    legs.start(start)
    steps = round(seconds / DT)
    phases, rates = np.empty((steps, 4)), np.empty((steps, 4))
    for i in range(steps):
        legs.advance(DT, gait, stride, gait.offsets(LEGS))
        phases[i], rates[i] = legs.phase, legs.rate
    return DT * np.arange(1, steps + 1), phases, rates


def out_of_step(phases, directions, offsets):
    """Return (n, 4) how far each leg is from its place against the first one [cycles]."""
    place = phases * np.asarray(directions, float) - np.asarray(offsets)
    return wrapped(place - place[:, :1])


@pytest.mark.parametrize('offsets', [CRAWL, RIPPLE, UNEVEN])
@pytest.mark.parametrize('clock', [0.0, 0.3, 0.81])
@pytest.mark.parametrize('directions', [(1, 1, 1, 1), (-1, -1, -1, -1), (-1, 1, -1, 1)])
def test_legs_that_stand_in_their_places_start_in_step(offsets, clock, directions):
    """The clock starts where it asks least of the legs: to half of its 1/64 cycle, nothing."""
    start = [sign * (clock + offset) for sign, offset in zip(directions, offsets)]
    stride = Stride(1.0, 0.0, directions[0], directions[1])
    _, phases, _ = walked(start, config(offsets), stride, 3.0)
    assert np.abs(out_of_step(phases, directions, offsets)).max() < 1.0 / 64.0
    # And they go where they are told.
    np.testing.assert_allclose(phases[-1] - start, np.array(directions) * 2.75, atol=0.05)


@pytest.mark.parametrize('offsets', [CRAWL, RIPPLE, UNEVEN])
@pytest.mark.parametrize('seed', range(4))
def test_any_start_is_drawn_into_any_gait_array(offsets, seed):
    rng = np.random.default_rng(seed)
    directions = rng.choice([-1, 1], 2)
    stride = Stride(0.8, 0.0, *map(float, directions))
    _, phases, _ = walked(rng.uniform(-3.0, 3.0, 4), config(offsets), stride, 8.0)
    error = out_of_step(phases[-200:], [*directions, *directions], offsets)
    assert np.abs(error).max() < 1e-3


def test_the_clock_runs_at_the_rate_that_is_asked_for():
    """Once in step, every leg makes rate cycles a second, and reaches it at the acceleration."""
    gait = config(CRAWL, phase_acceleration_hzps=1.6)
    time, phases, rates = walked(CRAWL, gait, Stride(0.8), 4.0)
    np.testing.assert_allclose(rates[-200:], 0.8, atol=1e-3)
    np.testing.assert_allclose(phases[-1] - phases[-201], 0.8, atol=1e-3)
    # From rest: 0.8 Hz at 1.6 Hz/s takes half a second, in which 0.2 cycles are made.
    slow = time <= 0.5
    np.testing.assert_allclose(rates[slow, 0], 1.6 * time[slow], atol=0.02)
    assert phases[-1, 0] - phases[0, 0] == pytest.approx(0.8 * (4.0 - 0.25), abs=0.01)


def test_rates_stay_within_their_bounds_while_legs_are_drawn():
    """An early leg slows to a quarter, a late one runs at 1.5 rates and 0.2 Hz; none turns back.

    No rate changes faster than four times the clock's.
    """
    acceleration = 2.0
    gait = config(CRAWL, phase_gain=20.0, phase_acceleration_hzps=acceleration)
    legs = LegPhases(LEGS.on_left)
    legs.start(CRAWL)
    rates = [[0.0] * 4]
    for i in range(800):
        if i == 200:
            legs.phase = [phase + off for phase, off in zip(legs.phase, (0.0, -0.4, 0.4, 0.1))]
        legs.advance(DT, gait, Stride(1.0), gait.offsets(LEGS))
        rates.append(list(legs.rate))
    rates = np.array(rates)
    assert np.abs(np.diff(rates, axis=0)).max() == pytest.approx(4.0 * acceleration * DT)
    drawn = rates[200:]
    np.testing.assert_allclose(drawn.max(axis=0), [1.0, 1.0 + 0.5 + 0.2, 1.0, 1.0], atol=0.03)
    np.testing.assert_allclose(drawn.min(axis=0), [1.0, 1.0, 0.25, 0.25], atol=0.03)
    assert rates.min() >= 0.0 and drawn[-1] == pytest.approx(np.ones(4), abs=0.01)


def test_a_late_leg_hurries_and_an_early_one_waits():
    """A tenth of a cycle off at gain 2: at first a fifth of a hertz more, or less."""
    gait = config(CRAWL, phase_gain=2.0, phase_acceleration_hzps=100.0)
    legs = LegPhases(LEGS.on_left)
    legs.start(CRAWL)
    for _ in range(200):
        legs.advance(DT, gait, Stride(1.0), gait.offsets(LEGS))
    np.testing.assert_allclose(legs.rate, 1.0, atol=0.02)
    legs.phase[1] -= 0.1
    legs.phase[2] += 0.1
    legs.advance(DT, gait, Stride(1.0), gait.offsets(LEGS))
    np.testing.assert_allclose(legs.rate, [1.0, 1.2, 0.8, 1.0], atol=0.02)


@pytest.mark.parametrize('start', [(0.1, -0.2, 0.45, -0.45), (3.3, 7.6, -2.4, -9.9)])
def test_standing_legs_settle_at_the_nearest_whole_phase(start):
    gait = config(CRAWL, settle_rate_hz=0.3)
    time, phases, rates = walked(start, gait, STAND, 6.0)
    np.testing.assert_allclose(phases[-1], np.round(start), atol=1e-3)
    assert np.abs(rates).max() <= 0.3 + 1e-9
    # Straight there: what is left never grows.
    assert np.all(np.diff(np.abs(phases - np.round(start)), axis=0) <= 1e-12)
    # Near the end what is left falls by exp(-3 t).
    end = np.abs(phases - np.round(start))[(time > 3.0) & (time < 4.0)]
    assert np.all((end[-1] / end[0] < np.exp(-2.7)) & (end[-1] / end[0] > np.exp(-3.3)))


def test_a_leg_that_settles_from_far_uses_the_whole_settle_rate():
    _, _, rates = walked((0.4,) * 4, config(CRAWL, settle_rate_hz=0.3), STAND, 1.0)
    assert rates.min() == pytest.approx(-0.3)


def test_walking_again_finds_a_new_clock():
    """After a stop the legs stand at whole phases; the clock starts from there, not from before.

    From standing no leg of a trot is more than half a cycle from its place; with the best clock
    none is more than a quarter and half a 64th away.
    """
    gait = dataclasses.replace(GaitConfig(), gait='trot')
    legs = LegPhases(LEGS.on_left)
    legs.start((0.0, 0.5, 0.5, 0.0))
    for stride, seconds in ((Stride(1.0), 2.13), (STAND, 4.0)):
        for _ in range(round(seconds / DT)):
            legs.advance(DT, gait, stride, gait.offsets(LEGS))
    np.testing.assert_allclose(legs.phase, np.round(legs.phase), atol=1e-3)
    start = np.array(legs.phase)
    reached = []
    for _ in range(round(4.0 / DT)):
        legs.advance(DT, gait, Stride(1.0), gait.offsets(LEGS))
        reached.append(np.array(legs.phase) - start)
    # Each leg moved by the clock's share and at most a quarter cycle more or less.
    clock = np.mean(reached[-1])
    assert np.abs(reached[-1] - clock).max() < 0.25 + 1.0 / 64.0 + 0.01


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
    ((0.6, 120.0, 0.2, 0.6), r'foot_width_deg: 120 .*< 120'),
    ((0.6, 130.0, 0.2, 0.6), r'foot_width_deg: 130 '),
    ((0.6, 0.0, 0.2, 0.6), r'foot_width_deg: 0 '),
    ((0.6, 60.0, 0.0, 0.0), r'both are 0'),
])
def test_refuses_what_has_no_shape(values, message):
    with pytest.raises(ConfigError, match=message):
        shape(*values)
