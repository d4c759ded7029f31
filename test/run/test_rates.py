"""Rates whose periods are whole, and those whose are not."""

import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.run.node_config import NODE_CONFIGS
from lunar_rover_sim.run.plan import resolve
from lunar_rover_sim.run.scenario import Scenario

NODES = ('physics_node', 'gait_controller_node', 'render_node', 'mapping_node', 'navigator_node',
         'lidar_node', 'recorder_node')
GIVEN = [f'run.nodes=[{", ".join(NODES)}]', 'physics_node.ground.model=regolith',
         'render_node.chase.enabled=true']
# What is no rate of messages: of the phases of legs, and the greatest of a LiDAR.
OTHERS = 'max_phase_rate_hz', 'settle_rate_hz', 'most_rate_hz'


def rates(values, prefix):
    """Return the dotted names of all rates of messages below a section."""
    names = []
    for key, value in values.items():
        name = f'{prefix}.{key}'
        if isinstance(value, dict):
            names += rates(value, name)
        elif key.endswith('rate_hz') and key not in OTHERS:
            names.append(name)
    return names


# slam_node takes the rates over from others: those are refused.
ALL = ['render_node.hazard.front.rate_hz', *(
    name for node, config in NODE_CONFIGS.items() if node != 'slam_node'
    for name in rates(config().to_mapping(), node))]


@pytest.mark.parametrize('name', ALL)
def test_a_rate_without_a_whole_period_is_refused_in_one_line(name):
    with pytest.raises(ConfigError, match=f'^{name}: 7 is not valid; valid is a ') as error:
        Scenario.load('baseline', [*GIVEN, f'{name}=7'])
    assert '\n' not in str(error.value)


def test_all_rates_are_looked_at():
    assert {'physics_node.state_rate_hz', 'physics_node.ground_rate_hz', 'lidar_node.rate_hz',
            'physics_node.star_tracker.rate_hz', 'render_node.frame_rate_hz',
            'render_node.chase.rate_hz', 'drive_node.rate_hz', 'navigator_node.rate_hz'} < set(ALL)


@pytest.mark.parametrize('rate_hz', [0.1, 0.2, 0.4, 0.8, 1.6, 6.25, 12.5])
def test_a_decimal_whose_period_is_whole_is_taken(rate_hz):
    """0.1, the least of its range, was refused: 200 % 0.1 is not 0."""
    scenario = resolve(Scenario.load('baseline', [
        'physics_node.ground.model=regolith', f'render_node.frame_rate_hz={rate_hz}',
        f'physics_node.ground_rate_hz={rate_hz}']))
    assert scenario.render_node.frame_period_ns * rate_hz == 1e9
    assert scenario.physics_node.ground_period_ns % scenario.physics_node.state_period_ns == 0
