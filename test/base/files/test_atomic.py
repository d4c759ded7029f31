"""Files are written whole or not at all."""

import os
from pathlib import Path
import subprocess
import sys

from matplotlib.figure import Figure
import numpy as np
import pytest
from waiting import LIMIT_S

from lunar_rover_sim.bag import marker
from lunar_rover_sim.base.errors import BagError, WorldError
from lunar_rover_sim.base.files.atomic import atomic_write, partial_folder
from lunar_rover_sim.base.files.paths import lock
from lunar_rover_sim.base.files.results import save_figure

# Is killed in the middle of a write.
KILLED = """
import os, pathlib, signal, sys
from lunar_rover_sim.base.files.atomic import atomic_write
def content(file):
    file.write(b'new, in part')
    file.flush()
    os.kill(os.getpid(), signal.SIGKILL)
atomic_write(sys.argv[1], content)
"""


def files_in(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize(('content', 'written'), [
    ('Höhe\n', b'H\xc3\xb6he\n'), (b'\x00\xff', b'\x00\xff'),
    (lambda file: file.write(b'by a function'), b'by a function')])
def test_text_bytes_and_functions_are_written(tmp_path, content, written):
    atomic_write(tmp_path / 'a', content)
    assert (tmp_path / 'a').read_bytes() == written
    assert files_in(tmp_path) == ['a']


def test_a_library_can_write_to_the_file(tmp_path):
    atomic_write(tmp_path / 'a.npz', lambda file: np.savez(file, x=np.arange(3)))
    assert np.load(tmp_path / 'a.npz')['x'].tolist() == [0, 1, 2]


def test_an_existing_file_is_replaced(tmp_path):
    (tmp_path / 'a').write_text('a longer old text')
    atomic_write(str(tmp_path / 'a'), 'new')
    assert (tmp_path / 'a').read_text() == 'new'


def test_the_umask_decides_who_may_read_it(tmp_path):
    before = os.umask(0o027)
    try:
        atomic_write(tmp_path / 'a', 'x')
    finally:
        os.umask(before)
    assert (tmp_path / 'a').stat().st_mode & 0o777 == 0o640


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    (tmp_path / 'a').write_text('old')

    def content(file):
        file.write(b'new, in part')
        raise ValueError('no more')
    with pytest.raises(ValueError, match='no more'):
        atomic_write(tmp_path / 'a', content, WorldError)
    assert (tmp_path / 'a').read_text() == 'old'
    assert files_in(tmp_path) == ['a']


def test_a_kill_leaves_the_old_file(tmp_path):
    (tmp_path / 'a').write_text('old')
    child = subprocess.run([sys.executable, '-c', KILLED, str(tmp_path / 'a')], timeout=LIMIT_S)
    assert child.returncode == -9
    assert (tmp_path / 'a').read_text() == 'old'


@pytest.mark.parametrize('error', [BagError, WorldError])
def test_the_caller_chooses_the_error(tmp_path, error):
    path = tmp_path / 'missing' / 'a'
    with pytest.raises(error, match=f'^{path}: cannot be written: No such file or directory$'):
        atomic_write(path, 'x', error)


def test_without_a_choice_it_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        atomic_write(tmp_path / 'missing' / 'a', 'x')


def test_a_folder_in_the_way_stays(tmp_path):
    (tmp_path / 'a').mkdir()
    with pytest.raises(WorldError, match='a: cannot be written: Is a directory'):
        atomic_write(tmp_path / 'a', 'x', WorldError)
    assert files_in(tmp_path) == ['a']


def test_several_files_take_their_names_when_they_are_complete(tmp_path):
    with partial_folder(tmp_path / 'new' / 'a', WorldError) as folder:
        (folder / 'a').mkdir()
        (folder / 'left over').touch()
        assert not (tmp_path / 'new' / 'a').exists()
        (folder / 'a').rename(tmp_path / 'new' / 'a')
    assert files_in(tmp_path / 'new') == ['a']


@pytest.mark.parametrize(('reason', 'raised', 'words'), [
    (OSError(28, 'No space left on device'), WorldError, 'a: cannot be written: No space left'),
    (ValueError('no more'), ValueError, 'no more'),
    (KeyboardInterrupt(), KeyboardInterrupt, None)])
def test_of_several_files_nothing_is_left_by_a_failure(tmp_path, reason, raised, words):
    with pytest.raises(raised, match=words):
        with partial_folder(tmp_path / 'a', WorldError) as folder:
            (folder / 'part').write_text('x')
            raise reason
    assert files_in(tmp_path) == []


def test_a_folder_cannot_be_made_below_a_file(tmp_path):
    (tmp_path / 'file').touch()
    with pytest.raises(WorldError, match='a: cannot be written: Not a directory'):
        with partial_folder(tmp_path / 'file' / 'a', WorldError):
            pass


def test_half_a_figure_is_none(tmp_path, monkeypatch):
    save_figure(Figure(), tmp_path / 'a.png', WorldError)
    whole = (tmp_path / 'a.png').read_bytes()
    assert whole.startswith(b'\x89PNG')

    def full(figure, stream, **_):
        stream.write(whole[:100])
        raise OSError(28, 'No space left on device')
    monkeypatch.setattr(Figure, 'savefig', full)
    for name in ('a.png', 'b.png'):
        with pytest.raises(WorldError, match=f'{name}: cannot be written: No space left'):
            save_figure(Figure(), tmp_path / name, WorldError)
    assert files_in(tmp_path) == ['a.png'] and (tmp_path / 'a.png').read_bytes() == whole


@pytest.mark.parametrize('name', ['file', '.'])
def test_a_lock_is_held_once(tmp_path: Path, name: str) -> None:
    """On a file that is made, and on a folder."""
    first = lock(tmp_path / name)
    with pytest.raises(BlockingIOError):
        lock(tmp_path / name)
    os.close(first)
    os.close(lock(tmp_path / name))


def test_a_bag_without_a_mark_gets_none(tmp_path: Path) -> None:
    """An empty mark would call a complete bag incomplete."""
    with pytest.raises(FileNotFoundError):
        marker.lock(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_mark_of_a_bag_is_locked(tmp_path: Path) -> None:
    """As long as the file is open."""
    marker.mark(tmp_path)
    with marker.lock(tmp_path), pytest.raises(BlockingIOError):
        marker.lock(tmp_path)
    marker.lock(tmp_path).close()
