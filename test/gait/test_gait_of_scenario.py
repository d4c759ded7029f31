"""Walking without ROS, as a Python user would type it, and what becomes of bad input there."""

import math
from pathlib import Path

import numpy as np
from physics_scene import make_world
import pytest

from lunar_rover_sim.errors import ConfigError, GaitError, PhysicsError
from lunar_rover_sim.files.paths import config_path
from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.run.scenario import Scenario


@pytest.fixture()
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Worlds are built into an empty cache."""
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path))


def test_a_walk_without_ros(cache: None) -> None:
    """The rover walks forward at the commanded speed, on the world of its scenario."""
    scenario = Scenario.load('flat', ['world.size_m=6.4', 'world.surroundings.extent_m=4'], seed=3)
    gait = scenario.gait_controller()
    with scenario.simulation() as simulation:
        gait.set_velocity(0.1, 0.0)     # forward [m/s], yaw rate [rad/s]
        state = simulation.state
        for _ in range(600):
            legs = gait.update(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            state = simulation.advance(5)
    assert state.stamp_ns == 3_000_000_000
    # Half a second or so is spent on getting under way.
    assert 0.7 * 0.3 < state.position_m[0] < 0.3
    assert abs(state.position_m[1]) < 0.02


def test_a_scenario_on_a_world_of_my_own() -> None:
    """A world that is given is not built; start and step are those of the scenario."""
    scenario = Scenario.load('flat', ['physics_node.start.x_m=1.5', 'physics_node.step_s=0.0005'])
    with scenario.simulation(make_world()) as simulation:
        assert simulation.state.position_m[0] == pytest.approx(1.5, abs=0.02)
        assert simulation.advance(2).stamp_ns == 1_000_000


def test_a_gait_of_another_rover_is_refused() -> None:
    """As gait_controller_node says it."""
    scenario = Scenario.load('flat', ['rover.legs.spokes=5', 'gait_controller_node.spokes=3'])
    with pytest.raises(ConfigError, match='spokes: 3 is not valid for the gait; valid is 5'):
        scenario.gait_controller()


def test_the_gait_has_the_spokes_of_the_rover() -> None:
    """They are given once."""
    scenario = Scenario.load('flat', ['rover.legs.spokes=5'])
    assert scenario.gait_controller().config.spokes == 5


def test_a_calibration_that_is_missing_is_named() -> None:
    """The error tells how to make one."""
    scenario = Scenario.load('flat', ['gait_controller_node.calibration=none.yaml'])
    with pytest.raises(ConfigError, match='none.yaml cannot be read: .* `lunar_rover_sim calibr'):
        scenario.gait_controller()


def test_a_number_beyond_all_bounds_in_a_table(tmp_path: Path) -> None:
    """It is no traceback of Python, which holds integers of any size."""
    text = config_path('gait_calibrations/rigid.yaml').read_text()
    text = text.replace('turns: [', f'turns: [{10**400}, ')
    (tmp_path / 'table.yaml').write_text(text)
    with pytest.raises(ConfigError, match='table.yaml is not a table of numbers'):
        GaitCalibration.load(tmp_path / 'table.yaml')


def test_bad_input_raises_one_line_of_the_package() -> None:
    """What is not finite or of another shape is named with what is valid."""
    scenario = Scenario.load('flat')
    gait = scenario.gait_controller()
    with pytest.raises(GaitError, match=r'^velocity: nan m/s and 0.0 rad/s is not valid; valid'):
        gait.set_velocity(math.nan, 0.0)
    with pytest.raises(GaitError, match=r'^joint velocity: \[0.0\] is not valid; valid are 4'):
        gait.update(0, np.zeros(4), [0.0])
    with scenario.simulation(make_world()) as simulation:
        with pytest.raises(PhysicsError, match=r'^command: \[1.0, 2.0\] is not valid; valid is'):
            simulation.command([1.0, 2.0])
        with pytest.raises(PhysicsError, match=r'^advance: 0 is not valid; valid is a whole num'):
            simulation.advance(0)
    with pytest.raises(PhysicsError, match='^the simulation is closed$'):
        simulation.advance(1)


@pytest.mark.parametrize(('name', 'seed', 'message'), [
    ('flta', None, '^flta: no such scenario; did you mean flat'),
    ('flat', -1, 'seed: -1 is not valid; valid is >= 0'),
])
def test_a_scenario_that_is_none_is_refused(name: str, seed: int | None, message: str) -> None:
    """With the text of the command line."""
    with pytest.raises(ConfigError, match=message):
        Scenario.load(name, seed=seed)
