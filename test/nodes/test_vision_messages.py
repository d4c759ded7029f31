"""Messages of vision_msgs, on stubs with the fields of its version 4; definitions of any type."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rosbags.typesys import get_types_from_msg, get_typestore, Stores  # noqa: E402  (needs rclpy)
from rosbags.typesys.store import Typestore  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from lunar_rover_sim import topics  # noqa: E402
from lunar_rover_sim.errors import GraphError  # noqa: E402
from lunar_rover_sim.nodes import vision_conversions  # noqa: E402
from lunar_rover_sim.nodes.message_types import definition_of  # noqa: E402
from lunar_rover_sim.rendering.labels import class_names, LABEL_FIRST_ROCK  # noqa: E402
from lunar_rover_sim.sequences.instances import instances  # noqa: E402

# Fields of version 4 as rclpy tells them.
FIELDS: dict[str, dict[str, str]] = {
    'Point2D': {'x': 'double', 'y': 'double'},
    'Pose2D': {'position': 'vision_msgs/Point2D', 'theta': 'double'},
    'BoundingBox2D': {'center': 'vision_msgs/Pose2D', 'size_x': 'double', 'size_y': 'double'},
    'ObjectHypothesis': {'class_id': 'string', 'score': 'double'},
    'ObjectHypothesisWithPose': {'hypothesis': 'vision_msgs/ObjectHypothesis',
                                 'pose': 'geometry_msgs/PoseWithCovariance'},
    'Detection2D': {'header': 'std_msgs/Header',
                    'results': 'sequence<vision_msgs/ObjectHypothesisWithPose>',
                    'bbox': 'vision_msgs/BoundingBox2D', 'id': 'string'},
    'Detection2DArray': {'header': 'std_msgs/Header',
                         'detections': 'sequence<vision_msgs/Detection2D>'},
    'VisionClass': {'class_id': 'uint16', 'class_name': 'string'},
    'LabelInfo': {'header': 'std_msgs/Header', 'class_map': 'sequence<vision_msgs/VisionClass>',
                  'threshold': 'float'},
    'VisionInfo': {'header': 'std_msgs/Header', 'method': 'string',
                   'database_location': 'string', 'database_version': 'int32'}}
PLAIN = {'string': '', 'double': 0.0, 'float': 0.0, 'uint16': 0, 'int32': 0}


def stub(name: str) -> type:
    """Return a class with these fields, and no others."""
    fields = FIELDS[name]

    class Stub:
        __slots__ = tuple(fields)

        def __init__(self) -> None:
            for field, kind in fields.items():
                package, _, inner = kind.partition('/')
                value: Any = PLAIN.get(kind, [] if kind.startswith('sequence') else None)
                if package == 'vision_msgs':
                    value = stub(inner)()
                setattr(self, field, value)

        @classmethod
        def get_fields_and_field_types(cls) -> dict[str, str]:
            return fields

    return Stub


MSG: Any = SimpleNamespace(**{name: stub(name) for name in FIELDS})


def test_boxes_are_those_of_the_instances() -> None:
    """A rock of 4 x 3 and a crater of 5 x 6 pixels; one of 2 pixels has no box."""
    label, crater = np.ones((20, 30), np.int32), np.zeros((20, 30), np.int32)
    label[5:8, 10:14] = LABEL_FIRST_ROCK + 7
    label[0, 0:2] = LABEL_FIRST_ROCK + 8
    crater[10:16, 20:25] = 3
    found = vision_conversions.detections(MSG, instances(
        label, crater), Header(frame_id='eye'))
    rock, pit = found.detections
    assert (rock.id, pit.id) == ('rock 7', 'crater 2')
    for box, kind, centre, size in ((rock, 'rock', (12.0, 6.5), (4.0, 3.0)),
                                    (pit, 'crater', (22.5, 13.0), (5.0, 6.0))):
        assert (box.bbox.center.position.x, box.bbox.center.position.y) == centre
        assert (box.bbox.size_x, box.bbox.size_y) == size
        assert [(r.hypothesis.class_id, r.hypothesis.score) for r in box.results] == [(kind, 1.0)]
    assert found.header.frame_id == rock.header.frame_id == 'eye'


def test_names_and_method() -> None:
    names = class_names(2, ['left', 'right'])
    found = vision_conversions.label_info(MSG, names, Header())
    assert {c.class_id: c.class_name for c in found.class_map} == names
    told = vision_conversions.vision_info(MSG, 'abc', Header())
    assert (told.database_location, told.database_version) == ('abc', 0) and told.method


def learn(store: Typestore, name: str, definition: str) -> None:
    """Register a type and those it is made of."""
    store.register({part: fields for part, fields in get_types_from_msg(definition, name).items()
                    if part not in store.fielddefs})


def test_without_the_package_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'vision_msgs', None)
    assert vision_conversions.vision_messages() is None


@pytest.mark.parametrize('name', ['nav_msgs/msg/Odometry', 'sensor_msgs/msg/CameraInfo',
                                  'sensor_msgs/msg/PointCloud2', 'shape_msgs/msg/SolidPrimitive',
                                  'diagnostic_msgs/msg/DiagnosticArray'])
def test_definitions_are_those_of_the_type(name: str) -> None:
    """What is read off a class is what ROS 2 Jazzy declares: the hash of the type is the same."""
    known, fresh = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.EMPTY)
    learn(fresh, name, definition_of(name))
    assert fresh.hash_rihs01(name) == known.hash_rihs01(name)


def test_boxes_can_be_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bag learns their type from the classes, as far down as it goes."""
    package, module = ModuleType('vision_msgs'), ModuleType('vision_msgs.msg')
    for name in FIELDS:
        setattr(module, name, getattr(MSG, name))
    monkeypatch.setitem(sys.modules, 'vision_msgs', package)
    monkeypatch.setitem(sys.modules, 'vision_msgs.msg', module)
    store = get_typestore(Stores.ROS2_JAZZY)
    for topic in topics.OF_VISION:
        learn(store, topic.type, definition_of(topic.type))
    assert [name for name, _ in store.fielddefs['vision_msgs/msg/Detection2D'][1]] == list(
        FIELDS['Detection2D'])
    with pytest.raises(GraphError, match='nothing/Else: no such message type is installed'):
        definition_of('nothing/msg/Else')
