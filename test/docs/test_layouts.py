"""The layouts of RViz and Foxglove show topics that there are, in displays of their types."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_typestore, Stores
import yaml

from lunar_rover_sim.bag import ground_points
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.files.paths import packaged_names
from lunar_rover_sim.base.parameters import NAME
from lunar_rover_sim.image.lidar.scan import POINT
from lunar_rover_sim.rover.description import load_rover

CONFIG = Path(__file__).parents[2] / 'config'
# Type → the display of RViz that shows it.
SHOWN = {'sensor_msgs/msg/Image': 'Image', 'sensor_msgs/msg/PointCloud2': 'PointCloud2',
         'sensor_msgs/msg/LaserScan': 'LaserScan', 'nav_msgs/msg/Odometry': 'Odometry',
         'geometry_msgs/msg/PoseStamped': 'Pose', 'geometry_msgs/msg/WrenchStamped': 'Wrench',
         'geometry_msgs/msg/TwistStamped': 'TwistStamped',
         'nav_msgs/msg/OccupancyGrid': 'Map', 'nav_msgs/msg/Path': 'Path'}
# The legs of all packaged rovers.
CONTRACT = topics.of_legs(topics.CONTRACT, dict.fromkeys(
    leg for name in packaged_names('rover') for leg in load_rover(name).legs.names))
ALL = {topic.name.replace(NAME, 'front'): topic for topic in CONTRACT
       if topic.type in SHOWN}
NAMES = {topic.name.replace(NAME, 'front'): topic for topic in CONTRACT}
STORE = get_typestore(Stores.ROS2_JAZZY)


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
    for name, display in displays.items():
        topic = ALL[name]
        assert display['Class'] == f'rviz_default_plugins/{SHOWN[topic.type]}'
        durability = display['Topic']['Durability Policy']
        assert (durability == 'Transient Local') == (topic.rate == topics.LATCHED), name


def test_plots_are_of_numbers_that_messages_have(panels: dict[str, dict[str, Any]]) -> None:
    for panel in panels.values():
        for path in panel.get('paths', ()):
            name, _, fields = path['value'][1:].partition('.')
            assert _is_number(NAMES[name].type, fields), path['value']


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


def test_foxglove_shows_topics_that_there_are(panels: dict[str, dict[str, Any]]) -> None:
    shown = set(panels['3D!scene']['topics'])
    for panel in panels.values():
        mode = panel.get('imageMode', {})
        shown |= {mode[key] for key in ('imageTopic', 'calibrationTopic') if key in mode}
    assert {name[1:] for name in shown if not name.startswith('/studio_script/')} <= set(NAMES)


def test_images_that_viewers_refuse_are_shown_otherwise() -> None:
    """Depth as millimetres, since metres are drawn from 0 to 1; a fisheye without CameraInfo.

    Lichtblick draws no image whose CameraInfo it does not know.
    """
    document = json.loads((CONFIG / 'foxglove/lunar_rover.json').read_text())
    for panel in document['configById'].values():
        mode = panel.get('imageMode', {'imageTopic': ''})
        assert not mode['imageTopic'].endswith('depth/image')
        assert 'hazard' not in mode.get('calibrationTopic', '')


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
