"""World folders: what is written is read, damage is found, nothing half-written stays."""

import dataclasses
import errno
import os
import shutil
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest
from waiting import LIMIT_S
import worlds
import yaml

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.ground.world import cache, world_folder
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.kept_arrays import kept

TINY = {'size_m': 3.2, 'cell_m': 0.05, 'surroundings': {'samples': 65, 'extent_m': 50.0}}


@pytest.fixture
def folder(tmp_path):
    return world_folder.save_world(worlds.world(**TINY), tmp_path / 'world')


def test_written_is_read(folder):
    world, again = worlds.world(**TINY), world_folder.load_world(folder)
    assert again.hash == world.hash and again.config == world.config
    assert len(again.levels) == len(world.levels)
    for a, b in zip(again.levels, world.levels):
        assert a.cell_m == b.cell_m and np.array_equal(a.heights_m, b.heights_m)
        assert not a.heights_m.flags.writeable
    assert np.array_equal(again.albedo, world.albedo)
    assert np.array_equal(again.rocks.position_m, world.rocks.position_m)
    assert np.array_equal(again.craters.age, world.craters.age)
    assert [s.name for s in again.rock_shapes] == [s.name for s in world.rock_shapes]
    assert again.report == world.report
    assert np.array_equal(again.height_at([[0.5, 0.5]]), world.height_at([[0.5, 0.5]]))


def test_what_was_found_while_building_is_kept(tmp_path):
    """It may be of any kind that YAML has; a world without any has none after reading."""
    report = {'file': '/moon/site.tif', 'holes': 3, 'center_lon_lat_deg': [12.5, -89.5]}
    for name, found in (('with', report), ('without', {})):
        world = dataclasses.replace(worlds.world(**TINY), report=found)
        folder = world_folder.save_world(world, tmp_path / name)
        assert world_folder.load_world(folder).report == found


def test_yaml_says_how_it_was_made(folder):
    document = yaml.safe_load((folder / 'world.yaml').read_text())
    assert document['world']['seed'] == 1
    assert document['world']['craters']['slope'] == 2.0
    assert document['hash'] == worlds.world(**TINY).hash


def test_hash_depends_on_content_alone(folder, tmp_path):
    again = world_folder.load_world(folder)
    assert world_folder.content_hash(again) == again.hash
    copy = world_folder.save_world(again, tmp_path / 'copy')
    assert world_folder.load_world(copy).hash == again.hash


@pytest.mark.parametrize('part', ['rocks', 'craters'])
def test_every_number_of_rocks_and_craters_counts_in_the_hash(part):
    world = worlds.world(**TINY)
    catalogue = getattr(world, part)
    for field in dataclasses.fields(catalogue):
        values = getattr(catalogue, field.name).copy()
        values.flat[0] += 1
        changed = dataclasses.replace(catalogue, **{field.name: values})
        other = dataclasses.replace(world, **{part: changed})
        assert world_folder.content_hash(other) != world.hash, field.name


def test_existing_folders_are_left_alone(folder, tmp_path):
    world = worlds.world(**TINY)
    with pytest.raises(WorldError, match='exists already'):
        world_folder.save_world(world, folder)
    world_folder.save_world(world, folder, overwrite=True)
    other = tmp_path / 'mine'
    other.mkdir()
    (other / 'thesis.txt').write_text('years of work')
    with pytest.raises(WorldError, match='is not a world; it is left as it is'):
        world_folder.save_world(world, other, overwrite=True)
    assert (other / 'thesis.txt').read_text() == 'years of work'


def test_a_full_disk_leaves_nothing(tmp_path, monkeypatch):
    real, calls = np.save, []

    def full(*args, **kwargs):
        calls.append(args)
        if len(calls) == 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(*args, **kwargs)
    monkeypatch.setattr(np, 'save', full)
    with pytest.raises(WorldError, match='cannot be written: No space left on device'):
        world_folder.save_world(worlds.world(**TINY), tmp_path / 'world')
    assert list(tmp_path.iterdir()) == []


def damaged(folder, message):
    with pytest.raises(WorldError, match=message) as error:
        world_folder.load_world(folder)
    assert '\n' not in str(error.value)


def test_changed_heights_are_noticed(folder):
    path = folder / 'height_0.npy'
    heights = np.load(path)
    heights[3, 3] += 0.001
    np.save(path, heights)
    damaged(folder, 'does not match its hash .*: build it again')
    world_folder.load_world(folder, verify=False)


def test_changed_parameters_are_noticed(folder):
    path = folder / 'world.yaml'
    path.write_text(path.read_text().replace('slope: 2.0', 'slope: 2.1'))
    damaged(folder, 'does not match its hash')


def test_what_is_no_world(tmp_path, folder):
    damaged(tmp_path / 'absent', 'not a world folder .* `lunar_rover_sim world build`')
    (folder / 'albedo.npy').unlink()
    damaged(folder, 'albedo.npy: .*no such file')


