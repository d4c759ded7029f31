"""Recordings that are cut off: by a kill, a full disk, or anywhere in the file."""

import os
from pathlib import Path
import pickle
import shutil
import signal
import subprocess
import sys
import textwrap

from mcap.reader import make_reader
import pytest
from rosbags.rosbag2 import Reader
import synthetic_bag as synthetic
from waiting import LIMIT_S

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.content_hash import bag_hash
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.recovery import recover
from lunar_rover_sim.bag.writer import BagWriter, COMPRESSIONS
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError

CHUNK = 1 << 20
TOPICS = (topics.SUN, topics.SCENARIO, topics.ODOM, topics.IMU_RAW, topics.TF, topics.LEFT_IMAGE,
          topics.RIGHT_IMAGE, topics.DISPARITY, topics.DEPTH, topics.TRUE_DEPTH)

# Writes a drive and then kills itself, or is stopped by a file size limit.
RECORDER = """
    import os, pickle, resource, signal, sys
    from lunar_rover_sim.bag.writer import BagWriter
    from lunar_rover_sim.base.errors import BagError
    if {limit}:
        resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, resource.RLIM_INFINITY))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    writer = BagWriter({path!r}, compression={compression!r})
    try:
        with open({messages!r}, 'rb') as file:
            for message in pickle.load(file):
                writer.write(*message, 0)
    except BagError as error:
        print(error)
        print(writer.newest_ns)
        sys.exit(1)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def record(messages: Path, path: Path, compression: str,
           limit: int = 0) -> subprocess.CompletedProcess[str]:
    code = textwrap.dedent(RECORDER).format(
        messages=str(messages), path=str(path), compression=compression, limit=limit)
    return subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                          timeout=LIMIT_S)


def everything(path: Path) -> list[tuple[str, str, int, bytes]]:
    with open_bag(path) as bag:
        return [tuple(message) for message in bag.raw()]


def cut_copy(bag: Path, folder: Path, size: int) -> Path:
    """Make a bag of the first `size` bytes of another one's MCAP file, without its metadata."""
    folder.mkdir()
    file = bag / f'{bag.name}.mcap'
    (folder / file.name).write_bytes(file.read_bytes()[:size])
    marker.mark(folder)
    return folder


@pytest.fixture(scope='module')
def items() -> list[synthetic.Item]:
    return synthetic.drive(0.4, only=TOPICS)


@pytest.fixture(scope='module')
def finished(items, tmp_path_factory) -> Path:
    return synthetic.write(tmp_path_factory.mktemp('finished') / 'bag', items)


@pytest.fixture(scope='module')
def whole() -> list[tuple[str, str, bytes]]:
    """Topic, type and content of everything that RECORDER writes."""
    return [(f'/{item.topic}', item.msgtype, synthetic.serialise(item))
            for item in synthetic.drive(2.6, state_hz=100, only=TOPICS)]


@pytest.fixture(scope='module')
def messages(whole, tmp_path_factory) -> Path:
    """Return a file from which RECORDER reads `whole`."""
    path = tmp_path_factory.mktemp('whole') / 'messages'
    path.write_bytes(pickle.dumps(whole))
    return path


@pytest.mark.parametrize('compression', COMPRESSIONS)
def test_a_kill_loses_the_last_chunks(tmp_path, whole, messages, compression):
    path = tmp_path / 'bag'
    assert record(messages, path, compression).returncode == -signal.SIGKILL
    with pytest.raises(BagError, match=f'not finished; make it readable with: .* {path}$'):
        open_bag(path)
    count = recover(path)
    found = everything(path)
    assert count == len(found)
    assert recover(path) == count
    with open_bag(path) as bag:
        assert bag.incomplete == marker.UNFINISHED
        assert bag.message_count == sum(bag.counts.values()) == count
        stamps = [m.time_ns for m in bag.raw(['odom'])]
        assert stamps == list(range(10_000_000, stamps[-1] + 1, 10_000_000))
        assert bag.end_ns >= 1.2e9
    lost = sum(len(raw) for *_, raw in whole) - sum(len(m[3]) for m in found)
    assert 0 < lost <= 2 * (CHUNK + max(len(raw) for *_, raw in whole))
    assert {(m[0], m[1], m[3]) for m in found} <= set(whole)
    with Reader(path) as reader:
        assert len(list(reader.messages())) == count
    assert sorted(p.suffix for p in path.iterdir()) == ['.mcap', '.yaml', '.yaml']
    with (path / 'bag.mcap').open('rb') as file:
        assert len(list(make_reader(file).iter_messages())) == count


