"""Messages are made plain without decoding as they are by decoding and serialising again."""

import contextlib

import numpy as np
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.bag.content_hash import PlainCdr
from lunar_rover_sim.bag.reader import open_bag

KINDS = ('nav_msgs/msg/Odometry', 'sensor_msgs/msg/Imu', 'sensor_msgs/msg/JointState',
         'sensor_msgs/msg/CameraInfo', 'tf2_msgs/msg/TFMessage', 'geometry_msgs/msg/WrenchStamped',
         'rosgraph_msgs/msg/Clock', 'std_msgs/msg/String')


@pytest.fixture(scope='module', name='bag')
def _bag(tmp_path_factory):
    items = synthetic.latched_items() + synthetic.drive(0.2, frame_hz=10)
    with open_bag(synthetic.write(tmp_path_factory.mktemp('plain') / 'bag', items)) as bag:
        yield bag


def again(bag, data, kind):
    """Return a message decoded and serialised again; None where it cannot be decoded."""
    with contextlib.suppress(Exception):
        return bytes(bag.typestore.serialize_cdr(
            bag.typestore.deserialize_cdr(data, kind), kind, little_endian=True))
    return None


def padding(bag, data, kind):
    """Return the places of bytes that do not count: found by changing one after the other."""
    plain, found = again(bag, data, kind), []
    for k in range(4, len(data)):
        other = bytearray(data)
        other[k] ^= 0x5A
        if again(bag, bytes(other), kind) == plain:
            found.append(k)
    return found


@pytest.mark.parametrize('kind', KINDS)
def test_padding_of_any_content_does_not_count_and_all_else_does(bag, kind):
    messages = [m for m in bag.raw() if m.msgtype == kind]
    messages = [m for m in messages if len(m.data) == len(messages[0].data)][:6]
    if not messages:
        pytest.skip(f'the synthetic bag holds no {kind}')
    decoded = []
    plain = PlainCdr(bag.typestore, lambda data, of: (
        decoded.append(of), bag.typestore.deserialize_cdr(data, of))[1])
    unused = padding(bag, messages[0].data, kind)
    rng = np.random.default_rng(3)
    for message in messages:
        data = bytearray(message.data)
        for k in unused:
            data[k] = rng.integers(256)
        data[2:4] = rng.bytes(2)        # the options of the encapsulation
        expected = again(bag, bytes(data), kind)
        if again(bag, message.data, kind) == expected:      # it is laid out as the first one
            assert bytes(plain.of('/topic', kind, bytes(data))) == expected
    assert decoded      # the first one
    other = bytearray(messages[0].data)
    for k in sorted(set(range(4, len(other))).difference(unused)):
        other[k] ^= 1
        expected = again(bag, bytes(other), kind)
        if expected is not None:
            assert bytes(plain.of('/topic', kind, bytes(other))) == expected
        other[k] ^= 1


def test_messages_that_are_laid_out_alike_are_decoded_once(bag):
    decoded = []
    plain = PlainCdr(bag.typestore, lambda data, of: (
        decoded.append(of), bag.typestore.deserialize_cdr(data, of))[1])
    count = 0
    for message in bag.raw(['odom']):
        plain.of(message.topic, message.msgtype, message.data)
        count += 1
    assert count > 5 and len(decoded) == 1


def test_big_endian_and_texts_of_all_lengths(bag):
    plain = PlainCdr(bag.typestore, bag.decode)
    kind = 'std_msgs/msg/String'
    cls = bag.typestore.types[kind]
    for k in range(60):
        message = cls(data='x' * (k % 7) + 'y')
        expected = bytes(bag.typestore.serialize_cdr(message, kind, little_endian=True))
        for little in (True, False):
            data = bytes(bag.typestore.serialize_cdr(message, kind, little_endian=little))
            assert bytes(plain.of('/topic', kind, data)) == expected
