"""Parameters of sensors that no sensor can have."""

import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.run.node_config import PhysicsNodeConfig


@pytest.mark.parametrize('name, value', [
    ('solar_panel.normal', [0.0, 0.0, 0.0]), ('solar_panel.efficiency', 1.2),
    ('solar_panel.rate_hz', 7), ('sun_sensor.rate_hz', 7), ('star_tracker.rate_hz', 3),
    ('wheel_odometry.forward_scale', 0.05), ('wheel_odometry.yaw_scale', 0.0),
    ('wheel_odometry.forward_stddev', -0.5), ('wheel_odometry.lateral_stddev', -0.5),
    ('wheel_odometry.yaw_stddev', -0.5)])
def test_it_is_refused_in_one_line_that_names_it(name, value):
    with pytest.raises(ConfigError, match=f'{name}: ') as error:
        PhysicsNodeConfig.from_mapping({name: value})
    assert '\n' not in str(error.value)