@pytest.mark.parametrize('text, message', [
    ('format: 99', 'format 99; this version reads format 2'),
    ('[1, 2', 'world.yaml: '),
    ('just text', "format 'just text'"),
    ('format: 2\ncells_m: lots', "cells_m: 'lots' is not a list"),
    ('format: 2\ncells_m: [0.05, -0.4]', 'is not a list of 1 to 8 cells'),
    ('format: 2\ncells_m: [0.05]\nmiddle_m: [0.0, .nan]', 'is not two places'),
    ('format: 2\ncells_m: [0.05]\nmiddle_m: [0.0, 0.0]\nworld: {sice_m: 3}', 'no such parameter'),
])
def test_other_yaml(folder, text, message):
    (folder / 'world.yaml').write_text(text)
    damaged(folder, message)


def test_arrays_are_bounded_and_never_unpickled(folder):
    good = (folder / 'height_0.npy').read_bytes()
    # A header that promises 40 GB on a file of a few kB.
    header = np.lib.format.header_data_from_array_1_0(np.zeros((2, 2), np.float32))
    header['shape'] = (100_000, 100_000)
    with open(folder / 'height_0.npy', 'wb') as stream:
        np.lib.format.write_array_header_1_0(stream, header)
    damaged(folder, 'height_0.npy')
    np.save(folder / 'height_0.npy', np.array([[{}]], object), allow_pickle=True)
    damaged(folder, 'height_0.npy')
    for heights in (np.zeros((65, 60), np.float32), np.zeros((65, 65)), np.zeros(65, np.float32)):
        np.save(folder / 'height_0.npy', heights)
        damaged(folder, 'not a square')
    (folder / 'height_0.npy').write_bytes(good[:1000])
    damaged(folder, 'height_0.npy')
    (folder / 'height_0.npy').write_bytes(good)
    np.savez(folder / 'rocks.npz', shape=np.zeros(3, np.int32))
    damaged(folder, 'rocks.npz: size is missing')
    (folder / 'rocks.npz').write_bytes(b'PK\x03\x04 no')
    damaged(folder, 'rocks.npz')


def test_indices_are_checked(folder):
    with np.load(folder / 'rocks.npz') as archive:
        arrays = dict(archive)
    arrays['shape'] = arrays['shape'] + np.int32(100)
    np.savez(folder / 'rocks.npz', **arrays)
    damaged(folder, 'rocks.npz: shape: indices beyond')


@pytest.mark.parametrize('names', [np.arange(3), np.array([['a', 'b']]), np.array(['a'] * 1025)])
def test_names_of_shapes_are_a_list_of_texts(folder, names):
    with np.load(folder / 'shapes.npz') as archive:
        arrays = dict(archive)
    np.savez(folder / 'shapes.npz', **{**arrays, 'names': names})
    damaged(folder, 'shapes.npz: names: not up to 1024 names')


@pytest.mark.parametrize('index', [-1, 10**6])
def test_faces_name_corners_that_are_there(folder, index):
    with np.load(folder / 'shapes.npz') as archive:
        arrays = dict(archive)
    arrays['faces_1'] = arrays['faces_1'].copy()
    arrays['faces_1'][2, 1] = index
    np.savez(folder / 'shapes.npz', **arrays)
    damaged(folder, 'not a triangle mesh')


def test_a_bomb_is_not_unpacked(folder):
    with zipfile.ZipFile(folder / 'rocks.npz', 'w', zipfile.ZIP_DEFLATED) as archive:
        archive.writestr('shape.npy', bytes(100_000_000))
    damaged(folder, 'larger than 64000000 bytes')


def test_cache(tmp_path, monkeypatch):
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'cache'))
    config = WorldConfig.from_mapping(TINY)
    first = cache.cached(config, 7)
    stamp = (first / 'world.yaml').stat().st_mtime_ns
    assert cache.cached(config, 7) == first
    assert (first / 'world.yaml').stat().st_mtime_ns == stamp
    assert cache.cached(config, 8) != first
    assert first.parent == tmp_path / 'cache' / 'worlds'
    # The scenario's seed and the recipe's own are the same thing.
    assert cache.cached(WorldConfig.from_mapping({**TINY, 'seed': 7}), 1) == first


def test_cache_that_cannot_be_written(tmp_path, monkeypatch):
    (tmp_path / 'file').write_text('')
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'file'))
    with pytest.raises(WorldError, match='cannot be written: .* LUNAR_ROVER_SIM_CACHE names'):
        cache.cached(WorldConfig.from_mapping(TINY), 7)


def test_cache_notices_a_changed_source(tmp_path):
    path = tmp_path / 'dem.tif'
    path.write_bytes(b'one')
    config = WorldConfig.from_mapping({**TINY, 'source': 'dem', 'path': str(path)})
    before = cache.cache_key(config, 1)
    path.write_bytes(b'another')
    assert cache.cache_key(config, 1) != before


