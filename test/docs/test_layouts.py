"""The layouts of RViz and Foxglove show every topic but for those that are listed here."""

from __future__ import annotations

import json
from pathlib import Path
import re
from typing import Any

import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_typestore, Stores
import yaml

from lunar_rover_sim.bag import ground_points
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.files.paths import packaged_names
from lunar_rover_sim.base.named_sets import NAME
from lunar_rover_sim.image.lidar.scan import POINT
from lunar_rover_sim.rover.rover_file import load_rover

CONFIG = Path(__file__).parents[2] / 'config'
# Type → the display of RViz that shows it.
SHOWN = {'sensor_msgs/msg/Image': 'Image', 'sensor_msgs/msg/PointCloud2': 'PointCloud2',
         'sensor_msgs/msg/LaserScan': 'LaserScan', 'nav_msgs/msg/Odometry': 'Odometry',
         'geometry_msgs/msg/PoseStamped': 'Pose', 'geometry_msgs/msg/WrenchStamped': 'Wrench',
         'geometry_msgs/msg/TwistStamped': 'TwistStamped',
         'nav_msgs/msg/OccupancyGrid': 'Map', 'nav_msgs/msg/Path': 'Path'}
# Images of two or three floats: RViz shows their colours, Foxglove makes colours of them.
FLOATS = {topic.name.removesuffix('/image_color') for topic in topics.OF_COLOURS}
COLOURS = {topic.name for topic in topics.OF_COLOURS}
# The legs of all packaged rovers.
CONTRACT = topics.of_legs(topics.CONTRACT, dict.fromkeys(
    leg for name in packaged_names('rover') for leg in load_rover(name).legs.names))
ALL = {topic.name.replace(NAME, 'front'): topic for topic in CONTRACT
       if topic.type in SHOWN}
EXPECTED = {name: topic for name, topic in ALL.items() if name not in FLOATS}
NAMES = {topic.name.replace(NAME, 'front'): topic for topic in CONTRACT}
# What neither layout shows, and why.
NOT_SHOWN = {
    'clock': 'the time of the viewer itself',
    'tf': 'the scene reads it by itself',
    'tf_static': 'the scene reads it by itself',
    'stereo/disparity': 'no viewer draws its type; stereo/depth/image is made of it',
    'stereo/left/image_raw/compressed': 'the picture of stereo/left/image_raw',
    'stereo/right/image_raw/compressed': 'the picture of stereo/right/image_raw',
    'stereo/depth/camera_info': 'that of the left camera',
    'hazard/front/camera_info': 'Lichtblick draws no image of a fisheye with one',
    'ground_truth/label_info': 'text, JSON',
    'ground_truth/boxes': 'of vision_msgs, which needs a plugin',
    'ground_truth/label_classes': 'of vision_msgs, which needs a plugin',
    'ground_truth/vision_info': 'of vision_msgs, which needs a plugin',
    'world_hash': 'text',
    'scenario': 'text, YAML',
    'lidar/scanned': 'a stamp, by which lockstep waits',
    'recorder/written': 'a stamp, by which lockstep waits',
    'map/grid_map': 'of grid_map_msgs, which needs a plugin; the same is shown as a cloud',
    'navigator/finished': 'a stamp, at which a run ends',
    'ground_truth/miscalibration': 'a text'}
NOT_IN_FOXGLOVE = {**NOT_SHOWN, **dict.fromkeys(COLOURS, 'a script makes them of the floats')}
STORE = get_typestore(Stores.ROS2_JAZZY)
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
    'Pose': {'Topic', 'Shape', 'Color', 'Alpha', 'Axes Length', 'Axes Radius'},
    'Wrench': {'Topic', 'Accept NaN Values', 'Force Color', 'Torque Color', 'Alpha',
               'Force Arrow Scale', 'Torque Arrow Scale', 'Arrow Width', 'History Length'},
    'Map': {'Topic', 'Update Topic', 'Alpha', 'Color Scheme', 'Draw Behind', 'Use Timestamp'},
    'Path': {'Topic', 'Color', 'Alpha', 'Line Style', 'Line Width', 'Buffer Length', 'Offset',
             'Pose Style'},
    'TwistStamped': {'Topic', 'Linear Color', 'Angular Color', 'Alpha', 'Linear Arrow Scale',
                     'Angular Arrow Scale', 'Arrow Width', 'Hide Small Values',
                     'History Length'}}
QOS = {'Value', 'Depth', 'History Policy', 'Reliability Policy', 'Durability Policy',
       'Filter size'}


@pytest.fixture(scope='module')
def displays() -> dict[str, dict[str, Any]]:
    """Return topic → the display of the layout of RViz."""
    layout = yaml.safe_load((CONFIG / 'rviz/lunar_rover.rviz').read_text())
    found = layout['Visualization Manager']['Displays']
    return {display['Topic']['Value']: display for display in found if 'Topic' in display}


