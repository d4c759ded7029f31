"""Launch arguments that nobody declares: `ros2 launch` passes over them."""

from __future__ import annotations

import pytest

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.run.plan import check_launch_arguments

VALID = 'scenario', 'output', 'duration'


def test_a_mistyped_name_is_refused() -> None:
    with pytest.raises(ConfigError, match='scenari: no such launch argument; did you mean scenar'):
        check_launch_arguments(['output:=x', 'scenari:=flat'], VALID)


def test_arguments_of_a_launch_file_around_it_are_not() -> None:
    check_launch_arguments(['scenario:=flat', 'rovers:=a b', 'use_rviz:=true', '--debug'], VALID)
