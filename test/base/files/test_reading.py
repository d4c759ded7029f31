"""Files are untrusted: what cannot be read is one error of the subject, and nothing hangs."""

import logging
import os
from pathlib import Path
import struct
import zipfile

import cv2
import numpy as np
import pytest
import yaml

from lunar_rover_sim.base.errors import ConfigError, WorldError
from lunar_rover_sim.base.files.arrays import map_array, read_archive
from lunar_rover_sim.base.files.images import read_picture
from lunar_rover_sim.base.files.library_output import stderr_to_log
from lunar_rover_sim.base.files.paths import check_regular, user_path
from lunar_rover_sim.base.files.yaml_text import parse_yaml, read_yaml, yaml_of
from lunar_rover_sim.ground.world.cache import cache_folder


@pytest.fixture(params=['pipe', 'device', 'folder', 'loop', 'nothing'])
def no_file(request, tmp_path) -> Path:
    """Return the path of something that is no regular file."""
    path: Path = tmp_path / 'no_file'
    if request.param == 'pipe':
        os.mkfifo(path)
    elif request.param == 'device':
        path.symlink_to('/dev/zero')
    elif request.param == 'folder':
        path.mkdir()
    elif request.param == 'loop':
        path.symlink_to(path.name)
    return path


@pytest.mark.parametrize('read', [
    check_regular, lambda path, error: read_yaml(path, 1000, error), map_array, read_picture,
    lambda path, error: read_archive(path, error, 1000)])
def test_only_regular_files_are_read(no_file, read):
    with pytest.raises(WorldError, match='no_file: cannot be read: '):
        read(no_file, WorldError)


def test_documents_have_the_error_of_their_subject(tmp_path):
    for content, words in ((b'a: [', 'not valid YAML'), (b'\xff', 'is not UTF-8'),
                           (b'a: 0x_', 'not valid YAML'), (b'#' * 2000, 'larger than')):
        (tmp_path / 'x.yaml').write_bytes(content)
        with pytest.raises(WorldError, match=f'x.yaml: .*{words}'):
            read_yaml(tmp_path / 'x.yaml', 1000, WorldError)


def test_dates_are_text():
    """As ROS 2 reads them, with quotes and without."""
    assert parse_yaml('[2026-11-22T06:00:00Z, 2026-11-22, "2026-11-22"]', 'x') == [
        '2026-11-22T06:00:00Z', '2026-11-22', '2026-11-22']


def npy(header: str, data: bytes = b'') -> bytes:
    """Return a .npy file with a header."""
    return b'\x93NUMPY\x01\x00' + struct.pack('<H', len(header)) + header.encode() + data


@pytest.mark.parametrize('content', [
    npy("{'descr': '<f4', 'fortran_order': False, 'shape': (3"),
    npy(f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({10**30},), }}"),
    npy("{'descr': '<f4', 'fortran_order': False, 'shape': (-1, 4), }", bytes(64)),
    npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", bytes(64)),
    b'PK\x03\x04' + bytes(100), b'', b'\x93NUMPY'])
def test_damaged_arrays(tmp_path, content):
    (tmp_path / 'x.npy').write_bytes(content)
    with pytest.raises(WorldError, match='x.npy: '):
        map_array(tmp_path / 'x.npy', WorldError)
    with zipfile.ZipFile(tmp_path / 'x.npz', 'w') as archive:
        archive.writestr('a.npy', content)
    with pytest.raises(WorldError, match='x.npz: '):
        read_archive(tmp_path / 'x.npz', WorldError, 1000)


def test_archives_are_bounded(tmp_path):
    np.savez(tmp_path / 'x.npz', a=np.zeros(1000))
    assert read_archive(tmp_path / 'x.npz', WorldError, 10_000)['a'].shape == (1000,)
    with pytest.raises(WorldError, match='a.npy: larger than 1000 bytes'):
        read_archive(tmp_path / 'x.npz', WorldError, 1000)


