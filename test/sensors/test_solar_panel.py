"""The power of a solar panel, against its closed form."""

import numpy as np
from physics_scene import ROVER, step_world, sun_seen
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.frames import sun_direction
from lunar_rover_sim.illumination.sun_view import SeenSun
from lunar_rover_sim.physics.config import PhysicsConfig, StartPose
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.run.node_config import PhysicsNodeConfig
from lunar_rover_sim.sensors.solar_panel import solar_power_w, SolarPanelConfig

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


def test_bad_input():
    with pytest.raises(ConfigError, match='normal: .0.0, 0.0, 0.0. is not valid; valid is a dire'):
        SolarPanelConfig(normal=(0.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match='efficiency: 1.2 is not valid; valid is >= 0 and <= 1'):
        SolarPanelConfig(efficiency=1.2)
    with pytest.raises(ConfigError, match='solar_panel.rate_hz: 7 is not valid; valid is a divis'):
        PhysicsNodeConfig(solar_panel=SolarPanelConfig(rate_hz=7))
