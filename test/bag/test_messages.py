"""Single messages: stamps in both byte orders, and what is wrong with a bad one."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

from lunar_rover_sim.bag import message_validity as validity
from lunar_rover_sim.bag.message_validity import laser_scan_problem, lidar_cloud_problem
from lunar_rover_sim.bag.stamps import stamp_ns

STORE = get_typestore(Stores.ROS2_JAZZY)
T = STORE.types
SEC, NANOSEC = 1_234_567, 890_123_456
NS = SEC * 10**9 + NANOSEC


def header():
    return T['std_msgs/msg/Header'](
        stamp=T['builtin_interfaces/msg/Time'](sec=SEC, nanosec=NANOSEC), frame_id='base_link')


def vector(x=0.0, y=0.0, z=0.0):
    return T['geometry_msgs/msg/Vector3'](x=x, y=y, z=z)


def quaternion(x=0.0, y=0.0, z=0.0, w=1.0):
    return T['geometry_msgs/msg/Quaternion'](x=x, y=y, z=z, w=w)


def transform(**values):
    return T['geometry_msgs/msg/TransformStamped'](
        header=header(), child_frame_id='imu_link', transform=T['geometry_msgs/msg/Transform'](
            translation=vector(**values), rotation=quaternion()))


def imu(**values):
    nine = np.zeros(9)
    return T['sensor_msgs/msg/Imu'](**{
        'header': header(), 'orientation': quaternion(), 'orientation_covariance': nine,
        'angular_velocity': vector(), 'angular_velocity_covariance': nine,
        'linear_acceleration': vector(), 'linear_acceleration_covariance': nine, **values})


def joints(**values):
    return T['sensor_msgs/msg/JointState'](**{
        'header': header(), 'name': ['a', 'b'], 'position': np.zeros(2), 'velocity': np.zeros(2),
        'effort': np.zeros(0), **values})


def battery(**values):
    unknown = dict.fromkeys(('temperature', 'charge', 'capacity', 'design_capacity',
                             'percentage'), np.nan)
    return T['sensor_msgs/msg/BatteryState'](**{
        'header': header(), 'voltage': 12.0, 'current': -0.1, **unknown, 'power_supply_status': 2,
        'power_supply_health': 0, 'power_supply_technology': 0, 'present': True,
        'cell_voltage': np.zeros(0, np.float32), 'cell_temperature': np.zeros(0, np.float32),
        'location': 'bus', 'serial_number': '', **values})


MESSAGES = {
    'sensor_msgs/msg/Imu': imu(), 'sensor_msgs/msg/JointState': joints(),
    'rosgraph_msgs/msg/Clock': T['rosgraph_msgs/msg/Clock'](clock=header().stamp),
    'builtin_interfaces/msg/Time': header().stamp, 'std_msgs/msg/Header': header(),
    'geometry_msgs/msg/TransformStamped': transform(),
    'tf2_msgs/msg/TFMessage': T['tf2_msgs/msg/TFMessage'](transforms=[transform(), transform()])}


@pytest.mark.parametrize('little', [True, False])
@pytest.mark.parametrize('msgtype', MESSAGES)
def test_the_stamp_is_read_from_the_bytes(msgtype, little):
    raw = STORE.serialize_cdr(MESSAGES[msgtype], msgtype, little_endian=little)
    assert stamp_ns(msgtype, raw) == NS
    assert stamp_ns(msgtype, memoryview(raw)) == NS


def test_messages_without_a_stamp_have_none():
    empty = T['tf2_msgs/msg/TFMessage'](transforms=[])
    assert stamp_ns('tf2_msgs/msg/TFMessage',
                    STORE.serialize_cdr(empty, 'tf2_msgs/msg/TFMessage')) is None
    text = T['std_msgs/msg/String'](data='0123456789012345')
    kind = 'std_msgs/msg/String'
    assert stamp_ns(kind, STORE.serialize_cdr(text, kind)) is None
    numbers = T['std_msgs/msg/Float64MultiArray'](
        layout=T['std_msgs/msg/MultiArrayLayout'](dim=[], data_offset=0), data=np.ones(9))
    kind = 'std_msgs/msg/Float64MultiArray'
    assert stamp_ns(kind, STORE.serialize_cdr(numbers, kind)) is None
    assert stamp_ns('std_msgs/msg/Empty', b'\0\1\0\0' + 20 * b'\0') is None
    assert stamp_ns('no_msgs/msg/Such', 40 * b'\0') is None


def test_a_message_cut_within_its_stamp_has_none():
    raw = STORE.serialize_cdr(MESSAGES['sensor_msgs/msg/Imu'], 'sensor_msgs/msg/Imu')
    assert stamp_ns('sensor_msgs/msg/Imu', raw[:11]) is None
    assert stamp_ns('sensor_msgs/msg/Imu', raw[:12]) == NS


@pytest.mark.parametrize('message,msgtype,problem', [
    (imu(), 'sensor_msgs/msg/Imu', None),
    (imu(linear_acceleration=vector(y=np.nan)), 'sensor_msgs/msg/Imu',
     'linear_acceleration.y is nan'),
    (imu(angular_velocity_covariance=np.r_[np.zeros(8), -np.inf]), 'sensor_msgs/msg/Imu',
     'angular_velocity_covariance holds -inf'),
    (joints(position=np.array([0.0, np.inf])), 'sensor_msgs/msg/JointState', 'position holds inf'),
    (T['tf2_msgs/msg/TFMessage'](transforms=[transform(), transform(z=np.nan)]),
     'tf2_msgs/msg/TFMessage', 'transforms[1].transform.translation.z is nan'),
    (battery(), 'sensor_msgs/msg/BatteryState', None),
    (battery(current=np.nan), 'sensor_msgs/msg/BatteryState', 'current is nan')])
def test_the_first_number_that_is_not_finite_is_named(message, msgtype, problem):
    assert validity.FiniteCheck(STORE).problem(msgtype, message) == problem


def image(encoding='mono8', width=4, height=3, step=None, data=None, big=False):
    step = width * validity.BYTES_PER_PIXEL.get(encoding, 1) if step is None else step
    data = np.arange(step * height, dtype=np.uint8) if data is None else data
    return SimpleNamespace(encoding=encoding, width=width, height=height, step=step, data=data,
                           is_bigendian=big)


@pytest.mark.parametrize('picture,problem', [
    (image(), None), (image('rgb8'), None), (image('32FC1', step=20), None),
    (image('yuv'), "encoding 'yuv' is not known"),
    (image(step=3), 'step 3 is less than a row of 4 pixels'),
    (image(data=np.zeros(11, np.uint8)), 'data holds 11 bytes, not 12'),
    (image(data=np.zeros(13, np.uint8)), 'data holds 13 bytes, not 12'),
    (image(width=0, step=1), 'it has no pixels'), (image(height=0), 'it has no pixels')])
def test_the_layout_of_images(picture, problem):
    assert validity.image_problem(picture) == problem


def test_pixels_of_images_in_all_kinds():
    """Rows may be longer than their pixels; numbers may be of either byte order."""
    numbers = np.array([[1, 2, 300], [4, 500, 6]], np.uint16)
    padded = np.zeros((2, 8), np.uint8)
    for big in (False, True):
        padded[:, :6] = numbers.astype('>u2' if big else '<u2').view(np.uint8)
        found = validity.pixels(image('mono16', 3, 2, 8, padded.ravel(), big))
        assert found.dtype == np.uint16 and np.array_equal(found, numbers)
    colours = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    assert np.array_equal(validity.pixels(image('rgb8', 3, 2, data=colours.ravel())), colours)
    depth = np.array([[0.5, np.inf]], np.float32)
    found = validity.pixels(image('32FC1', 2, 1, data=depth.view(np.uint8).ravel()))
    assert np.array_equal(found, depth)


def depth_image(*values):
    depth = np.array([values], np.float32)
    return image('32FC1', len(values), 1, data=depth.view(np.uint8).ravel())


def disparity(**values):
    return SimpleNamespace(**{'f': 450.0, 't': 0.1, 'image': depth_image(3.0, -1.0), **values})


def camera_info(**values):
    k, p = np.diag([400.0, 410.0, 1.0]), np.diag([420.0, 430.0, 1.0])
    return SimpleNamespace(**{'k': k.ravel(), 'p': np.hstack([p, np.zeros((3, 1))]).ravel(),
                              'width': 640, 'height': 480, **values})


def without(values, index):
    """Return a copy of an array with a 0."""
    result = values.copy()
    result[index] = 0.0
    return result


UNIT = validity.quaternion_problem('orientation')
GOOD = camera_info()


@pytest.mark.parametrize('check, message, problem', [
    # True depth is known everywhere; that from matching may be unknown, which is NaN.
    (validity.true_depth_problem, depth_image(0.1, np.inf), None),
    (validity.true_depth_problem, depth_image(0.1, np.nan), '1 pixels are NaN'),
    (validity.true_depth_problem, depth_image(0.1, 0.0), '1 pixels are not in front'),
    (validity.depth_problem, depth_image(0.1, np.nan, np.inf), None),
    (validity.depth_problem, depth_image(-0.1, 0.0, 1.0), '2 pixels are not in front'),
    (validity.disparity_problem, disparity(), None),
    *((validity.disparity_problem, disparity(**{name: wrong}), 'f = ')
      for name in ('f', 't') for wrong in (0.0, -1.0, np.nan)),
    (validity.disparity_problem, disparity(image=image()), "encoding 'mono8'; valid is 32FC1"),
    (validity.disparity_problem, disparity(image=depth_image(1.0, np.nan)), 'pixels are NaN or'),
    (UNIT, imu(orientation=quaternion(0.5, -0.5, 0.5, -0.5)), None),
    (UNIT, imu(orientation=quaternion(0.6, 0.0, 0.0, 0.8 + 3e-6)), 'orientation has length 1.0'),
    (UNIT, imu(orientation=quaternion(w=0.0)), 'orientation has length 0.000000, not 1'),
    (validity.joints_problem, joints(), None),
    (validity.joints_problem, joints(effort=np.zeros(2)), None),
    (validity.joints_problem, joints(effort=np.zeros(1)), 'effort holds 1 values for 2 joints'),
    (validity.joints_problem, joints(velocity=np.zeros(3)), 'velocity holds 3 values for 2'),
    (validity.joints_problem, joints(position=np.zeros(0)), 'position holds 0 values for 2'),
    (validity.commands_problem, joints(position=np.zeros(0), effort=np.zeros(0)), None),
    (validity.commands_problem, joints(position=np.zeros(1)), 'position holds 1 values for 2'),
    (validity.commands_problem, joints(velocity=np.zeros(0)), 'velocity holds 0 values for 2'),
    (validity.camera_info_problem, GOOD, None),
    *((validity.camera_info_problem, camera_info(**{name: without(getattr(GOOD, name), index)}),
       'focal lengths K ') for name, index in (('k', 0), ('k', 4), ('p', 0))),
    *((validity.camera_info_problem, camera_info(**{name: 0}), 'it has no size')
      for name in ('width', 'height'))])
def test_what_is_wrong_with_a_message_is_named(check, message, problem):
    found = check(message)
    assert found == problem if problem is None else found.startswith(problem)


@pytest.mark.parametrize('encoding,kind', [('bayer_rggb8', np.uint8), ('bayer_rggb16', np.uint16)])
def test_mosaics_are_read_in_colour(encoding, kind):
    """In both byte orders; what is too short for its encoding is told."""
    mosaic = np.zeros((16, 20), kind)
    mosaic[::2, ::2], mosaic[1::2, 1::2], mosaic[::2, 1::2], mosaic[1::2, ::2] = 200, 50, 100, 100
    for big in (0, 1):
        stored = mosaic.byteswap() if big else mosaic
        image = SimpleNamespace(height=16, width=20, step=mosaic.strides[0], encoding=encoding,
                                is_bigendian=big,
                                data=np.frombuffer(stored.tobytes(), np.uint8))
        assert validity.image_problem(image) is None
        pixels = validity.pixels(image)
        assert pixels.shape == (16, 20, 3) and pixels.dtype == kind
        assert pixels[8, 10].tolist() == [200, 100, 50]
    image.step -= 2
    assert 'step' in validity.image_problem(image)


def scan(count=5, **values):
    """Return a scan of 5 ranges from -20 to 20 deg."""
    message = {'angle_min': math.radians(-20.0), 'angle_max': math.radians(20.0),
               'angle_increment': math.radians(10.0), 'range_max': 30.0,
               'ranges': np.full(count, 2.0, np.float32)}
    return SimpleNamespace(**{**message, **values})


@pytest.mark.parametrize('message, said', [
    (scan(), None), (scan(ranges=np.array([np.inf, 2.0, np.inf, 30.0, 0.1])), None),
    (scan(ranges=np.full(5, 30.002, np.float32)), None),  # float32 may round beyond the greatest
    (scan(4), '4 ranges for 5.00 angles'), (scan(6), '6 ranges for 5.00 angles'),
    (scan(angle_max=math.radians(19.0)), '5 ranges for 4.90 angles'),
    (scan(angle_increment=0.0), '5 ranges for nan angles'),
    (scan(ranges=np.array([1.0, np.nan, 2.0, np.nan, 3.0])), '2 ranges are NaN; valid is inf'),
    (scan(ranges=np.array([1.0, 30.1, 2.0, 31.0, np.inf])), '2 ranges beyond range_max')])
def test_a_wrong_scan_is_named(message, said):
    found = laser_scan_problem(message)
    assert found == said if said is None else found.startswith(said)


LAYOUT = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('intensity', '<f4'),
                   ('ring', '<u2'), ('time', '<f4')])
DATATYPES = {'<f4': 7, '<u2': 4}


def cloud(points, layout=LAYOUT, **values):
    """Return a cloud of one row."""
    fields = [SimpleNamespace(name=name, offset=layout.fields[name][1],
                              datatype=DATATYPES[layout.fields[name][0].str])
              for name in layout.names]
    message = {'fields': fields, 'point_step': layout.itemsize, 'width': len(points), 'height': 1,
               'row_step': layout.itemsize * len(points), 'is_dense': True,
               'is_bigendian': False, 'data': np.frombuffer(points.tobytes(), np.uint8)}
    return SimpleNamespace(**{**message, **values})


def three(**changed):
    """Return three points; changed: field → its values."""
    points = np.zeros(3, LAYOUT)
    points['x'], points['ring'], points['time'] = [1.0, 2.0, 3.0], [0, 7, 15], [0.0, 0.01, 0.02]
    for name, values in changed.items():
        points[name] = values
    return points


SIZE = LAYOUT.itemsize
SHORT = np.dtype([item for item in LAYOUT.descr if item[0] not in ('ring', 'time')])
ODD = cloud(three())
ODD.fields[1].datatype = 1
NAN = [np.inf, 1.0, np.nan]


@pytest.mark.parametrize('message, said', [
    (cloud(three()), None), (cloud(np.zeros(0, LAYOUT)), None),
    (cloud(three(y=NAN), is_dense=False), None),
    (cloud(np.zeros(6, LAYOUT), width=3, height=2, row_step=3 * SIZE), None),
    (cloud(np.zeros(2, SHORT), SHORT), 'fields ring, time are missing'),
    (ODD, 'fields y are missing'),
    *((cloud(three(), **wrong), f'data holds {3 * SIZE} bytes, not ')
      for wrong in ({'width': 4}, {'row_step': SIZE}, {'height': 2})),
    (cloud(three(), point_step=SIZE - 1), f'fields end at {SIZE} of {SIZE - 1} bytes'),
    (cloud(three(), is_bigendian=True), 'data are big-endian'),
    *((cloud(three(**{axis: NAN})), '2 points are not finite in a dense cloud') for axis in 'xyz'),
    (cloud(three(time=[0.0, -0.5, 0.1])), 'time is -0.5 s'),
    (cloud(three(time=[0.0, np.nan, 0.1])), 'time is nan')])
def test_a_wrong_cloud_is_named(message, said):
    found = lidar_cloud_problem(message)
    assert found == said if said is None else found.startswith(said)
