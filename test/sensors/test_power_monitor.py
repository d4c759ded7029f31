"""The power monitors: the electric power of the motors, with the errors of a measuring part."""

import numpy as np
import pytest

from lunar_rover_sim.rover.description import Motor
from lunar_rover_sim.sensors.power_monitor import PowerMonitorConfig, PowerMonitors

MOTOR = Motor()
TORQUE_NM, SPEED_RADPS = np.array([0.4, 0.1, 0.0, -0.3]), np.array([2.0, 3.0, 1.0, 2.0])


def monitors(seed=1, **values):
    return PowerMonitors(MOTOR, len(TORQUE_NM), PowerMonitorConfig(**values),
                         np.random.default_rng(seed))


def test_true_currents_are_those_of_the_power():
    """By hand: i = T / (n k), P = i^2 R + T w; a motor that brakes draws nothing."""
    shown = monitors(enabled=False).measure(TORQUE_NM, SPEED_RADPS)
    k = 12.0 / 1100.0
    winding = 0.4 / (84.0 * k)
    power = winding**2 * (12.0 * k / 0.042) + 0.4 * 2.0
    assert shown.voltage_v.tolist() == [12.0] * 5
    assert shown.current_a[0] == pytest.approx(power / 12.0, rel=1e-12)
    assert shown.current_a[2] == shown.current_a[3] == 0.0
    assert shown.current_a[-1] == pytest.approx(shown.current_a[:4].sum())


def test_errors_have_the_deviations_of_the_data_sheet():
    """Over 800 parts: gain, offset and the rounding of the step, added in squares."""
    true = monitors(enabled=False).measure(TORQUE_NM, SPEED_RADPS)
    shown = [monitors(seed).measure(TORQUE_NM, SPEED_RADPS) for seed in range(800)]
    for values, exact, offset, step in (
            (np.array([s.current_a for s in shown]), true.current_a, 2.5e-6 / 0.02, 2.5e-6 / 0.02),
            (np.array([s.voltage_v for s in shown]), true.voltage_v, 1.25e-3, 1.25e-3)):
        error = values - exact
        stated = np.sqrt((2e-4 * exact)**2 + offset**2 + step**2 / 12.0)
        assert np.abs(error.mean(axis=0)).max() < 4.0 * stated.max() / np.sqrt(800)
        np.testing.assert_allclose(error.std(axis=0), stated, rtol=0.11)   # 4 deviations of it


def test_a_part_keeps_its_errors():
    part = monitors()
    first, again = (part.measure(TORQUE_NM, SPEED_RADPS) for _ in range(2))
    assert first.current_a.tolist() == again.current_a.tolist()
    assert first.current_a.tolist() != monitors(2).measure(TORQUE_NM,
                                                           SPEED_RADPS).current_a.tolist()


def test_values_come_in_steps_and_end_at_the_range():
    shown = monitors(shunt_ohm=0.5, shunt_step_v=0.01).measure([1.2] * 4, [3.0] * 4)
    assert shown.current_a == pytest.approx([0.08 / 0.5] * 5)
    steps = monitors().measure(TORQUE_NM, SPEED_RADPS).current_a * 0.02 / 2.5e-6
    assert np.abs(steps - np.round(steps)).max() < 1e-6
    smooth = monitors(shunt_step_v=0.0, bus_step_v=0.0, shunt_offset_v=0.0, bus_offset_v=0.0,
                      gain_error=0.0).measure(TORQUE_NM, SPEED_RADPS)
    exact = monitors(enabled=False).measure(TORQUE_NM, SPEED_RADPS)
    assert smooth.current_a == pytest.approx(exact.current_a)
