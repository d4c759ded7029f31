"""Parameter files and launch arguments as ROS 2 gives them."""

from pathlib import Path
import re

import pytest
import yaml

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.run.params_files import arguments_of_program
from lunar_rover_sim.run.plan import check_launch_arguments
from lunar_rover_sim.run.scenario import Scenario

FILE = """
/**: {ros__parameters: {seed: 3, world: /w}}
drive_node: {ros__parameters: {seed: 4, shape.size: 2.0}}
physics_node: {ros__parameters: {step_s: 0.001}}
/rover2/drive_node: {ros__parameters: {seed: 5}}
"""


def arguments(path: Path, folder: Path, program: str = 'drive_node') -> list[str]:
    """Return the arguments of a node that is given a file."""
    return arguments_of_program(
        [program, '--params-file', 'of the program', '--ros-args', '--params-file', str(path),
         '-p', 'seed:=9'], program, folder)


@pytest.mark.parametrize('name', ['drive_node', '/**/drive_node'])
def test_the_section_of_a_program_holds_under_every_name(tmp_path: Path, name: str) -> None:
    """It joins `/**`, where later arguments win; other sections keep their meaning for ROS 2."""
    path = tmp_path / 'file.yaml'
    path.write_text(FILE.replace('\ndrive_node', f'\n{name}'))
    given = arguments(path, tmp_path)
    assert given[:5] == ['drive_node', '--params-file', 'of the program', '--ros-args',
                         '--params-file'] and given[6:] == ['-p', 'seed:=9']
    sections = yaml.safe_load(Path(given[5]).read_text())
    assert sections['/**']['ros__parameters'] == {'seed': 4, 'world': '/w', 'shape.size': 2.0}
    assert sections['/rover2/drive_node']['ros__parameters'] == {'seed': 5}
    assert 'drive_node' not in sections and 'physics_node' in sections


def test_a_file_without_the_program_is_left_alone(tmp_path: Path) -> None:
    """Also one of another package."""
    path = tmp_path / 'file.yaml'
    path.write_text(FILE)
    assert arguments(path, tmp_path, 'render_node')[5] == str(path)


@pytest.mark.parametrize(('text', 'said'), [
    (None, 'no such file'), ('a: [1', 'not valid YAML'), ('- 1', 'not a parameter file'),
    ('drive_node: {seed: 1}', "section 'drive_node' must hold 'ros__parameters'"),
    ('drive_node: {ros__parameters: 1}', 'not a mapping of parameters')])
def test_bad_files_are_named(tmp_path: Path, text: str | None, said: str) -> None:
    """In one line, instead of an error of rcl's parser with a traceback."""
    path = tmp_path / 'file.yaml'
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=said):
        arguments(path, tmp_path)


def test_a_scenario_may_name_nodes_in_every_namespace(tmp_path: Path) -> None:
    """As ROS 2 users write it; but not both ways in one file."""
    path = tmp_path / 'scenario.yaml'
    path.write_text('/**/drive_node: {ros__parameters: {speed_mps: 0.07}}\n')
    assert Scenario.load(path).drive_node.speed_mps == 0.07
    path.write_text(path.read_text() + 'drive_node: {ros__parameters: {speed_mps: 0.08}}\n')
    with pytest.raises(ConfigError, match='section drive_node is given twice'):
        Scenario.load(path)


@pytest.mark.parametrize(('value', 'said'), [
    ('[]', '-p topics: [] is not valid: ROS 2 gives an empty list no type; leave the parameter'),
    ('[ ]', '-p topics: [] is not valid'),
    ('[[1], [2]]', 'valid is a list of numbers or of texts'),
    ('[{a: 1}]', 'valid is a list of numbers or of texts'), ('[1', 'not valid YAML')])
def test_lists_that_ros_does_not_take_are_named(tmp_path: Path, value: str, said: str) -> None:
    """On the command line and in a file; it would say nothing of the parameter, or drop items."""
    words = ['recorder_node', '--ros-args', '-p', f'topics:={value}']
    with pytest.raises(ConfigError, match=re.escape(said)):
        arguments_of_program(words, 'recorder_node', tmp_path)
    path = tmp_path / 'file.yaml'
    path.write_text(f'/**: {{ros__parameters: {{topics: {value}}}}}\n')
    with pytest.raises(ConfigError, match='file.yaml.*not valid'):
        arguments(path, tmp_path, 'recorder_node')
    words[-1] = 'topics:=[odom, imu/data_raw]'
    assert arguments_of_program(words, 'recorder_node', tmp_path) == words


VALID = 'scenario', 'output', 'duration'


def test_a_mistyped_name_is_refused() -> None:
    with pytest.raises(ConfigError, match='scenari: no such launch argument; did you mean scenar'):
        check_launch_arguments(['output:=x', 'scenari:=flat'], VALID)


def test_arguments_of_a_launch_file_around_it_are_not() -> None:
    check_launch_arguments(['scenario:=flat', 'rovers:=a b', 'use_rviz:=true', '--debug'], VALID)
