"""The layouts of RViz and Foxglove show every topic that they can show."""

from __future__ import annotations

import json
from pathlib import Path
import re
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
# Images of two or three floats: RViz shows their colours, Foxglove makes colours of them.
FLOATS = {topic.name.removesuffix('/image_color') for topic in topics.OF_COLOURS}
COLOURS = {topic.name for topic in topics.OF_COLOURS}
# But for the pose that another simulator is told.
ALL = {topic.name.replace(NAME, 'front'): topic for topic in topics.CONTRACT
       if topic.type in SHOWN and topic is not topics.TELEPORT}
EXPECTED = {name: topic for name, topic in ALL.items() if name not in FLOATS}
# Properties of the displays of RViz 2 (rviz_default_plugins, those that may be of use here).
CLOUD = {'Topic', 'Selectable', 'Style', 'Size (m)', 'Size (Pixels)', 'Alpha', 'Decay Time',
         'Position Transformer', 'Color Transformer', 'Channel Name', 'Use rainbow',
         'Invert Rainbow', 'Min Color', 'Max Color', 'Autocompute Intensity Bounds',
         'Min Intensity', 'Max Intensity'}
PROPERTIES: dict[str, set[str]] = {
    'Grid': {'Reference Frame', 'Plane Cell Count', 'Cell Size', 'Color', 'Alpha', 'Plane'},
    'TF': {'Show Names', 'Show Axes', 'Show Arrows', 'Marker Scale', 'Update Interval',
           'Frame Timeout'},
    'RobotModel': {'Visual Enabled', 'Collision Enabled', 'Update Interval', 'Alpha',
                   'Description Source', 'Description File', 'Description Topic', 'TF Prefix'},
    'Odometry': {'Topic', 'Position Tolerance', 'Angle Tolerance', 'Keep', 'Shape', 'Covariance'},
    'Image': {'Topic', 'Normalize Range', 'Min Value', 'Max Value', 'Median window'},
    'PointCloud2': CLOUD, 'LaserScan': CLOUD,
    'Pose': {'Topic', 'Shape', 'Color', 'Alpha', 'Axes Length', 'Axes Radius'}}
QOS = {'Value', 'Depth', 'History Policy', 'Reliability Policy', 'Durability Policy',
       'Filter size'}


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
    made_of = dict(_ends(script['sourceCode']) for script in document['userNodes'].values())
    shown = [panel['imageMode']['imageTopic'] for panel in panels.values() if 'imageMode' in panel]
    images = {made_of.pop(topic, topic)[1:] for topic in shown}
    assert not made_of      # no script that nobody shows
    scene = {name[1:] for name in panels['3D!scene']['topics']}
    expected = {name for name, topic in ALL.items() if SHOWN[topic.type] == 'Image'} - COLOURS
    assert images == expected and len(shown) == len(expected)
    assert set(EXPECTED) - expected - COLOURS <= scene <= set(EXPECTED) | {'robot_description'}
    placed = json.dumps(document['layout']) + json.dumps(panels['Tab!images'])
    assert all(placed.count(f'"{panel}"') == 1 for panel in panels)


def _ends(source: str) -> tuple[str, str]:
    """Return what a script of Foxglove publishes, and what it reads."""
    reads = re.search(r'inputs = \["(.+)"\]', source)
    publishes = re.search(r'output = "(/studio_script/.+)"', source)
    assert reads and publishes and f'Input<"{reads[1]}">' in source
    return publishes[1], reads[1]


def test_images_that_viewers_refuse_are_shown_otherwise() -> None:
    """Depth as millimetres, since metres are drawn from 0 to 1; a fisheye without CameraInfo.

    Lichtblick draws no image whose CameraInfo it does not know.
    """
    document = json.loads((CONFIG / 'foxglove/lunar_rover.json').read_text())
    for panel in document['configById'].values():
        mode = panel.get('imageMode', {'imageTopic': ''})
        assert not mode['imageTopic'].endswith('depth/image')
        assert 'hazard' not in mode.get('calibrationTopic', '')


def test_rviz_has_no_property_that_its_displays_lack() -> None:
    """RViz passes over names that it does not know, so that a slip is not seen."""
    layout = yaml.safe_load((CONFIG / 'rviz/lunar_rover.rviz').read_text())
    for display in layout['Visualization Manager']['Displays']:
        kind = display['Class'].rpartition('/')[2]
        assert set(display) <= {'Class', 'Name', 'Enabled', 'Value', *PROPERTIES[kind]}, kind
        for topic in (display.get('Topic'), display.get('Description Topic')):
            assert topic is None or set(topic) <= QOS
        if kind == 'Odometry':
            assert set(display['Shape']) <= {'Value', 'Axes Length', 'Axes Radius'}


def test_colours_are_of_fields_that_clouds_have(displays: dict[str, dict[str, Any]]) -> None:
    fields = {*POINT.names, *ground_points.POINT.names}
    assert {display['Channel Name'] for display in displays.values()
            if 'Channel Name' in display} <= fields
