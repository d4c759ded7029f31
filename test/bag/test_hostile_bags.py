"""Bags that are damaged or meant to hurt, and the checksums that tell."""

from contextlib import closing
import dataclasses
import os
from pathlib import Path
import shutil
import sqlite3
import struct
import subprocess
import sys

from mcap.writer import IndexType
from mcap.writer import Writer as McapWriter
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario
from lunar_rover_sim.bag.recovery import recover
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.products.inspection.check import check, checksums
from lunar_rover_sim.products.inspection.report import CheckReport, Status


@pytest.fixture(scope='module')
def items() -> list[synthetic.Item]:
    return synthetic.drive(0.1, state_hz=50, only=(topics.SCENARIO, topics.ODOM, topics.TF))


@pytest.fixture(scope='module')
def written(items, tmp_path_factory) -> dict[str, Path]:
    """Return a small bag in each storage."""
    folder = tmp_path_factory.mktemp('bags')
    return {storage: write(folder / storage / 'bag', items)
            for storage, write in synthetic.WRITERS.items()}


@pytest.fixture
def bag(written, tmp_path) -> Path:
    """Return a copy of a small bag."""
    return Path(shutil.copytree(written['mcap'], tmp_path / 'bag'))


@pytest.mark.parametrize('name', ['bag.mcap', 'metadata.yaml', 'incomplete.yaml', 'bag.db3'])
@pytest.mark.parametrize('read', [open_bag, recover])
def test_pipes_and_devices_are_not_read(bag, name, read):
    (bag / name).unlink(missing_ok=True)
    os.mkfifo(bag / name)
    with pytest.raises(BagError, match=f'{name}: cannot be read: it is not a regular file'):
        read(bag)
    (bag / name).unlink()
    (bag / name).symlink_to('/dev/zero')
    with pytest.raises(BagError, match=f'{name}: cannot be read: it is not a regular file'):
        read(bag)
    with pytest.raises(BagError, match='not a regular file'):
        open_bag(bag / name)


@pytest.mark.parametrize('value', [['/odom'], 3, None, {}])
@pytest.mark.parametrize('name', ['name', 'type'])
def test_names_of_the_metadata_are_text(written, tmp_path, name, value):
    bag = Path(shutil.copytree(written['sqlite3'], tmp_path / 'bag'))
    with synthetic.changed_metadata(bag) as told:
        told['topics_with_message_count'][0]['topic_metadata'][name] = value
    with pytest.raises(BagError):
        with open_bag(bag) as opened:
            opened.resolve('odom')


def test_a_length_beyond_all_memory(bag):
    """The length of the first record of the file."""
    file = bag / 'bag.mcap'
    content = file.read_bytes()
    file.write_bytes(content[:9] + struct.pack('<Q', 1 << 60) + content[17:])
    with pytest.raises(BagError, match='it names a length that no mem'):
        open_bag(bag)


@pytest.mark.parametrize('text', ['a: 2001-99-99', '[' * 3000, '\x00', 'a: &a [*a]'])
def test_marks_and_scenarios_that_are_none(bag, items, text):
    """A mark that cannot be read marks; a scenario that cannot be read is none."""
    (bag / marker.MARKER_NAME).write_text(text)
    assert marker.why_incomplete(bag) == marker.UNFINISHED
    item = next(i for i in items if i.topic == 'scenario')
    item = dataclasses.replace(item, message=synthetic.msg('std_msgs/String', data=text))
    with open_bag(synthetic.write(bag.with_name('other'), [item])) as opened:
        assert not recorded_scenario(opened)


_OPEN = """
import sys
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base.errors import BagError
for path in sys.argv[1:]:
    try:
        open_bag(path)
    except BagError as error:
        print(error)
"""


