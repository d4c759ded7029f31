"""Messages made from states and read back: axes, order, covariances; boxes of vision_msgs."""

import dataclasses
import os
import subprocess
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy')

from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from rosbags.typesys import get_types_from_msg, get_typestore, Stores  # noqa: E402  (needs rclpy)
from rosbags.typesys.store import Typestore  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from lunar_rover_sim.base import topics  # noqa: E402
from lunar_rover_sim.base.errors import GraphError  # noqa: E402
from lunar_rover_sim.image.rendering.labels import class_names  # noqa: E402
from lunar_rover_sim.image.rendering.labels import instances  # noqa: E402
from lunar_rover_sim.image.rendering.labels import LABEL_FIRST_ROCK  # noqa: E402
from lunar_rover_sim.nodes import conversions, image_conversions  # noqa: E402
from lunar_rover_sim.nodes.message_types import definition_of  # noqa: E402
from lunar_rover_sim.nodes.state_publisher import Refilled  # noqa: E402
from lunar_rover_sim.rover.description import Legs, RoverDescription  # noqa: E402
from lunar_rover_sim.rover.physics.state import RoverState  # noqa: E402
from lunar_rover_sim.sensors.wheel_odometry import Rolling, WheelOdometry  # noqa: E402
from lunar_rover_sim.sensors.wheel_odometry import WheelOdometryConfig  # noqa: E402

LEG_JOINTS = [f'{leg}_joint' for leg in Legs().names]


def odometry_of(state: RoverState) -> Odometry:
    """Return a message with the pose and the twist of a state."""
    msg = Odometry()
    conversions.set_vector(msg.pose.pose.position, state.position_m)
    q, numbers = msg.pose.pose.orientation, state.orientation_wxyz.tolist()
    q.w, q.x, q.y, q.z = numbers
    conversions.set_vector(msg.twist.twist.linear, state.linear_velocity_mps)
    conversions.set_vector(msg.twist.twist.angular, state.angular_velocity_radps)
    return msg


def test_odometry(state: RoverState) -> None:
    """Pose in odom, twist in base_link."""
    state = dataclasses.replace(state, angular_velocity_radps=np.array([0.1, -0.2, 0.3]))
    T = conversions.pose_of(odometry_of(state))
    assert np.allclose(T[:3, 3], [1, 2, 3])
    assert np.allclose(T[:3, 0], [0, 1, 0])
    linear, angular = conversions.twist_of(odometry_of(state))
    assert linear.tolist() == [0.1, 0.0, 0.0]
    assert angular.tolist() == [0.1, -0.2, 0.3]


def test_bad_messages_are_refused(state: RoverState) -> None:
    """A twist that is not finite, a quaternion of zeros, joints or values that are missing."""
    msg = odometry_of(state)
    msg.twist.twist.angular.y = float('nan')
    msg.pose.pose.orientation.w = msg.pose.pose.orientation.z = 0.0
    with pytest.raises(GraphError, match='twist'):
        conversions.twist_of(msg)
    with pytest.raises(GraphError, match='pose'):
        conversions.pose_of(msg)
    for name, velocity in ((LEG_JOINTS, []), (LEG_JOINTS, [5.0, 6.0]), (['leg'] * 4, [1.0] * 4)):
        with pytest.raises(GraphError, match='velocity'):
            conversions.legs_of(JointState(name=name, velocity=velocity), Legs(), 'velocity')


def test_joints_in_any_order() -> None:
    """Values are found by name, also among other joints."""
    msg = JointState(name=['arm', *reversed(LEG_JOINTS)], position=[0.0, 4.0, 3.0, 2.0, 1.0])
    assert conversions.legs_of(msg, Legs(), 'position').tolist() == [1, 2, 3, 4]


