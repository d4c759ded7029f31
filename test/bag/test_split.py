"""Bags of several files, as rosbag2 splits them by size, are one bag for every reader."""

import json
from pathlib import Path
import tracemalloc

import pytest
from rosbags.rosbag2 import Reader
import synthetic_bag as synthetic

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.content_hash import bag_hash
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.recovery import recover
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.products.inspection.check import check

SIZE = 1 << 20


@pytest.fixture(scope='module')
def items() -> list[synthetic.Item]:
    """Return a drive whose images are written after the states of a quarter of a second later."""
    found = synthetic.drive(1.0)
    images = [item for item in found if 'stereo' in item.topic or 'depth' in item.topic]
    others = [item for item in found if item not in images]
    step = len(others) // len(images) + 1
    late: list[synthetic.Item] = []
    for k, item in enumerate(others):
        late.append(item)
        if k > len(others) // 4 and k % step == 0 and images:
            late.append(images.pop(0))
    return late + images


@pytest.fixture(scope='module')
def one(items, tmp_path_factory) -> Path:
    return synthetic.write(tmp_path_factory.mktemp('one') / 'bag', items)


@pytest.fixture(scope='module')
def split(items, tmp_path_factory) -> Path:
    return synthetic.write(tmp_path_factory.mktemp('split') / 'bag', items, max_bytes=SIZE)


def test_files_are_named_and_described_as_rosbag2_does(one, split):
    told, whole_of_one = synthetic.metadata(split), synthetic.metadata(one)
    names = told['relative_file_paths']
    assert names == [f'bag_{k}.mcap' for k in range(len(names))] and len(names) > 3
    assert sorted(file.name for file in split.iterdir()) == sorted([*names, 'metadata.yaml'])
    assert [file['path'] for file in told['files']] == names
    assert sum(file['message_count'] for file in told['files']) == told['message_count']
    for file in told['files']:
        with Reader(split / file['path']) as reader:
            assert reader.message_count == file['message_count'] > 0
            assert reader.start_time == file['starting_time']['nanoseconds_since_epoch']
            assert reader.duration - 1 == file['duration']['nanoseconds']
    for key in ('starting_time', 'duration', 'message_count', 'topics_with_message_count',
                'custom_data'):
        assert told[key] == whole_of_one[key]


def test_it_is_read_as_one_in_the_order_of_time(one, split):
    with open_bag(one) as whole_bag, open_bag(split) as bag:
        assert len(bag.file_counts) > 3
        assert [m.time_ns for m in bag.raw()] == [m.time_ns for m in whole_bag.raw()]
        assert sorted(bag.raw()) == sorted(whole_bag.raw())
        some = ['odom', 'stereo/left/image_raw']
        assert sorted(bag.raw(some, 300_000_000, 700_000_000)) == \
            sorted(whole_bag.raw(some, 300_000_000, 700_000_000))
        assert [f.stamp_ns for f in bag.frames()] == [f.stamp_ns for f in whole_bag.frames()]
        assert (bag.start_ns, bag.end_ns) == (whole_bag.start_ns, whole_bag.end_ns)


def test_hash_check_and_export_do_not_see_the_split(one, split, tmp_path, capsys):
    assert bag_hash(split) == bag_hash(one)
    assert [(f.check, f.status, f.detail) for f in check(split).findings] == \
        [(f.check, f.status, f.detail) for f in check(one).findings]
    for path in (one, split):
        assert main(['bag', 'export', str(path), '--output', str(tmp_path / path.parent.name),
                     '--format', 'tum']) == 0
    a, b = (sorted((file.relative_to(tmp_path / path.parent.name), file.read_bytes())
                   for file in (tmp_path / path.parent.name).rglob('*') if file.is_file())
            for path in (one, split))
    assert a == b
    capsys.readouterr()
    assert main(['bag', 'info', str(split), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['files'] == len(list(split.glob('*.mcap')))


def test_a_lost_or_short_file_is_found(items, tmp_path):
    bag = synthetic.write(tmp_path / 'bag', items, max_bytes=SIZE)
    file = bag / 'bag_1.mcap'
    data = file.read_bytes()
    file.write_bytes(data[:-9])
    with pytest.raises(BagError, match='bag_1.mcap has no end'):
        open_bag(bag)
    file.unlink()
    with pytest.raises(BagError, match='bag_1.mcap'):
        open_bag(bag)


def test_after_a_kill_the_whole_files_stay_and_the_last_is_recovered(items, tmp_path):
    whole_bag = synthetic.write(tmp_path / 'whole' / 'bag', items, max_bytes=SIZE)
    bag = tmp_path / 'bag'
    bag.mkdir()
    files = sorted(whole_bag.glob('*.mcap'))[:3]
    for file in files:
        (bag / file.name).write_bytes(file.read_bytes())
    last = bag / files[-1].name
    last.write_bytes(last.read_bytes()[:-1000])
    marker.mark(bag)
    kept = [(bag / file.name).read_bytes() for file in files[:2]]
    with pytest.raises(BagError, match='bag recover'):
        open_bag(bag)
    count = recover(bag)
    assert [(bag / file.name).read_bytes() for file in files[:2]] == kept
    with open_bag(bag) as found, open_bag(whole_bag) as original:
        assert found.incomplete and found.message_count == count
        assert set(found.raw()) <= set(original.raw())
        assert count > sum(list(original.file_counts.values())[:2])
    with Reader(bag) as reader:
        assert len(list(reader.messages())) == count
    # A file that had just begun holds nothing that could be kept.
    (bag / 'metadata.yaml').unlink()
    (bag / 'bag_3.mcap').write_bytes(marker.MAGIC)
    assert recover(bag) == count
    assert not (bag / 'bag_3.mcap').exists()


def test_a_reader_holds_a_few_chunks_at_once(tmp_path):
    image = next(i for i in synthetic.drive(0.1) if i.topic == 'stereo/left/image_raw')
    raw = synthetic.serialise(image)
    with BagWriter(tmp_path / 'bag', max_bytes=4 * SIZE) as writer:
        writer.add_topic('/stereo/left/image_raw', image.msgtype)
        for k in range(2000):       # 38 MB
            writer.write_at('/stereo/left/image_raw', k, raw)
    tracemalloc.start()
    with open_bag(tmp_path / 'bag') as bag:
        before = tracemalloc.get_traced_memory()[0]
        assert sum(1 for _ in bag.raw()) == 2000
        assert tracemalloc.get_traced_memory()[1] - before < 8 * SIZE
    tracemalloc.stop()
