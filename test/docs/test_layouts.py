"""The layouts of RViz and Foxglove show every topic that they can show."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from lunar_rover_sim import topics
from lunar_rover_sim.bag import ground_points
from lunar_rover_sim.lidar.scan import POINT
from lunar_rover_sim.named_sets import NAME

CONFIG = Path(__file__).parents[2] / 'config'
# Type → the display of RViz that shows it.
SHOWN = {'sensor_msgs/msg/Image': 'Image', 'sensor_msgs/msg/PointCloud2': 'PointCloud2',
         'sensor_msgs/msg/LaserScan': 'LaserScan', 'nav_msgs/msg/Odometry': 'Odometry',
         'nav_msgs/msg/Path': 'Path', 'geometry_msgs/msg/PoseStamped': 'Pose'}
# Images of two or three floats, which neither shows; the pose that another simulator is told.
NOT_SHOWN = {topics.NORMALS.name, topics.RIGHT_NORMALS.name, topics.OPTICAL_FLOW.name,
             topics.SCENE_FLOW.name, topics.TELEPORT.name}
EXPECTED = {topic.name.replace(NAME, 'front'): topic for topic in topics.CONTRACT
            if topic.type in SHOWN and topic.name not in NOT_SHOWN}


@pytest.fixture(scope='module')
def displays() -> dict[str, dict[str, Any]]:
    """Return topic → the display of the layout of RViz."""
    layout = yaml.safe_load((CONFIG / 'rviz/lunar_rover.rviz').read_text())
    found = layout['Visualization Manager']['Displays']
    return {display['Topic']['Value']: display for display in found if 'Topic' in display}


def test_rviz(displays: dict[str, dict[str, Any]]) -> None:
    """Each in a display of its type, which asks for what is offered."""
    assert set(displays) == set(EXPECTED)
    for name, topic in EXPECTED.items():
        display = displays[name]
        assert display['Class'] == f'rviz_default_plugins/{SHOWN[topic.type]}'
        durability = display['Topic']['Durability Policy']
        assert (durability == 'Transient Local') == (topic.rate == topics.LATCHED), name


def test_foxglove(displays: dict[str, dict[str, Any]]) -> None:
    """Images in panels of their own, each placed in the layout; the rest in the scene."""
    document = json.loads((CONFIG / 'foxglove/lunar_rover.json').read_text())
    panels = document['configById']
    images = {panel['imageMode']['imageTopic'][1:]: name for name, panel in panels.items()
              if 'imageMode' in panel}
    scene = {name[1:] for name in panels['3D!scene']['topics']}
    expected = {name for name, topic in EXPECTED.items() if SHOWN[topic.type] == 'Image'}
    assert set(images) == expected
    assert set(EXPECTED) - expected <= scene <= set(EXPECTED) | {'robot_description'}
    placed = json.dumps(document['layout']) + json.dumps(panels['Tab!truth'])
    assert all(f'"{panel}"' in placed for panel in panels)


def test_colours_are_of_fields_that_clouds_have(displays: dict[str, dict[str, Any]]) -> None:
    fields = {*POINT.names, *ground_points.POINT.names}
    assert {display['Channel Name'] for display in displays.values()
            if 'Channel Name' in display} <= fields