def test_what_is_recovered_is_described_as_before(tmp_path, items):
    """Profiles, types and their hashes are those of the finished recording."""
    path = synthetic.write(tmp_path / 'bag', items)
    finished = synthetic.metadata(path)
    digest = bag_hash(path)
    (path / 'metadata.yaml').unlink()
    assert recover(path) == len(items)
    recovered = synthetic.metadata(path)
    assert recovered.pop('custom_data') == {'incomplete': 'metadata.yaml is missing'}
    for described in (finished, recovered):     # rosbags has no name of a distribution
        described.pop('ros_distro')
    finished.pop('custom_data')
    assert recovered == finished
    assert bag_hash(path) == digest
    with open_bag(path) as bag:
        assert bag.incomplete == 'metadata.yaml is missing'


def test_types_that_ros_does_not_know_are_recovered(tmp_path, items):
    raw = synthetic.STORE.serialize_cdr(synthetic.header(3, 'base'), 'std_msgs/msg/Header')
    raw = bytes(raw).ljust(28, b'\0') + bytes(8)
    path = tmp_path / 'bag'
    with BagWriter(path) as writer:
        writer.add_topic('/slip', 'my_msgs/msg/Slip',
                         definition='std_msgs/Header header\nfloat64 slip\n')
        writer.write('/slip', 'my_msgs/msg/Slip', raw, 0)
    (path / 'metadata.yaml').unlink()
    assert recover(path) == 1
    with open_bag(path) as bag:
        assert bag.first('/slip').slip == 0.0


def test_a_damaged_description_costs_its_topic_only(tmp_path, items, caplog):
    """Neither does it end in a traceback; the topic that is left out is named."""
    path = tmp_path / 'bag'
    with BagWriter(path) as writer:
        for k, item in enumerate(i for i in items if i.topic in ('odom', 'sun')):
            writer.write('/' + item.topic, item.msgtype, synthetic.serialise(item), k)
    (path / 'metadata.yaml').unlink()
    content = (path / 'bag.mcap').read_bytes()
    assert b' vector\n' in content     # in the definition of Vector3Stamped
    (path / 'bag.mcap').write_bytes(content.replace(b' vector\n', b'\xffvector\n'))
    assert recover(path) > 0
    with open_bag(path) as bag:
        assert list(bag.types) == ['/odom']
    assert '/sun is left out' in caplog.text


def test_bag_time_is_kept_where_it_is_not_the_stamp(tmp_path, items):
    odom = next(i for i in items if i.topic == 'odom')
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/odom', odom.msgtype)
        writer.write_at('/odom', 42, synthetic.serialise(odom))
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    recover(tmp_path / 'bag')
    assert [m[2] for m in everything(tmp_path / 'bag')] == [42]