def test_pictures(tmp_path, capfd):
    """Pixels are as written; a damaged file is an error and nothing that libpng prints."""
    pixels = np.arange(48 * 32, dtype=np.uint16).reshape(48, 32) * 40
    cv2.imwrite(str(tmp_path / 'deep.png'), pixels)
    assert np.array_equal(read_picture(tmp_path / 'deep.png', WorldError), pixels >> 8)
    colours = np.dstack([pixels >> 8] * 3).astype(np.uint8)
    colours[..., 0] = 200     # blue, as OpenCV has it
    cv2.imwrite(str(tmp_path / 'colour.png'), colours)
    read = read_picture(tmp_path / 'colour.png', WorldError, colour=True)
    assert np.array_equal(read, colours[..., ::-1])
    content = (tmp_path / 'colour.png').read_bytes()
    for bad in (content[:200], content[:60] + b'\x00\xff' + content[62:], b'', b'\x89PNG'):
        (tmp_path / 'bad.png').write_bytes(bad)
        with pytest.raises(WorldError, match='bad.png: cannot be read as a picture'):
            read_picture(tmp_path / 'bad.png', WorldError)
    assert capfd.readouterr().err == ''


def test_a_home_that_is_not_there(monkeypatch):
    monkeypatch.delenv('LUNAR_ROVER_SIM_CACHE')
    monkeypatch.setenv('XDG_CACHE_HOME', '/large/cache')
    assert cache_folder() == Path('/large/cache/lunar_rover_sim/worlds')
    monkeypatch.setenv('XDG_CACHE_HOME', 'relative')
    assert cache_folder() == Path.home() / '.cache' / 'lunar_rover_sim' / 'worlds'
    monkeypatch.setattr(Path, 'home', lambda: (_ for _ in ()).throw(RuntimeError('no home')))
    with pytest.raises(ConfigError, match='no home folder .* LUNAR_ROVER_SIM_CACHE'):
        cache_folder()
    with pytest.raises(ConfigError, match='path: ~nobody_at_all/x names a home folder that'):
        user_path('~nobody_at_all/x', 'path')


def test_who_reads_yaml_may_change_what_was_read():
    """Documents are parsed once; each reader has a copy of its own."""
    text = 'a: {b: [1, 2]}'
    parse_yaml(text, 'x')['a']['b'].append(3)
    assert parse_yaml(text, 'y') == {'a': {'b': [1, 2]}}


@pytest.mark.parametrize('layout', [{}, {'width': 99, 'default_flow_style': None}])
def test_yaml_is_written_as_pyyaml_itself_writes_it(layout) -> None:
    rng = np.random.default_rng(0)
    document = {
        'numbers': [1, -0.0, 1e-9, 1.5e300, float('inf'), *rng.standard_normal(30).tolist()],
        'rows': rng.standard_normal((3, 20)).round(5).tolist(), 'empty': [[], {}, '', None],
        'like other types': ['true', '~', '1.0e+3', '0x1f', '2026-11-24', '- a: b #', 'yes',
                             ' x '],
        'text': ['a' * 120, 'word ' * 60, 'two\nlines\n', '\ttab \\ "q" \'q\'', 'é 日本 🚀 \x07'],
        'deep': {'a': {'b': {'c': [True, {'d': 1}]}}}}
    assert yaml_of(document, **layout) == yaml.safe_dump(document, sort_keys=False, **layout)


@pytest.mark.parametrize('text', ['72408341e0386166', '0123', '1e3', '.5e3', '2026-11-22', 'yes'])
def test_texts_that_look_like_numbers_come_back(text) -> None:
    """Hashes are such: one in 700 worlds had one that came back as infinity, and was refused."""
    assert parse_yaml(yaml_of({'hash': text}), 'here') == {'hash': text}


def test_the_terminal_sees_nothing_of_it(capfd, caplog):
    logger = logging.getLogger('lunar_rover_sim.test')
    with caplog.at_level(logging.INFO):
        with stderr_to_log(logger):
            os.write(2, b'one\xff\ntwo\n')
    assert [record.getMessage() for record in caplog.records] == ['one\ufffd', 'two']
    os.write(2, b'after\n')
    assert capfd.readouterr().err == 'after\n'


def test_an_error_passes_and_the_terminal_is_back(capfd):
    try:
        with stderr_to_log(logging.getLogger('lunar_rover_sim.test')):
            raise KeyError
    except KeyError:
        os.write(2, b'after\n')
    assert capfd.readouterr().err == 'after\n'
