"""Writing bags: stamps as bag time, profiles, types, and what other readers make of it."""

from pathlib import Path
import types

import pytest
from rosbags.rosbag2 import CompressionMode, Reader, StoragePlugin
import synthetic_bag as synthetic

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.metadata import as_recorded, contract_qos, qos_of_text
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.writer import BagWriter, COMPRESSIONS
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, ConfigError
from lunar_rover_sim.run.node_config import RecorderConfig

VARIANTS = [(storage, compression) for storage in synthetic.WRITERS
            for compression in COMPRESSIONS]


def everything(path: Path) -> list[tuple[str, str, int, bytes]]:
    with open_bag(path) as bag:
        return [tuple(message) for message in bag.raw()]


@pytest.fixture(scope='module')
def items() -> list[synthetic.Item]:
    return synthetic.drive(0.4, only=(
        topics.WORLD_HASH, topics.TF_STATIC, topics.CLOCK, topics.ODOM, topics.TF,
        topics.JOINT_COMMANDS, topics.IMU_RAW, topics.LEFT_INFO, topics.DISPARITY))


@pytest.mark.parametrize(('storage', 'compression'), VARIANTS)
def test_what_is_written_is_read(tmp_path, items, storage, compression):
    path = synthetic.WRITERS[storage](tmp_path / 'bag', items, compression=compression)
    written = [(f'/{i.topic}', i.msgtype, bytes(synthetic.serialise(i))) for i in items]
    with open_bag(path) as bag:
        read = [(m.topic, m.msgtype, m.data) for m in bag.raw()]
        assert sorted(read) == sorted(written)
        assert bag.incomplete is None
        assert bag.message_count == len(items)
        for message in bag.raw(['odom', 'clock', 'tf', 'stereo/disparity', 'joint_commands']):
            assert message.time_ns == bag.stamp_ns(message)
    assert sorted(p.name for p in path.iterdir())[-1] == 'metadata.yaml'
    assert not (path / marker.MARKER_NAME).exists()


def test_bag_time_is_the_stamp_or_the_fallback(tmp_path, items):
    odom = next(i for i in items if i.topic == 'odom')
    text = next(i for i in items if i.topic == 'world_hash')
    unset = synthetic.Item('cmd_vel', 'std_msgs/msg/Header', synthetic.header(0, 'x'))
    with BagWriter(tmp_path / 'bag') as writer:
        assert writer.newest_ns == 0
        assert writer.write('/odom', odom.msgtype, synthetic.serialise(odom), 7) == 5_000_000
        assert writer.write('/hash', text.msgtype, synthetic.serialise(text), 7) == 7
        assert writer.write('/unset', unset.msgtype, synthetic.serialise(unset), 9) == 9
        # There is no time before 0 in a bag.
        assert writer.write('/hash', text.msgtype, synthetic.serialise(text), -5) == 0
        # What is stamped with the time of another clock is named, and placed at its arrival.
        later = writer.write('/later', odom.msgtype, synthetic.serialise(odom), 8, 4_999_999)
        same = writer.write('/odom', odom.msgtype, synthetic.serialise(odom), 8, 5_000_000)
        assert (later, same, writer.of_another_clock) == (8, 5_000_000, {'/later'})
        assert writer.newest_ns == 5_000_000
    times = sorted(m[2] for m in everything(tmp_path / 'bag'))
    assert times == [0, 7, 8, 9, 5_000_000, 5_000_000]


def test_latched_topics_are_offered_transient_local():
    assert contract_qos('/rover1/world_hash').durability.name == 'TRANSIENT_LOCAL'
    assert contract_qos('/tf_static').durability.name == 'TRANSIENT_LOCAL'
    assert contract_qos('/rover1/odom').durability.name == 'VOLATILE'
    forever = (9223372036, 854775807)       # as ROS writes it: nothing is ever late
    odom = contract_qos('/rover1/odom')
    for time in (odom.deadline, odom.lifespan, odom.liveliness_lease_duration):
        assert (time.sec, time.nsec) == forever
    # Else a replay would publish where no node of ROS listens.
    assert not contract_qos('/rover1/odom').avoid_ros_namespace_conventions


def rclpy_profile(**values):
    """Return a profile as rclpy gives that of a publisher which it has discovered."""
    forever = types.SimpleNamespace(nanoseconds=2**63 - 1)
    return types.SimpleNamespace(**{**dict(
        history=3, depth=0, reliability=2, durability=2, deadline=forever, lifespan=forever,
        liveliness=1, liveliness_lease_duration=forever, avoid_ros_namespace_conventions=False),
        **values})


def test_profiles_of_rclpy_are_taken():
    recorded = as_recorded(rclpy_profile(), '/user/points')
    assert (recorded.history.name, recorded.depth) == ('KEEP_LAST', 10)
    assert recorded.reliability.name == 'BEST_EFFORT'
    assert (recorded.deadline.sec, recorded.deadline.nsec) == (9223372036, 854775807)


