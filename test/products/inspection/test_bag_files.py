"""`bag check` compares what metadata.yaml says of each file with what the file holds."""

from pathlib import Path
import shutil
from typing import Any

import pytest
import synthetic_bag as synthetic
import yaml

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.recovery import recover
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.products.inspection.report import Status

SUFFIX = {'mcap': 'mcap', 'sqlite3': 'db3'}


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Give a bag of one file in each storage."""
    folder = tmp_path_factory.mktemp('whole')
    items = synthetic.drive(0.2, state_hz=50, only=(topics.ODOM, topics.TF))
    return {storage: write(folder / storage / 'bag', items)
            for storage, write in synthetic.WRITERS.items()}


@pytest.fixture(scope='module')
def split(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Give a bag of two files in each storage, as `ros2 bag record --max-bag-duration` has it.

    The first file holds 12 messages, the second one 8.
    """
    folder = tmp_path_factory.mktemp('split')
    items = synthetic.drive(0.2, state_hz=50, only=(topics.ODOM, topics.TF))
    return {storage: _join(folder / storage, [
        write(folder / storage / name, part)
        for name, part in (('bag_0', items[:12]), ('bag_1', items[12:]))])
            for storage, write in synthetic.WRITERS.items()}


def _join(folder: Path, bags: list[Path]) -> Path:
    joined = folder / 'bag'
    joined.mkdir()
    told = []
    for bag in bags:
        told.append(synthetic.metadata(bag))
        shutil.move(bag / told[-1]['relative_file_paths'][0], joined)
    first, second = told
    start_ns = first['starting_time']['nanoseconds_since_epoch']
    end_ns = (second['starting_time']['nanoseconds_since_epoch']
              + second['duration']['nanoseconds'])
    counts = {topic['topic_metadata']['name']: topic['message_count']
              for topic in second['topics_with_message_count']}
    for topic in first['topics_with_message_count']:
        topic['message_count'] += counts[topic['topic_metadata']['name']]
    first |= {'custom_data': None,
              'relative_file_paths': [*first['relative_file_paths'],
                                      *second['relative_file_paths']],
              'files': [*first['files'], *second['files']],
              'duration': {'nanoseconds': end_ns - start_ns},
              'message_count': first['message_count'] + second['message_count']}
    (joined / marker.METADATA_NAME).write_text(
        yaml.safe_dump({'rosbag2_bagfile_information': first}))
    return joined


def found(bag: Path, name: str) -> tuple[Status, str]:
    """Return what one check finds."""
    (finding,) = [one for one in check(bag).findings if one.check == name]
    return finding.status, finding.detail


@pytest.mark.parametrize('storage', synthetic.WRITERS)
def test_a_wrong_number_of_the_only_file(whole: dict[str, Path], tmp_path: Path,
                                         storage: str) -> None:
    bag = Path(shutil.copytree(whole[storage], tmp_path / 'bag'))
    assert found(bag, 'readable')[0] is Status.PASS
    with synthetic.changed_metadata(bag) as told:
        told['files'][0]['message_count'] = 7
    assert found(bag, 'readable') == (
        Status.FAIL, f'bag.{SUFFIX[storage]}: 7 messages by metadata.yaml, 20 are found')


@pytest.mark.parametrize('storage', synthetic.WRITERS)
def test_wrong_numbers_of_several_files(split: dict[str, Path], tmp_path: Path,
                                        storage: str) -> None:
    """Also where their sum is right."""
    bag = Path(shutil.copytree(split[storage], tmp_path / 'bag'))
    with open_bag(bag) as opened:
        assert list(opened.file_counts.values()) == [12, 8]
    for name in ('complete', 'readable', 'span'):
        assert found(bag, name)[0] is Status.PASS

    with synthetic.changed_metadata(bag) as told:
        for entry, count in zip(told['files'], (8, 12)):
            entry['message_count'] = count
    assert found(bag, 'readable') == (
        Status.FAIL, f'bag_0.{SUFFIX[storage]}: 8 messages by metadata.yaml, 12 are found')


def test_files_and_sums_that_do_not_fit(whole: dict[str, Path], tmp_path: Path) -> None:
    bag = Path(shutil.copytree(whole['mcap'], tmp_path / 'bag'))
    with synthetic.changed_metadata(bag) as told:
        told['message_count'] = 19
    assert found(bag, 'readable') == (
        Status.FAIL, 'message_count: 19 by metadata.yaml, 20 are found')
    for path in ('other.mcap', 3):
        with synthetic.changed_metadata(bag) as told:
            told['files'][0]['path'] = path
        with pytest.raises(BagError, match='files'):
            open_bag(bag)
    with synthetic.changed_metadata(bag) as told:
        del told['files']   # as before version 5 of the metadata
        told['message_count'] = 20
    assert found(bag, 'readable')[0] is Status.PASS


@pytest.mark.parametrize('files', [
    3, 'bag.mcap', [3], [{}], {'path': 'bag.mcap'},
    *([{'path': 'bag.mcap', 'message_count': count}]
      for count in (-3, 1.0, float('nan'), 1 << 64, True, 'many', None))])
def test_lists_of_files_that_are_none(whole: dict[str, Path], tmp_path: Path,
                                      files: object) -> None:
    """An error of one line names what is wrong in metadata.yaml."""
    bag = Path(shutil.copytree(whole['mcap'], tmp_path / 'bag'))
    with synthetic.changed_metadata(bag) as told:
        told['files'] = files
    with pytest.raises(BagError, match='files|message_count') as caught:
        check(bag)
    assert '\n' not in str(caught.value)


def test_every_file_fits_its_checksums_and_has_an_end(split: dict[str, Path],
                                                      tmp_path: Path) -> None:
    bag = Path(shutil.copytree(split['mcap'], tmp_path / 'bag'))
    assert found(bag, 'checksums')[0] is Status.PASS
    file = bag / 'bag_1.mcap'
    content = bytearray(file.read_bytes())
    # In the header, which no chunk's checksum covers.
    profile = content.index(b'lunar_rover_sim')
    content[profile] ^= 1
    file.write_bytes(content)
    status, detail = found(bag, 'checksums')
    assert status is Status.FAIL and detail.startswith('bag_1.mcap: ')
    file.write_bytes(content[:-1])
    try:
        with open_bag(bag) as opened:
            assert opened.incomplete == 'bag_1.mcap has no end'
    except BagError as error:
        assert 'bag_1.mcap has no end; make it readable with' in str(error)
    count = recover(bag, tmp_path / 'one')
    assert recover(bag) == count == 20
    for readable in (tmp_path / 'one', bag):
        with open_bag(readable) as opened:
            assert opened.incomplete == 'bag_1.mcap has no end'
            assert len(list(opened.raw())) == count


@pytest.mark.parametrize(('change', 'detail'), [
    ({'starting_time': {'nanoseconds_since_epoch': 1}}, 'begins at 0.000000001 s: there is no'),
    ({'duration': {'nanoseconds': 10**17}}, 's: there is no message'),
    ({'duration': {'nanoseconds': 1}}, 's: there are later messages')])
@pytest.mark.parametrize('storage', synthetic.WRITERS)
def test_times_that_the_messages_do_not_have(whole: dict[str, Path], tmp_path: Path, storage: str,
                                             change: dict[str, Any], detail: str) -> None:
    bag = Path(shutil.copytree(whole[storage], tmp_path / 'bag'))
    assert found(bag, 'span')[0] is Status.PASS
    with synthetic.changed_metadata(bag) as told:
        told.update(change)
    status, found_detail = found(bag, 'span')
    assert status is Status.FAIL and detail in found_detail