@pytest.fixture(scope='module')
def panels() -> dict[str, dict[str, Any]]:
    """Return the panels of the layout of Foxglove."""
    document = json.loads((CONFIG / 'foxglove/lunar_rover.json').read_text())
    found: dict[str, dict[str, Any]] = document['configById']
    return found


def test_rviz(displays: dict[str, dict[str, Any]]) -> None:
    """Each in a display of its type, which asks for what is offered."""
    assert set(displays) == set(EXPECTED)
    for name, topic in EXPECTED.items():
        display = displays[name]
        assert display['Class'] == f'rviz_default_plugins/{SHOWN[topic.type]}'
        durability = display['Topic']['Durability Policy']
        assert (durability == 'Transient Local') == (topic.rate == topics.LATCHED), name


def test_every_topic_is_in_foxglove(panels: dict[str, dict[str, Any]]) -> None:
    document = json.loads((CONFIG / 'foxglove/lunar_rover.json').read_text())
    made_of = dict(_ends(script['sourceCode']) for script in document['userNodes'].values())
    shown = {path['value'].partition('.')[0] for panel in panels.values()
             for path in panel.get('paths', ())}
    shown |= set(panels['3D!scene']['topics'])
    for panel in panels.values():
        mode = panel.get('imageMode', {})
        shown |= {mode[key] for key in ('imageTopic', 'calibrationTopic') if key in mode}
        if 'topicToRender' in panel:
            shown.add(panel['topicToRender'])
    names = {made_of.get(name, name)[1:] for name in shown}
    assert names.isdisjoint(NOT_IN_FOXGLOVE)
    assert names | set(NOT_IN_FOXGLOVE) == set(NAMES)


def test_plots_are_of_numbers_that_messages_have(panels: dict[str, dict[str, Any]]) -> None:
    for panel in panels.values():
        for path in panel.get('paths', ()):
            name, _, fields = path['value'][1:].partition('.')
            assert _is_number(NAMES[name].type, fields), path['value']


def test_panels_of_diagnostics_are_of_their_type(panels: dict[str, dict[str, Any]]) -> None:
    shown = [panel['topicToRender'][1:] for panel in panels.values() if 'topicToRender' in panel]
    assert {NAMES[name].type for name in shown} == {'diagnostic_msgs/msg/DiagnosticArray'}


def _is_number(kind: str, fields: str) -> bool:
    """Return whether `a.b[0]` leads from a message to one number."""
    node: Any = Nodetype.NAME
    of: Any = kind
    for field in fields.split('.'):
        name, index, _ = field.partition('[')
        node, of = dict(STORE.fielddefs[of][1])[name]
        if index:
            assert node in (Nodetype.ARRAY, Nodetype.SEQUENCE)
            node, of = of[0]
    return node == Nodetype.BASE and of[0] != 'string'


def test_foxglove() -> None:
    """Images in panels of their own; what has a place in the scene there, or in a plot."""
    document = json.loads((CONFIG / 'foxglove/lunar_rover.json').read_text())
    panels = document['configById']
    made_of = dict(_ends(script['sourceCode']) for script in document['userNodes'].values())
    shown = [panel['imageMode']['imageTopic'] for panel in panels.values() if 'imageMode' in panel]
    images = {made_of.pop(topic, topic)[1:] for topic in shown}
    assert not made_of      # no script that nobody shows
    scene = {name[1:] for name in panels['3D!scene']['topics']}
    expected = {name for name, topic in ALL.items() if SHOWN[topic.type] == 'Image'} - COLOURS
    assert images == expected and len(shown) == len(expected)
    plotted = {name for name, topic in ALL.items()
               if SHOWN[topic.type] in ('Wrench', 'TwistStamped')}
    assert scene == set(EXPECTED) - expected - COLOURS - plotted | {'robot_description'}
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


def test_sixteen_bits_are_not_white(displays: dict[str, dict[str, Any]],
                                    panels: dict[str, dict[str, Any]]) -> None:
    """Bounds are those of mono16; images of 8 bits have none in either viewer."""
    cameras = [name for name in displays if name.endswith('/image_raw')]
    assert len(cameras) == 4
    modes = {mode['imageTopic'][1:]: mode for panel in panels.values()
             if (mode := panel.get('imageMode'))}
    for name in cameras:
        assert (displays[name]['Min Value'], displays[name]['Max Value']) == (0, 65535), name
        assert (modes[name]['minValue'], modes[name]['maxValue']) == (0, 65535), name
    assert displays[topics.POINTS.name]['Autocompute Intensity Bounds'] is True


def test_colours_are_of_fields_that_clouds_have(displays: dict[str, dict[str, Any]]) -> None:
    fields = {'z', *POINT.names, *ground_points.POINT.names}
    assert {display['Channel Name'] for display in displays.values()
            if 'Channel Name' in display} <= fields