@pytest.mark.parametrize(('history', 'depth', 'expected'), [
    (1, 3, ('KEEP_LAST', 3)), (2, 5, ('KEEP_ALL', 5)),      # known
    (1, 0, ('KEEP_LAST', 1)), (2, 0, ('KEEP_LAST', 1)),     # no depth is given
    (0, 7, ('KEEP_LAST', 1)), (3, 7, ('KEEP_LAST', 1)),     # the default of the system; unknown
    (9, 7, ('KEEP_LAST', 1))])                              # not a history
def test_history_and_depth_are_those_of_the_contract_where_unknown(history, depth, expected):
    recorded = as_recorded(rclpy_profile(history=history, depth=depth), '/world_hash')
    assert (recorded.history.name, recorded.depth) == expected


def test_what_else_a_profile_says_is_recorded():
    """Unknown members are those of the contract; times are split into seconds and the rest."""
    later = types.SimpleNamespace(nanoseconds=2_500_000_000)
    recorded = as_recorded(rclpy_profile(
        deadline=later, lifespan=later, liveliness=3, liveliness_lease_duration=later,
        avoid_ros_namespace_conventions=True), '/world_hash')
    for time in (recorded.deadline, recorded.lifespan, recorded.liveliness_lease_duration):
        assert (time.sec, time.nsec) == (2, 500_000_000)
    assert recorded.liveliness.name == 'MANUAL_BY_TOPIC'
    assert recorded.avoid_ros_namespace_conventions
    unknown = as_recorded(rclpy_profile(reliability=9, durability=9, liveliness=9), '/world_hash')
    assert unknown._replace(deadline=None) == contract_qos('/world_hash')._replace(deadline=None)


def test_rosbags_describes_a_bag_as_it_would_its_own(tmp_path, items):
    """The metadata of a bag is that of rosbags' own writer but for the storage."""
    ours = synthetic.metadata(synthetic.write(tmp_path / 'bag', items))
    theirs = synthetic.metadata(synthetic.write_sqlite(tmp_path / 'other', items))
    assert ours.pop('storage_identifier') == 'mcap' and ours.pop('ros_distro') == 'jazzy'
    del theirs['storage_identifier'], theirs['ros_distro']
    del ours['custom_data'], theirs['custom_data']      # ours: how much was recorded
    for of_one in (ours, theirs):
        assert len(of_one.pop('relative_file_paths')) == 1 and of_one['files'][0].pop('path')
    assert ours == theirs
    with Reader(tmp_path / 'bag') as reader:
        assert len(list(reader.messages())) == reader.message_count == len(items)
        assert {c.topic: (c.digest, c.ext.offered_qos_profiles) for c in reader.connections} == {
            t['topic_metadata']['name']: (t['topic_metadata']['type_description_hash'],
                                          [contract_qos(t['topic_metadata']['name'])])
            for t in ours['topics_with_message_count']}


def test_own_types_come_with_their_definition(tmp_path):
    definition = 'std_msgs/Header header\nfloat64 slip\n'
    raw = synthetic.STORE.serialize_cdr(synthetic.header(3, 'base'), 'std_msgs/msg/Header')
    raw = bytes(raw).ljust(28, b'\0') + bytes(8)
    with BagWriter(tmp_path / 'bag') as writer:
        with pytest.raises(BagError, match='my_msgs/msg/Slip is not known'):
            writer.write('/slip', 'my_msgs/msg/Slip', raw, 0)
        with pytest.raises(BagError, match='cannot be read'):
            writer.add_topic('/slip', 'my_msgs/msg/Slip', definition='other_msgs/Unknown x')
        writer.add_topic('/slip', 'my_msgs/msg/Slip', definition=definition)
        assert writer.write('/slip', 'my_msgs/msg/Slip', raw, 0) == 3
        with pytest.raises(BagError, match='has type my_msgs/msg/Slip in this bag'):
            writer.write('/slip', 'std_msgs/msg/String', raw, 0)
    with open_bag(tmp_path / 'bag') as bag:
        assert bag.first('/slip').slip == 0.0


def test_nothing_is_overwritten(tmp_path):
    (tmp_path / 'bag').mkdir()
    with pytest.raises(BagError, match='exists already'):
        BagWriter(tmp_path / 'bag')
    with pytest.raises(ConfigError, match="storage: 'sqlite3' is not valid; valid .* mcap"):
        RecorderConfig.from_mapping({'storage': 'sqlite3'})
    (tmp_path / 'file').touch()
    with pytest.raises(BagError, match='cannot be made: Not a directory'):
        BagWriter(tmp_path / 'file' / 'bag')


