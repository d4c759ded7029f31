"""Checksums of MCAP files: other readers accept them, and damage is found."""

from pathlib import Path

from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.bag.checksums import damage, has_end
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.errors import BagError
from lunar_rover_sim.inspection.check import check
from lunar_rover_sim.inspection.report import Status


@pytest.fixture(scope='module', params=['none', 'zstd'])
def bag(request, tmp_path_factory) -> Path:
    return synthetic.write(tmp_path_factory.mktemp('bag') / 'bag', synthetic.drive(0.3),
                           compression=request.param)


def test_another_reader_verifies_them(bag):
    with (bag / 'bag.mcap').open('rb') as file:
        records = list(StreamReader(file, validate_crcs=True, emit_chunks=True).records)
    chunks = [r for r in records if type(r).__name__ == 'Chunk']
    assert chunks and all(chunk.uncompressed_crc for chunk in chunks)
    footer, = (r for r in records if type(r).__name__ == 'Footer')
    end, = (r for r in records if type(r).__name__ == 'DataEnd')
    assert footer.summary_crc and end.data_section_crc
    with (bag / 'bag.mcap').open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_summary().statistics.message_count == len(list(reader.iter_messages()))


def test_every_flipped_byte_is_found(bag, tmp_path):
    content = (bag / 'bag.mcap').read_bytes()
    assert damage(bag / 'bag.mcap') is None
    path = tmp_path / 'x.mcap'
    for at in range(8, len(content) - 8, len(content) // 40):
        broken = bytearray(content)
        broken[at] ^= 0x10
        path.write_bytes(broken)
        try:
            assert damage(path) is not None, at
        except BagError as error:       # a damaged length or chunk cannot be walked
            assert 'damaged' in str(error) and '\n' not in str(error), at


def test_bag_check_names_the_damage(bag, tmp_path):
    copy = tmp_path / 'bag'
    copy.mkdir()
    for name in ('bag.mcap', 'metadata.yaml'):
        (copy / name).write_bytes((bag / name).read_bytes())
    assert {i.check: i.status for i in check(copy).findings}['checksums'] is Status.PASS
    content = bytearray((copy / 'bag.mcap').read_bytes())
    content[-40] ^= 1       # in the summary, which rosbags does not verify
    (copy / 'bag.mcap').write_bytes(content)
    found = {i.check: i for i in check(copy).findings}['checksums']
    assert found.status is Status.FAIL and 'summary section' in found.detail


@pytest.mark.parametrize('content', [b'', b'\x89MCAP', b'\x89MCAP0\r\n'])
def test_a_file_too_short_for_an_end_has_none(tmp_path, content):
    (tmp_path / 'bag.mcap').write_bytes(content)
    assert not has_end(tmp_path / 'bag.mcap')
    with pytest.raises(BagError, match='bag.mcap'):
        open_bag(tmp_path / 'bag.mcap')


@pytest.mark.parametrize(('count', 'message'), [
    ('-3', 'metadata.yaml: messages.*: -3 is not valid'),
    ('.nan', 'nan is not valid'), ('1.5', '1.5 is not valid'),
    ('100000000000000000000', 'is not valid'), ('many', 'many')])
def test_counts_that_are_none_are_refused(tmp_path, count, message):
    path = tmp_path / 'bag'
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
