"""The hash of a bag: every value counts, and neither container, log nor padding does."""

import contextlib
import copy

import numpy as np
import psutil
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.bag.content_hash import bag_hash, is_skipped, PlainCdr, topic_hashes
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.cli.main import main


@pytest.fixture(scope='module')
def items():
    return synthetic.drive(0.1, frame_hz=10)


@pytest.fixture(scope='module')
def original(items, tmp_path_factory):
    return synthetic.write(tmp_path_factory.mktemp('hash') / 'bag', items)


def odometry(items):
    """Return the index of an odometry message in the middle."""
    found = [i for i, item in enumerate(items) if item.topic.endswith('odom')]
    assert len(found) > 5
    return found[len(found) // 2]


def changed(items, change):
    """Return a copy of the items with one odometry message changed."""
    result = list(items)
    i = odometry(items)
    result[i] = copy.deepcopy(items[i])
    change(result[i].message)
    return result


def test_the_same_messages_have_one_hash_in_any_container_and_order(items, original, tmp_path):
    ordered = sorted(items, key=lambda item: item.topic)     # of each topic as before
    other = synthetic.write_sqlite(tmp_path / 'other', ordered, compression='zstd')
    assert bag_hash(other) == bag_hash(original)
    assert topic_hashes(other) == topic_hashes(original)


def test_the_folder_of_a_run_stands_for_its_bag(original, capsys):
    assert original.name == 'bag'
    for path in (original, original.parent):
        assert main(['bag', 'hash', str(path)]) == 0
        with open_bag(path) as bag:
            assert bag.path == original
    first, second = capsys.readouterr().out.split()
    assert first == second == bag_hash(original)


def test_the_smallest_change_of_one_value_changes_the_hash_of_its_topic(items, original, tmp_path):
    def nudge(message):
        message.pose.pose.position.x += 1e-15

    other = synthetic.write(tmp_path / 'other', changed(items, nudge))
    assert bag_hash(other) != bag_hash(original)
    before, after = topic_hashes(original), topic_hashes(other)
    differ = {name.lstrip('/') for name in before if before[name] != after[name]}
    assert differ == {items[odometry(items)].topic.lstrip('/')}


def test_a_message_more_or_less_changes_the_hash(items, original, tmp_path):
    fewer = list(items)
    del fewer[odometry(items)]
    assert bag_hash(synthetic.write(tmp_path / 'fewer', fewer)) != bag_hash(original)


@pytest.mark.parametrize('stamp_ns', [None, 5_000_000])
def test_what_has_no_stamp_counts_and_messages_of_one_stamp_have_no_order(stamp_ns, tmp_path):
    def said(name, *texts):
        items = ([synthetic.text(topics.SCENARIO, text) for text in texts] if stamp_ns is None
                 else [synthetic.item(topics.ODOM, synthetic.odometry(stamp_ns, text, np.eye(4)))
                       for text in texts])
        return bag_hash(synthetic.write(tmp_path / name, items))

    first = said('first', 'one', 'other')
    assert said('again', 'one', 'other') == first
    assert said('changed', 'one', 'another') != first and said('fewer', 'one') != first
    # Who comes first of one stamp is chance; what has none is in the order of the log.
    assert (said('turned', 'other', 'one') == first) == (stamp_ns is not None)


@pytest.mark.parametrize('topic,skipped', [('/rosout', True), ('/rover/rosout', True),
                                           ('rosout', True), ('/my_rosout', False),
                                           ('/odom', False), ('/diagnostics', True)])
def test_topics_of_wall_time_do_not_count(topic, skipped):
    assert is_skipped(topic) == skipped


def test_a_closed_bag_holds_no_file(original):
    def ours():
        return [file.path for file in psutil.Process().open_files() if str(original) in file.path]

    with open_bag(original) as bag:
        assert list(bag.types)
        next(iter(bag.raw(list(bag.types))))
        assert ours()
    assert not ours()
    bag.close()     # twice does no harm


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
