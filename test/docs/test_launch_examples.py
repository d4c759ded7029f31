"""Launch files for other packages: Python that parses, and topics of ours with their types."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest
from snippets import ROOT
import yaml

from lunar_rover_sim.autonomy.navigation.config import MapConfig
from lunar_rover_sim.base import topics
from lunar_rover_sim.judge.slam.live import WRAPPERS
from lunar_rover_sim.rover.description import load_rover

EXAMPLES = sorted((ROOT / 'config' / 'launch_examples').glob('*.launch.py'))
KINDS = {topic.name: topic.type.rpartition('/')[2] for topic in topics.CONTRACT}
# What the topics of other packages carry.
READ = {'left/image_rect': 'Image', 'left/image_rect_color': 'Image',
        'left/camera_info': 'CameraInfo', 'right/image_rect': 'Image',
        'right/camera_info': 'CameraInfo', 'odom0': 'Odometry', 'imu0': 'Imu', 'imu1': 'Imu'}


def constants(path: Path) -> dict[str, Any]:
    """Return the values that a file assigns to names in capitals."""
    values: dict[str, Any] = {}
    for node in ast.parse(path.read_text(encoding='utf-8')).body:
        if isinstance(node, ast.Assign):
            names = [name.id for target in node.targets for name in ast.walk(target)
                     if isinstance(name, ast.Name)]
            exec(compile(ast.Module([node], []), path.name, 'exec'), values)
            assert all(name.isupper() for name in names)
    return values


@pytest.mark.parametrize('path', EXAMPLES, ids=lambda path: path.name.partition('.')[0])
def test_example(path: Path) -> None:
    """A page names it, and each topic that it takes from us exists with the type it reads."""
    assert f'`{path.name}`' in (ROOT / 'docs/howto/stacks.md').read_text(encoding='utf-8')
    values = constants(path)
    pairs = [*values.get('PAIR', ()), *values.get('REMAPPINGS', ()),
             *((key, value) for key, value in values.get('EKF', {}).items() if key in READ)]
    taken = [(theirs, ours) for theirs, ours in pairs if theirs in READ]
    assert taken or path.name.startswith(('nav2', 'orb_slam3', 'ros2_control'))
    for theirs, ours in taken:
        assert KINDS[ours] == READ[theirs], (theirs, ours)
    if 'ARGUMENTS' in values:
        assert values['ARGUMENTS']['wrapper'] in WRAPPERS
        assert values['ARGUMENTS']['sensor'] in WRAPPERS[values['ARGUMENTS']['wrapper']]
        path = ROOT / 'lunar_rover_sim/nodes/launch/slam.launch.py'
        text = path.read_text('utf-8')
        assert all(f"'{name}':" in text for name in values['ARGUMENTS'])


def test_parameters_of_nav2() -> None:
    """Its servers are those that the launch file starts, on topics and frames of ours."""
    folder = ROOT / 'config' / 'launch_examples'
    nodes = yaml.safe_load((folder / 'nav2.yaml').read_text('utf-8'))
    servers = set(constants(folder / 'nav2.launch.py')['SERVERS'].values())
    manager = nodes['lifecycle_manager_navigation']['ros__parameters']
    assert set(manager['node_names']) == servers <= set(nodes)
    costmaps = nodes['/*/*']['ros__parameters']
    assert KINDS[costmaps['ground']['map_topic'].removeprefix('/')] == 'OccupancyGrid'
    for server in ('bt_navigator', 'controller_server'):
        assert KINDS[nodes[server]['ros__parameters']['odom_topic']] == 'Odometry'
    assert costmaps['resolution'] == MapConfig().cell_m
    # Else a recorder of all topics ends its servers by a segmentation fault.
    assert costmaps['always_send_full_costmap']


def test_controllers_of_ros2_control() -> None:
    """They are those that the launch file spawns, on the joints of the packaged rover."""
    folder = ROOT / 'config' / 'launch_examples'
    nodes = yaml.safe_load((folder / 'ros2_control.yaml').read_text('utf-8'))
    manager = nodes['controller_manager']['ros__parameters']
    spawned = constants(folder / 'ros2_control.launch.py')['CONTROLLERS']
    assert all('type' in manager[name] for name in spawned)
    joints = load_rover(None).legs.joint_names
    assert nodes['legs']['ros__parameters']['joints'] == list(joints)