def test_yaml_that_is_nested_too_deeply_is_refused(written, tmp_path):
    """In another process: what crashed was the interpreter. In metadata, and in QoS anywhere."""
    bags = []

    def copy(storage: str) -> Path:
        bags.append(tmp_path / str(len(bags)) / 'bag')
        return Path(shutil.copytree(written[storage], bags[-1]))

    for text in ('[' * 100_000, '- ' * 100_000, '{a: ' * 50_000):
        (copy('mcap') / marker.METADATA_NAME).write_text(text)
    for summary in (True, False):
        with (copy('mcap') / 'bag.mcap').open('wb') as file:
            writer = McapWriter(file, **({} if summary else {
                'use_statistics': False, 'use_summary_offsets': False, 'repeat_channels': False,
                'repeat_schemas': False, 'index_types': IndexType.NONE}))
            writer.start('ros2', '')
            schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
            channel = writer.register_channel('/a', 'cdr', schema,
                                              {'offered_qos_profiles': '[' * 100_000})
            writer.add_message(channel, 1, b'\0\1\0\0\1\0\0\0\0', 1)
            writer.finish()
    with closing(sqlite3.connect(copy('sqlite3') / 'bag.db3')) as database, database:
        database.execute('UPDATE topics SET offered_qos_profiles = ?', ('[' * 100_000,))
    with synthetic.changed_metadata(copy('mcap')) as told:
        topic = told['topics_with_message_count'][0]['topic_metadata']
        topic['offered_qos_profiles'] = '[' * 100_000
    done = subprocess.run([sys.executable, '-c', _OPEN, *bags], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == len(bags) and all('cannot be read' in line for line in lines)


@pytest.fixture(scope='module')
def sealed(tmp_path_factory) -> Path:
    return synthetic.write(tmp_path_factory.mktemp('sealed') / 'sealed', synthetic.drive(0.3),
                           compression='zstd')


def test_every_flipped_byte_is_found(sealed, tmp_path):
    """By the check, or since it is no bag any more; all bytes of the end, many of the rest."""
    assert check(sealed).findings[1].status is Status.PASS
    copy = Path(shutil.copytree(sealed, tmp_path / 'sealed'))
    content = (copy / 'sealed.mcap').read_bytes()
    report = CheckReport()
    with open_bag(sealed) as bag:       # metadata and index of the whole one
        bag.file_counts = {copy / 'sealed.mcap': None}
        for at in {*range(8, len(content) - 60, len(content) // 40),
                   *range(len(content) - 60, len(content))}:
            broken = bytearray(content)
            broken[at] ^= 0x10
            (copy / 'sealed.mcap').write_bytes(broken)
            report.findings.clear()
            checksums(bag, report)
            assert report.findings[0].status is not Status.PASS, at
            if report.findings[0].status is Status.SKIP:    # it has no end
                with pytest.raises(BagError, match='has no end'), open_bag(copy) as opened:
                    raise BagError(str(opened.incomplete))


@pytest.mark.parametrize('content', [b'', b'\x89MCAP', b'\x89MCAP0\r\n'])
def test_a_file_too_short_for_an_end_has_none(tmp_path, content):
    (tmp_path / 'sealed.mcap').write_bytes(content)
    assert not marker.has_end(tmp_path / 'sealed.mcap')
    with pytest.raises(BagError, match='sealed.mcap'):
        open_bag(tmp_path / 'sealed.mcap')


@pytest.mark.parametrize(('count', 'message'), [
    ('-3', 'metadata.yaml: message.*: -3 is not valid'),
    ('.nan', 'nan is not valid'), ('1.5', '1.5 is not valid'),
    ('100000000000000000000', 'is not valid'), ('many', 'many')])
def test_counts_that_are_none_are_refused(tmp_path, count, message):
    path = tmp_path / 'sealed'
    with BagWriter(path) as writer:
        odom = next(i for i in synthetic.drive(0.1) if i.topic == 'odom')
        writer.write('/odom', odom.msgtype, synthetic.serialise(odom), 0)
    metadata = path / 'metadata.yaml'
    text = metadata.read_text()
    assert 'message_count: 1' in text
    metadata.write_text(text.replace('message_count: 1', f'message_count: {count}'))
    with pytest.raises(BagError, match=message) as caught:
        open_bag(path)
    assert '\n' not in str(caught.value)
