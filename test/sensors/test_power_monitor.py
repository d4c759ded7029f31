"""The power monitors: the electric power of the motors, with the errors of a measuring part."""

import numpy as np
from physics_scene import ROVER, step_world, sun_seen
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.image.illumination.sun_view import SeenSun
from lunar_rover_sim.rover.description import Motor
from lunar_rover_sim.rover.physics.config import PhysicsConfig, StartPose
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.sensors.power_monitor import PowerMonitorConfig, PowerMonitors
from lunar_rover_sim.sensors.solar_panel import solar_power_w, SolarPanelConfig

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
    shown = monitors(shunt_ohm=0.5).measure([1.2] * 4, [3.0] * 4)
    assert shown.current_a == pytest.approx([0.08192 / 0.5] * 5)
    steps = monitors().measure(TORQUE_NM, SPEED_RADPS).current_a * 0.02 / 2.5e-6
    assert np.abs(steps - np.round(steps)).max() < 1e-6


PANEL = SolarPanelConfig()


def test_power_of_a_level_and_of_a_tilted_panel():
    """Twelve cells of 26.51 cm2 at 29.6 % under 1361 W/m2 give 12.8 W to a sun overhead."""
    whole = SeenSun(np.array([0.0, 0.0, 1.0]), 1.0)
    assert solar_power_w(PANEL, whole, 1361.0, np.eye(3)) == pytest.approx(12.81, abs=0.01)
    low = SeenSun(sun_direction(40.0, 6.0), 0.5)
    expected = 1361.0 * 0.5 * np.sin(np.radians(6.0)) * PANEL.area_m2 * PANEL.efficiency
    assert solar_power_w(PANEL, low, 1361.0, np.eye(3)) == pytest.approx(expected)
    # A panel to the left of a rover that heads 20 deg north of east, with the sun at 60 deg.
    side = SolarPanelConfig(normal=(0.0, 3.0, 0.0), area_m2=1.0, efficiency=0.25)
    turned = Rotation.from_euler('Z', 20.0, degrees=True).as_matrix()
    sun = SeenSun(sun_direction(60.0, 10.0), 1.0)
    cosine = np.cos(np.radians(50.0)) * np.cos(np.radians(10.0))
    assert solar_power_w(side, sun, 1000.0, turned) == pytest.approx(250.0 * cosine)
    assert solar_power_w(side, SeenSun(sun_direction(-100.0, 10.0), 1.0), 1000.0, turned) == 0.0
    assert solar_power_w(PANEL, None, 1361.0, np.eye(3)) == 0.0


def test_in_the_shadow_of_a_step():
    """A step of 1 m, 2 m east of the rover, hides a sun below 26 deg."""
    world = step_world()
    with Simulation(world, ROVER, PhysicsConfig(start=StartPose(yaw_deg=180.0))) as simulation:
        def power(azimuth_deg, elevation_deg):
            sun = sun_seen(simulation, world, PANEL.position_m, azimuth_deg, elevation_deg)
            return solar_power_w(PANEL, sun, 1361.0, simulation.state.T_world_base[:3, :3])

        assert power(0.0, 20.0) == 0.0
        assert power(0.0, 30.0) == pytest.approx(0.5 * 12.81, rel=0.05)
