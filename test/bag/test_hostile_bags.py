"""Bags are untrusted: what is no bag is one BagError, and nothing hangs."""

import dataclasses
import os
from pathlib import Path
import shutil
import struct

import pytest
import synthetic_bag as synthetic
import yaml

from lunar_rover_sim import topics
from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario
from lunar_rover_sim.bag.recovery import recover
from lunar_rover_sim.errors import BagError


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
