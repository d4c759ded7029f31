"""Walking without ROS, as a Python user would type it, and what becomes of bad input there."""

from pathlib import Path

from physics_scene import make_world
import pytest

from lunar_rover_sim.base.errors import ConfigError
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