def test_a_damaged_entry_heals_whichever_file_it_is(tmp_path, monkeypatch, caplog):
    """Bits, the end, or all of each file; a text in the report; and a file in place of all."""
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'cache'))
    config = WorldConfig.from_mapping(TINY)
    folder = cache.cached(config, 7)
    built = world_folder.load_world(folder)
    whole = {path.name: path.read_bytes() for path in folder.iterdir()}

    def heals():
        caplog.clear()
        assert cache.cached(config, 7, build=lambda: built) == folder
        assert 'building it again' in caplog.text
        assert world_folder.load_world(folder).hash == built.hash
        assert {path.name for path in folder.iterdir()} == set(whole)
        assert [path.name for path in folder.parent.iterdir() if '.lock' not in path.name
                ] == [folder.name]
    for name, content in whole.items():
        middle = len(content) // 2
        for damage in (None, content[:middle],
                       content[:middle] + bytes(b ^ 4 for b in content[middle:middle + 80])
                       + content[middle + 80:]):
            path = folder / name
            path.unlink()
            if damage is not None:
                path.write_bytes(damage)
            heals()
    text = (folder / 'world.yaml').read_text()
    (folder / 'world.yaml').write_text(text.replace('report:', 'report:\n  lon_deg: 1.5', 1)
                                       .replace('report:\n  lon_deg: 1.5 {}', 'report: {a: 1}'))
    heals()
    shutil.rmtree(folder)
    folder.write_text('a file')
    heals()


def builder(tmp_path, first=''):
    program = (f'{first}\n'
               'from lunar_rover_sim.ground.world import cache, world_folder\n'
               'from lunar_rover_sim.ground.world.config import WorldConfig\n'
               f'config = WorldConfig.from_mapping({TINY!r})\n'
               'print(world_folder.load_world(cache.cached(config, 3)).hash)')
    environment = {**os.environ, 'LUNAR_ROVER_SIM_CACHE': str(tmp_path),
                   'PYTHONPATH': os.pathsep.join(sys.path)}
    return subprocess.Popen([sys.executable, '-c', program], env=environment, text=True,
                            stdout=subprocess.PIPE)


def test_a_builder_that_is_killed_while_it_writes_and_two_at_once(tmp_path):
    """What the first leaves goes; the others make one world, whole."""
    killed = builder(tmp_path, 'import numpy, time\nnumpy.savez = lambda *a, **b: time.sleep(99)')
    while not list((tmp_path / 'worlds').glob('.*.partial/*/albedo.npy')):
        assert killed.poll() is None
        time.sleep(0.01)
    killed.kill()
    killed.communicate()
    running = [builder(tmp_path) for _ in range(2)]
    hashes = {process.communicate(timeout=LIMIT_S)[0].strip() for process in running}
    assert [process.returncode for process in running] == [0, 0]
    assert hashes == {worlds.world(3, **TINY).hash}
    folder, lock = sorted((path.name for path in (tmp_path / 'worlds').iterdir()),
                          key=lambda name: name.endswith('.lock'))
    assert lock == f'.{folder}.lock'


@pytest.fixture
def calls(monkeypatch, tmp_path):
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'cache'))
    return []


def computed(calls, recipe):
    def make():
        calls.append(recipe)
        return np.arange(6, dtype=np.float32).reshape(2, 3) * recipe
    return kept('test', [1, recipe], make)


def test_an_array_is_computed_once_for_each_recipe(calls):
    first, again, other = (computed(calls, k) for k in (2, 2, 3))
    assert calls == [2, 3]
    np.testing.assert_array_equal(first, again)
    assert again.dtype == np.float32 and again.flags.writeable
    np.testing.assert_array_equal(other, 1.5 * first)


def test_of_many_recipes_the_last_used_are_kept(calls, tmp_path):
    for k in range(60):
        computed(calls, k)
    computed(calls, 0)      # is used once more
    for k in range(60, 90):
        computed(calls, k)
    assert len(list((tmp_path / 'cache').parent.rglob('test_*.npz'))) == 64
    calls.clear()
    computed(calls, 0)
    computed(calls, 89)
    computed(calls, 1)
    assert calls == [1]


def test_a_damaged_file_is_written_again(calls, tmp_path, caplog):
    computed(calls, 2)
    file, = (tmp_path / 'cache' / 'arrays').iterdir()
    file.write_bytes(file.read_bytes()[:-5])
    assert computed(calls, 2)[1, 2] == 10.0
    assert 'computing it again' in caplog.text
    computed(calls, 2)
    assert calls == [2, 2]
    content = bytearray(file.read_bytes())
    content[content.index(np.float32(10.0).tobytes())] ^= 1
    file.write_bytes(content)
    assert computed(calls, 2)[1, 2] == 10.0 and calls == [2, 2, 2]


def test_a_file_that_would_run_code_is_written_again(calls, tmp_path):
    """Unpickling it would make a folder."""
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / 'trapped'),)

    computed(calls, 2)
    file, = (tmp_path / 'cache' / 'arrays').iterdir()
    np.savez(file, array=np.array([Trap()], dtype=object))
    assert computed(calls, 2)[1, 2] == 10.0
    assert calls == [2, 2] and not (tmp_path / 'trapped').exists()


def test_without_a_place_for_it_the_array_is_still_there(calls, tmp_path, caplog):
    (tmp_path / 'cache').write_text('a file, not a folder')
    assert computed(calls, 2)[1, 2] == 10.0
    assert 'is not kept' in caplog.text