def test_an_exception_leaves_a_marked_readable_bag(tmp_path, items):
    with pytest.raises(ZeroDivisionError):
        with BagWriter(tmp_path / 'bag') as writer:
            for item in items:
                writer.write('/' + item.topic, item.msgtype, synthetic.serialise(item), 0)
            1 / 0
    with open_bag(tmp_path / 'bag') as bag:
        assert bag.incomplete == 'division by zero'
        assert bag.message_count == len(items)
    with pytest.raises(BagError, match='closed: division by zero'):
        writer.write('/' + items[0].topic, items[0].msgtype, synthetic.serialise(items[0]), 0)
    writer.close()
    assert (tmp_path / 'bag' / marker.MARKER_NAME).exists()


def test_other_readers_understand_the_bag(tmp_path, items):
    reader_module = pytest.importorskip('mcap.reader')
    decoder = pytest.importorskip('mcap_ros2.decoder')
    path = synthetic.write(tmp_path / 'bag', items, compression='zstd')
    with (path / 'bag.mcap').open('rb') as file:
        reader = reader_module.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        read = list(reader.iter_decoded_messages())
    assert len(read) == len(items)
    odom = [m for _, channel, _, m in read if channel.topic == '/odom']
    expected = [i.message for i in items if i.topic == 'odom']
    for mine, theirs in zip(expected, odom, strict=True):
        assert theirs.pose.pose.position.x == mine.pose.pose.position.x
        assert theirs.child_frame_id == mine.child_frame_id


@pytest.mark.parametrize('storage', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_files_that_are_compressed_as_a_whole_are_read(tmp_path, items, storage):
    """As by `ros2 bag record --compression-mode file`: bag.mcap.zstd, once named bag.mcap."""
    path = synthetic.write_sqlite(tmp_path / 'bag', items, compression='zstd', storage=storage,
                                  mode=CompressionMode.FILE)
    assert [file.suffix for file in sorted(path.iterdir())] == ['.zstd', '.yaml']
    with synthetic.changed_metadata(path) as told:
        for entry in told['files']:
            entry['path'] = entry['path'].removesuffix('.zstd')
    with open_bag(path) as bag:
        assert bag.message_count == len(items) == sum(1 for _ in bag.messages())
        assert bag.storage == ('mcap' if storage is StoragePlugin.MCAP else 'db3')
        assert bag.incomplete is None


def test_a_damaged_file_is_named(tmp_path):
    path = tmp_path / 'bag'
    path.mkdir()
    (path / 'metadata.yaml').write_text('nonsense: 1')
    (path / 'bag.mcap').write_bytes(b'nonsense')
    with pytest.raises(BagError, match='cannot be read'):
        open_bag(path)
    with pytest.raises(BagError, match='no such bag'):
        open_bag(tmp_path / 'missing')
    with pytest.raises(BagError, match='cannot be read as a bag'):
        open_bag(path / 'bag.mcap')


@pytest.mark.parametrize(('end_ns', 'duration_s', 'expected'), [
    (0, 30.0, 'the recording ended at 0.000 s of 30 s'),
    (29_899_999_999, 30.0, 'the recording ended at 29.900 s of 30 s'),
    (29_900_000_000, 30.0, ''), (31_000_000_000, 30.0, ''), (5, 0.0, ''), (0, 0.0, '')])
def test_a_recording_is_short_if_it_ends_before_its_run(tmp_path, end_ns, duration_s, expected):
    assert marker.why_short(end_ns, duration_s, 0.1) == expected
    if expected:
        marker.mark(tmp_path, expected)
        marker.mark_failed(tmp_path, 'a node died')     # says more
        marker.mark_failed(tmp_path, 'time is up')
        assert marker.why_incomplete(tmp_path) == 'a node died'


def test_unknown_topics_offer_the_nearest(tmp_path, items):
    path = synthetic.write(tmp_path / 'bag', items, namespace='/rover1')
    with open_bag(path) as bag:
        assert bag.namespace == '/rover1'
        assert bag.resolve(topics.ODOM.name) == '/rover1/odom'
        assert not bag.has('cmd_vel')
        with pytest.raises(BagError, match='did you mean'):
            bag.resolve('stereo/left/image')


@pytest.mark.parametrize('words', [(1, 1, 1, 1), ('keep_last', 'reliable', 'transient_local',
                                                  'automatic')])
def test_profiles_are_read_by_name_and_by_number(words):
    history, reliability, durability, liveliness = words
    time = '{sec: 9223372036, nsec: 854775807}'
    (found,) = qos_of_text(
        f'- {{history: {history}, depth: 1, reliability: {reliability}, durability: {durability}, '
        f'deadline: {time}, lifespan: {time}, liveliness: {liveliness}, '
        f'liveliness_lease_duration: {time}, avoid_ros_namespace_conventions: false}}')
    assert found == contract_qos('/world_hash')
    assert qos_of_text('') == qos_of_text('[]') == []
    with pytest.raises(BagError, match='offered QoS profiles cannot be read'):
        qos_of_text('- depth')
