"""Bags that are damaged or meant to hurt, and the checksums that tell."""

import dataclasses
import os
from pathlib import Path
import shutil
import struct

from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
import pytest
import synthetic_bag as synthetic
import yaml

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.checksums import damage, has_end
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario
from lunar_rover_sim.bag.recovery import recover
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.products.inspection.report import Status


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
    document = yaml.safe_load((bag / marker.METADATA_NAME).read_text())
    topics = document['rosbag2_bagfile_information']['topics_with_message_count']
    topics[0]['topic_metadata'][name] = value
    (bag / marker.METADATA_NAME).write_text(yaml.safe_dump(document))
    with pytest.raises(BagError):
        with open_bag(bag) as opened:
            opened.resolve('odom')


def test_a_length_beyond_all_memory(bag):
    """The length of the first record of the file."""
    file = bag / 'bag.mcap'
    content = file.read_bytes()
    file.write_bytes(content[:9] + struct.pack('<Q', 1 << 60) + content[17:])
    with pytest.raises(BagError, match='cannot be read as a bag: it names a length that no mem'):
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


@pytest.fixture(scope='module', params=['none', 'zstd'])
def sealed(request, tmp_path_factory) -> Path:
    return synthetic.write(tmp_path_factory.mktemp('sealed') / 'sealed', synthetic.drive(0.3),
                           compression=request.param)


def test_another_reader_verifies_them(sealed):
    with (sealed / 'sealed.mcap').open('rb') as file:
        records = list(StreamReader(file, validate_crcs=True, emit_chunks=True).records)
    chunks = [r for r in records if type(r).__name__ == 'Chunk']
    assert chunks and all(chunk.uncompressed_crc for chunk in chunks)
    footer, = (r for r in records if type(r).__name__ == 'Footer')
    end, = (r for r in records if type(r).__name__ == 'DataEnd')
    assert footer.summary_crc and end.data_section_crc
    with (sealed / 'sealed.mcap').open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_summary().statistics.message_count == len(list(reader.iter_messages()))


def test_every_flipped_byte_is_found(sealed, tmp_path):
    content = (sealed / 'sealed.mcap').read_bytes()
    assert damage(sealed / 'sealed.mcap') is None
    path = tmp_path / 'x.mcap'
    for at in range(8, len(content) - 8, len(content) // 40):
        broken = bytearray(content)
        broken[at] ^= 0x10
        path.write_bytes(broken)
        try:
            assert damage(path) is not None, at
        except BagError as error:       # a damaged length or chunk cannot be walked
            assert 'damaged' in str(error) and '\n' not in str(error), at


def test_bag_check_names_the_damage(sealed, tmp_path):
    copy = tmp_path / 'sealed'
    copy.mkdir()
    for name in ('sealed.mcap', 'metadata.yaml'):
        (copy / name).write_bytes((sealed / name).read_bytes())
    assert {i.check: i.status for i in check(copy).findings}['checksums'] is Status.PASS
    content = bytearray((copy / 'sealed.mcap').read_bytes())
    content[-40] ^= 1       # in the summary, which rosbags does not verify
    (copy / 'sealed.mcap').write_bytes(content)
    found = {i.check: i for i in check(copy).findings}['checksums']
    assert found.status is Status.FAIL and 'summary section' in found.detail


@pytest.mark.parametrize('content', [b'', b'\x89MCAP', b'\x89MCAP0\r\n'])
def test_a_file_too_short_for_an_end_has_none(tmp_path, content):
    (tmp_path / 'sealed.mcap').write_bytes(content)
    assert not has_end(tmp_path / 'sealed.mcap')
    with pytest.raises(BagError, match='sealed.mcap'):
        open_bag(tmp_path / 'sealed.mcap')


@pytest.mark.parametrize(('count', 'message'), [
    ('-3', 'metadata.yaml: messages.*: -3 is not valid'),
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