def test_wheel_odometry_says_what_it_does_not_know() -> None:
    config = WheelOdometryConfig()
    odometry = WheelOdometry(RoverDescription(), config.counts_per_turn,
                             Rolling.of(config, 'highland'))
    for angle in np.linspace(0.0, 20.0, 100):
        odometry.add([0.8 * angle, angle, 0.8 * angle, angle], 0.005)
    msg = Odometry()
    runs = conversions.wheel_odometry_numbers(odometry)
    data = Refilled.of(msg, 'pose.pose', 'pose.covariance', 'twist.twist',
                       'twist.covariance').filled(5, *runs)
    msg = deserialize_message(data, Odometry)
    x, y, yaw = odometry.pose
    assert (msg.pose.pose.position.x, msg.pose.pose.position.y) == (x, y)
    assert 2.0 * np.arctan2(msg.pose.pose.orientation.z, msg.pose.pose.orientation.w) \
        == pytest.approx(yaw)
    assert (msg.twist.twist.linear.x, msg.twist.twist.angular.z) == tuple(odometry.twist)
    for covariance, known in ((msg.pose.covariance, odometry.covariance),
                              (msg.twist.covariance, np.diag(odometry.twist_variance))):
        matrix = covariance.reshape(6, 6)
        assert np.all(np.linalg.eigvalsh(matrix) > 0.0)
        np.testing.assert_allclose(matrix[np.ix_([0, 1, 5], [0, 1, 5])], known, atol=2e-8)
        assert np.all(np.diag(matrix)[2:5] >= 1e6)


def test_a_cloud_has_the_colours_of_its_picture() -> None:
    """Packed as in stereo_image_proc; a grey picture has none."""
    points = np.zeros((2, 3, 3), np.float32)
    picture = np.zeros((2, 3, 3), np.uint8)
    picture[1, 2] = 200, 100, 50
    grey, colour = (image_conversions.point_cloud(points, pixels, 'left',
                                                  conversions.time_msg(0))
                    for pixels in (picture[..., 0], picture))
    assert [field.name for field in grey.fields] == ['x', 'y', 'z', 'intensity']
    assert [field.name for field in colour.fields] == ['x', 'y', 'z', 'intensity', 'rgb']
    assert (colour.point_step, colour.row_step, len(colour.data)) == (20, 60, 120)
    last = np.frombuffer(bytes(colour.data), np.uint8)[-4:]
    assert last.tolist() == [50, 100, 200, 0]
    assert np.frombuffer(bytes(colour.data), np.float32)[-2] == pytest.approx(124, abs=1)


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
    found = image_conversions.detections(MSG, instances(
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
    found = image_conversions.label_info(MSG, names, Header())
    assert {c.class_id: c.class_name for c in found.class_map} == names
    told = image_conversions.vision_info(MSG, 'abc', Header())
    assert (told.database_location, told.database_version) == ('abc', 0) and told.method


def learn(store: Typestore, name: str, definition: str) -> None:
    """Register a type and those it is made of."""
    store.register({part: fields for part, fields in get_types_from_msg(definition, name).items()
                    if part not in store.fielddefs})


def test_without_the_package_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'vision_msgs', None)
    assert image_conversions.vision_messages() is None


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


def test_a_pose_is_read_alike_on_every_processor() -> None:
    """A controller that rounds otherwise than another drives another way, seconds later."""
    program = """if True:
        import hashlib, sys
        from nav_msgs.msg import Odometry
        import numpy as np
        from lunar_rover_sim.nodes.conversions import pose_of
        sums, message = hashlib.sha256(), Odometry()
        for quat in np.random.default_rng(1).standard_normal((2000, 4)):
            q = message.pose.pose.orientation
            q.w, q.x, q.y, q.z = (quat / np.sqrt((quat * quat).sum())).tolist()
            sums.update(pose_of(message).tobytes())
        print(sums.hexdigest())"""
    said = {subprocess.run([sys.executable, '-c', program], check=True, capture_output=True,
                           env={**os.environ, **processor}).stdout
            for processor in ({}, {'OPENBLAS_CORETYPE': 'Nehalem'},
                              {'OPENBLAS_CORETYPE': 'Haswell'})}
    assert len(said) == 1