@pytest.mark.parametrize('has_metadata', [False, True])
def test_a_cut_anywhere_is_survived(tmp_path, finished, has_metadata):
    """Cut at 16 places, the file recovers to a prefix of the recording, or holds no chunk.

    With its metadata, what can be read without recovery is the same bag or is not complete.
    """
    size = (finished / 'bag.mcap').stat().st_size
    whole = everything(finished)
    counts = []
    for cut in (1, 8, 100, 1000, 4000, *(size * k // 16 for k in range(1, 11)), size - 50):
        path = cut_copy(finished, tmp_path / f'cut{cut}', size - cut)
        if has_metadata:
            marker.unmark(path)
            shutil.copy(finished / 'metadata.yaml', path)
            try:
                with open_bag(path) as bag:
                    assert bag.incomplete == 'bag.mcap has no end'
            except BagError as error:       # the command line that a user is told
                assert str(error).endswith('bag.mcap has no end; make it readable with: '
                                           f'lunar_rover_sim bag recover {path}')
        try:
            counts.append(recover(path))
        except BagError as error:
            assert 'holds no complete chunk' in str(error)
            counts.append(0)
            continue
        found = everything(path)
        assert len(found) == counts[-1] and set(found) <= set(whole)
        with open_bag(path) as bag:
            assert bag.incomplete == ('bag.mcap has no end' if has_metadata
                                      else marker.UNFINISHED)
    assert counts == sorted(counts, reverse=True) and len(set(counts)) >= 3
    assert counts[:4] == [len(whole)] * 4 and counts[-1] == 0


def test_a_chunk_that_lacks_its_last_byte_is_dropped(tmp_path, finished):
    """What mcap returns of it would be a message without its end."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader
    with (finished / 'bag.mcap').open('rb') as file:
        first = next(r for r in StreamReader(file, emit_chunks=True).records
                     if isinstance(r, Chunk))
    start = (finished / 'bag.mcap').read_bytes().index(first.data)
    end = start + len(first.data)
    whole = recover(cut_copy(finished, tmp_path / 'whole', end))
    assert whole > 100
    with pytest.raises(BagError, match='holds no complete chunk'):
        recover(cut_copy(finished, tmp_path / 'cut', end - 1))


def test_the_readable_bag_may_be_written_elsewhere(tmp_path, finished):
    size = (finished / 'bag.mcap').stat().st_size
    cut = cut_copy(finished, tmp_path / 'cut', size - 1000)
    before = {p: p.read_bytes() for p in cut.iterdir()}
    count = recover(cut, tmp_path / 'elsewhere' / 'bag')
    assert len(everything(tmp_path / 'elsewhere' / 'bag')) == count
    assert {p: p.read_bytes() for p in cut.iterdir()} == before
    with pytest.raises(BagError, match='exists already and is not overwritten'):
        recover(cut, tmp_path / 'elsewhere' / 'bag')


def test_a_disk_without_space_is_named_before_anything_is_written(tmp_path, finished,
                                                                  monkeypatch):
    size = (finished / 'bag.mcap').stat().st_size
    cut = cut_copy(finished, tmp_path / 'cut', size - 1000)
    monkeypatch.setattr(shutil, 'disk_usage', lambda _: shutil._ntuple_diskusage(9, 9, 1000))
    with pytest.raises(BagError, match='MB are needed, 0 MB are free; make space, or name'):
        recover(cut)
    assert sorted(os.listdir(cut)) == ['bag.mcap', 'incomplete.yaml']


@pytest.mark.parametrize('compression', COMPRESSIONS)
def test_a_full_disk_is_one_error_and_a_bag_to_recover(tmp_path, messages, compression):
    limit = 5_000_000 if compression == 'none' else 1_900_000
    done = record(messages, tmp_path / 'bag', compression, limit)
    assert done.returncode == 1, done.stderr
    said, reached_ns = done.stdout.splitlines()
    assert 'cannot be written' in said and 'marked incomplete' in said
    reason = marker.why_incomplete(tmp_path / 'bag')
    assert reason in said
    count = recover(tmp_path / 'bag')
    with open_bag(tmp_path / 'bag') as bag:
        assert bag.incomplete == reason
        assert len(list(bag.raw())) == bag.message_count == count
        # At most two chunks are lost.
        assert bag.end_ns >= int(reached_ns) - 1.1e9 > 0


def test_a_bag_that_is_being_recorded_is_left_alone(tmp_path, items):
    with BagWriter(tmp_path / 'bag') as writer:
        for item in items[:50]:
            writer.write('/' + item.topic, item.msgtype, synthetic.serialise(item), 0)
        with pytest.raises(BagError, match='is still being recorded'):
            recover(tmp_path / 'bag')
    assert len(everything(tmp_path / 'bag')) == 50


def test_recover_says_when_there_is_nothing_to_do(tmp_path, items):
    path = synthetic.write(tmp_path / 'bag', items[:20])
    with pytest.raises(BagError, match='nothing to recover'):
        recover(path)
    with pytest.raises(BagError, match='not a bag folder'):
        recover(tmp_path / 'none')
    (tmp_path / 'empty').mkdir()
    with pytest.raises(BagError, match='neither .mcap nor .db3'):
        recover(tmp_path / 'empty')
    other = synthetic.write_sqlite(tmp_path / 'other', items[:20])
    (other / 'metadata.yaml').unlink()
    with pytest.raises(BagError, match='only MCAP files are recovered; `ros2 bag reindex`'):
        recover(other)


def test_a_message_outside_of_chunks_is_complete_where_another_record_follows(tmp_path, finished):
    """As other recorders write them. With a cut in the third, the second may be cut too."""
    from mcap.reader import make_reader as reader_of
    from mcap.writer import CompressionType, Writer
    bag = cut_copy(finished, tmp_path / 'bag', None)
    file, ends = bag / 'bag.mcap', []
    with file.open('rb') as stream:
        schema, channel, message = next(reader_of(stream).iter_messages())
    with file.open('wb') as stream:
        writer = Writer(stream, use_chunking=False, compression=CompressionType.NONE)
        writer.start('ros2')
        known = writer.register_channel(channel.topic, channel.message_encoding,
                                        writer.register_schema(schema.name, schema.encoding,
                                                               schema.data), channel.metadata)
        for k in range(4):
            writer.add_message(known, k + 1, message.data, k + 1)
            ends.append(stream.tell())
    file.write_bytes(file.read_bytes()[:ends[2] - 1])
    assert recover(bag) == 1
    assert len(everything(bag)) == 1
