"""Bags whose messages are compressed one by one, as by `--compression-mode message`."""

from pathlib import Path
import shutil
import sys

from command_line import unfolded
import pytest
from rosbags.rosbag2 import Reader, StoragePlugin
import synthetic_bag as synthetic

from lunar_rover_sim.bag.content_hash import bag_hash
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.cli.main import main

PLUGINS = {'mcap': StoragePlugin.MCAP, 'db3': StoragePlugin.SQLITE3}


@pytest.fixture(scope='module', name='items')
def _items() -> list[synthetic.Item]:
    return synthetic.drive(0.3)


@pytest.fixture(scope='module', name='plain_hash')
def _plain_hash(items: list[synthetic.Item], tmp_path_factory: pytest.TempPathFactory) -> str:
    return bag_hash(synthetic.write(tmp_path_factory.mktemp('plain') / 'bag', items))


def compressed(path: Path, items: list[synthetic.Item], storage: str = 'mcap') -> Path:
    return synthetic.write_sqlite(path, items, compression='zstd', storage=PLUGINS[storage])


def split(folder: Path, items: list[synthetic.Item]) -> Path:
    """Return a bag of two files, as rosbag2 splits them: one after the other."""
    half = len(items) // 2
    bag, other = (compressed(folder / name, part) for name, part in (
        ('bag', items[:half]), ('more', items[half:])))
    file = (other / 'more.mcap').rename(bag / 'more.mcap')
    told_other = synthetic.metadata(other)
    with synthetic.changed_metadata(bag) as told:
        told['relative_file_paths'].append(file.name)
        told['files'] += told_other['files']
        told['message_count'] += told_other['message_count']
        told['duration']['nanoseconds'] = int(0.3e9)
        counts = {topic['topic_metadata']['name']: topic
                  for topic in told['topics_with_message_count']}
        for topic in told_other['topics_with_message_count']:
            name = topic['topic_metadata']['name']
            if name in counts:
                counts[name]['message_count'] += topic['message_count']
            else:
                told['topics_with_message_count'].append(topic)
    shutil.rmtree(other)
    return bag


@pytest.mark.parametrize('storage', PLUGINS)
def test_every_command_reads_them(items: list[synthetic.Item], plain_hash: str, storage: str,
                                  tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = compressed(tmp_path / 'bag', items, storage)
    assert synthetic.metadata(bag)['compression_mode'] == 'message'
    assert main(['bag', 'info', str(bag)]) == 0
    assert f'{len(items)} messages' in capsys.readouterr().out
    assert main(['bag', 'hash', str(bag)]) == 0
    assert capsys.readouterr().out.split()[-1] == plain_hash
    assert main(['bag', 'check', str(bag)]) == 0
    assert main(['bag', 'export', str(bag), '-o', str(tmp_path / 'export')]) == 0
    assert main(['bag', 'preview', str(bag), '-o', str(tmp_path / 'preview')]) == 0
    assert (tmp_path / 'preview/stereo_0.png').is_file()
    program = tmp_path / 'program.py'
    program.write_text('import sys\n'
                       'for line in open(sys.argv[1]):\n'
                       '    t = int(line.split()[0]) * 1e-9\n'
                       '    print(t, t, t * t, 0, 0, 0, 0, 1, file=open(sys.argv[2], "a"))\n')
    assert main(['slam', 'run', str(bag), '-o', str(tmp_path / 'slam'), '--system', 'command',
                 '--run', f'{sys.executable} {program} {{times}} {{out}}']) == 0


@pytest.mark.parametrize('storage', PLUGINS)
def test_a_bare_file_is_read_though_it_does_not_say_so(
        items: list[synthetic.Item], plain_hash: str, storage: str, tmp_path: Path,
        capsys: pytest.CaptureFixture[str]) -> None:
    bag = compressed(tmp_path / 'bag', items, storage)
    file = (bag / f'bag.{storage}').rename(tmp_path / f'alone.{storage}')
    assert main(['bag', 'check', str(file)]) == 0
    assert main(['bag', 'hash', str(file)]) == 0
    assert capsys.readouterr().out.split()[-1] == plain_hash


def test_several_files_are_one_bag_in_the_order_of_time(items: list[synthetic.Item],
                                                        plain_hash: str, tmp_path: Path) -> None:
    bag = split(tmp_path, items)
    assert bag_hash(bag) == plain_hash
    with open_bag(bag) as opened:
        times = [message.time_ns for message in opened.raw()]
    assert len(times) == len(items) and times == sorted(times)


@pytest.mark.parametrize('files', ['one', 'split'])
def test_what_is_recovered_is_plain_for_every_reader(files: str, items: list[synthetic.Item],
                                                     plain_hash: str, tmp_path: Path) -> None:
    """Without its metadata and its end; of two files, only the second is cut off."""
    bag = split(tmp_path, items) if files == 'split' else compressed(tmp_path / 'bag', items)
    (bag / 'metadata.yaml').unlink()
    last = max(bag.glob('*.mcap'))
    with last.open('r+b') as file:
        file.truncate(last.stat().st_size - 50)     # a part of the footer is lost
    assert main(['bag', 'recover', str(bag)]) == 0
    assert bag_hash(bag) == plain_hash
    assert not synthetic.metadata(bag)['compression_mode']
    with Reader(bag) as reader:
        assert reader.message_count == len(items)
        assert all(data[:2] == b'\x00\x01' for _, _, data in reader.messages())


def test_a_damaged_message_is_told_and_the_others_are_recovered(
        items: list[synthetic.Item], tmp_path: Path, caplog: pytest.LogCaptureFixture,
        capsys: pytest.CaptureFixture[str]) -> None:
    broken = [item for item in items if item.topic == 'odom'][:5]
    bag = compressed(tmp_path / 'bag', broken)
    file = bag / 'bag.mcap'
    data = bytearray(file.read_bytes())
    at = data.index(b'\x28\xb5\x2f\xfd')
    data[at + 4:at + 12] = b'\xff' * 8
    file.write_bytes(data)
    assert main(['bag', 'hash', str(bag)]) == 1
    assert 'is damaged' in unfolded(capsys.readouterr().err)
    (bag / 'metadata.yaml').unlink()
    assert main(['bag', 'recover', str(bag)]) == 0
    with open_bag(bag) as opened:
        assert opened.message_count == 4
    assert 'compressed messages that are damaged and left out: 1' in ' '.join(
        [*capsys.readouterr().err.split(), caplog.text])
