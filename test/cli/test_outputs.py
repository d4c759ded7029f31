"""Outputs that cannot be written, and paths of the wrong kind: one line, nothing left behind."""

from pathlib import Path
import time

from command_line import unfolded
import pytest

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.cli.main import COMMANDS, load, main

# What each command needs besides its output.
WORDS = {
    'bag preview': ['bag'], 'bag video': ['bag'], 'bag recover': ['bag'], 'bag export': ['bag'],
    'benchmark drives': [], 'benchmark traverse': [], 'calibrate gait': [],
    'campaign': ['polar_suns'],
    'dataset shards': ['dataset'], 'demo': [],
    'evaluate images': ['a', 'b'],
    'evaluate map': ['bag'], 'validate navigation': [],
    'evaluate trajectory': ['a.txt', 'b.txt'], 'render': ['flat'], 'rover export': [],
    'run': ['flat'], 'slam seal': ['benchmark'], 'slam settings': ['flat'], 'slam run': ['bag'],
    'slam table': ['part'], 'validate imu': [],
    'validate learning': [], 'validate locomotion': [], 'validate stereo': ['flat'],
    'validate terramechanics': [], 'world build': [],
    'world export': ['world'],
    'world preview': ['world'], 'world sun': ['0', '-89']}
OF_FILES = {'bag video': '.mp4', 'calibrate gait': '.yaml',
            'rover export': '.urdf', 'slam settings': '.yaml',
            'validate imu': '.png', 'world export': '.glb', 'world preview': '.png',
            'world sun': '.png'}
# Inputs of the wrong kind: {folder} is empty, {file} is a text, {device} a link to one, {none}
# does not exist.
INPUTS = [
    'bag {what} {file}|bag {what} {folder}|bag {what} {none}|'
    'bag {what} {device}',
    'bag export {folder} -o {new}', 'bag recover {folder} -o {new}', 'bag recover {file}',
    'benchmark -o {new} --paper {folder}', 'benchmark -o {new} --scenarios {folder}',
    'calibrate gait {folder} -o {new}', 'calibrate gait --set rover={folder} -o {new}',
    'campaign {folder} -o {new}', 'campaign {file} -o {new}', 'campaign {device} --dry-run',
    'dataset shards {file} -o {new}', 'dataset shards {folder} -o {new}',
    'dataset verify {file}', 'dataset card {file}',
    'dataset verify {folder}', 'dataset card {folder}',
    'evaluate {folder} {folder}', 'evaluate {file} {none}', 'evaluate {file} {file}',
    'evaluate images {folder} {folder}', 'evaluate images {file} {file}',
    'render {folder} -o {new}', 'render flat --world {file} -o {new}',
    'render flat --world {folder} -o {new}', 'render flat --at {file} -o {new}',
    'rover export {folder} -o {new}.urdf', 'rover export --scenario {folder} -o {new}.urdf',
    'run {folder} -o {new}', 'run flat --world {file} -o {new}',
    'run flat --world {none} -o {new}',
    'slam seal {folder} -o {new}', 'slam seal {file} -o {new}', 'slam seal {none} -o {new}',
    'slam settings {folder} -o {new}', 'slam run {folder} -o {new}', 'slam run {file} -o {new}',
    'slam table {folder} -o {new}', 'slam table {file} -o {new}', 'slam table {none} -o {new}',
    'validate imu --set {folder} -o {new}.png', 'validate stereo {folder} -o {new}',
    'validate policy {file}', 'validate policy {folder}', 'validate policy {none}.onnx',
    'validate learning {file} -o {new}', 'run flat --policy {file} -o {new}',
    'validate terramechanics {folder} -o {new}', 'world info {file}', 'world info {folder}',
    'world preview {file} -o {new}.png', 'world export {file} -o {new}.glb',
    'world build --dem {folder} -o {new}', 'world build --mesh {folder} -o {new}',
    'world build --dem {device} -o {new}', 'world build --scenario {folder} -o {new}',
]


def lines(words: list[str], capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Return what a command says that must fail, within 5 s of processor time."""
    start = time.process_time()
    status = main(words)
    assert time.process_time() - start < 5.0, words
    said = unfolded(capsys.readouterr().err).splitlines()
    assert status == 1, (words, said)
    return said


def test_every_command_with_an_output_is_tried() -> None:
    assert set(WORDS) == {name for name in COMMANDS
                          if any(param.name == 'output' for param in load(name).params)}


@pytest.mark.parametrize('name', WORDS)
def test_what_cannot_be_written_is_one_line(name: str, tmp_path: Path,
                                            capsys: pytest.CaptureFixture[str]) -> None:
    """Below /sys, in a device, below a file; a file where a folder is expected and vice versa."""
    suffix = OF_FILES.get(name, '')
    (tmp_path / 'file').touch()
    (tmp_path / f'folder{suffix}').mkdir()
    device = tmp_path / 'device'     # root could replace the device itself
    device.symlink_to('/dev/full')
    outputs = [Path(f'/sys/x{suffix}'), Path(f'/proc/x/y{suffix}'), device / f'x{suffix}',
               tmp_path / 'file' / f'x{suffix}', device, tmp_path / ('x' * 300),
               tmp_path / (f'folder{suffix}' if suffix else 'file')]
    for output in outputs:
        said = lines([*name.split(), *WORDS[name], '-o', str(output)], capsys)
        assert len(said) == 1 and said[0].startswith('lunar_rover_sim: '), (output, said)
        # Where a folder or a file is right or wrong by other arguments, the command says it.
        assert 'output' in said[0] or name == 'bag export', (output, said)
    assert sorted(p.name for p in tmp_path.rglob('*')) == ['device', 'file', f'folder{suffix}']
    assert device.is_symlink()


@pytest.mark.parametrize('words', [['world', 'sun', '0', '-89'], ['world', 'preview', 'world']])
def test_figures_are_png(words: list[str], tmp_path: Path,
                         capsys: pytest.CaptureFixture[str]) -> None:
    """A file of another suffix held a PNG all the same."""
    said = lines([*words, '-o', str(tmp_path / 'x.pdf')], capsys)
    assert len(said) == 1 and 'valid is one that ends in .png' in said[0]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('line', [
    one.replace('{what}', what) for text in INPUTS for one in text.split('|')
    for what in (('info', 'check', 'hash', 'preview') if '{what}' in one else ('',))])
def test_inputs_of_the_wrong_kind_are_one_line(line: str, tmp_path: Path,
                                               capsys: pytest.CaptureFixture[str]) -> None:
    """A folder where a file is expected, a file where a folder is, a device, nothing."""
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'file').write_text('nothing of use\n')
    (tmp_path / 'device').symlink_to('/dev/zero')
    paths = {name: tmp_path / name for name in ('device', 'file', 'folder', 'new', 'none')}
    words = [word.format(**paths) for word in line.split()]
    said = lines(words, capsys)
    assert len(said) == 1 and said[0].startswith('lunar_rover_sim: '), said
    assert sorted(p.name for p in tmp_path.rglob('*')) == ['device', 'file', 'folder']


def test_a_device_is_not_replaced_by_a_file(tmp_path: Path) -> None:
    """By a rename, root could."""
    link = tmp_path / 'x.png'
    link.symlink_to('/dev/full')
    with pytest.raises(StudyError, match='not a regular file'):
        atomic_write(link, b'', StudyError)
    assert link.is_symlink() and len(list(tmp_path.iterdir())) == 1
