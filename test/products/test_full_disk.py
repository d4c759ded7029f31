"""What writes files on a disk that is full says so, and leaves nothing that passes for whole.

The system lets no file grow beyond a limit; a library that drops what it cannot write is seen.
"""

from collections.abc import Callable, Iterator
import contextlib
from pathlib import Path
import resource

import numpy as np
import pytest
import synthetic_bag
import worlds

from lunar_rover_sim.base.errors import LunarRoverSimError
from lunar_rover_sim.base.files.film_file import write_film
from lunar_rover_sim.ground.world.orbital_map import MappedCraters, OrbitalConfig, OrbitalMap
from lunar_rover_sim.ground.world.world_folder import save_world
from lunar_rover_sim.products.sequences.export import export, FORMATS
from lunar_rover_sim.rover.description import RoverDescription

_FULL = 'cannot be written: .*(File too large|is the disk full)'


@contextlib.contextmanager
def most_bytes(limit: int) -> Iterator[None]:
    """Let no file of this process grow beyond a size."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def noise_film(path: Path) -> None:
    """Write a film that cannot be compressed."""
    rng = np.random.default_rng(1)
    write_film(path, (rng.integers(0, 255, (64, 64, 3), np.uint8) for _ in range(4)), 10.0)


def maps(path: Path) -> None:
    """Write maps from orbit of some pixels."""
    craters = MappedCraters(np.zeros((0, 2)), np.zeros(0))
    heights = np.random.default_rng(1).normal(size=(40, 40)).astype(np.float32)
    OrbitalMap(heights, (-39.0, -39.0), craters, np.zeros((0, 0), np.uint8), (0.0, 0.0),
               OrbitalConfig(photo_pixel_m=0.0), {}, 'ground', '', (0.0, 0.0)).save(path)


def stage(path: Path) -> None:
    """Write a rover."""
    pytest.importorskip('pxr')
    from lunar_rover_sim.products.usd.rover_stage import write_rover
    write_rover(RoverDescription(), path)


@pytest.mark.parametrize('name', ['film.mp4', 'film.gif', 'film.webp', 'rover.usda', 'rover.usdz',
                                  'world', 'maps'])
def test_the_last_bytes_have_no_room(tmp_path: Path, name: str) -> None:
    """At all but the last ten bytes of the largest file, and at a third of it."""
    write: Callable[[Path], object] = {
        'film': noise_film, 'rover': stage, 'maps': maps,
        'world': lambda path: save_world(worlds.small(), path)}[name.partition('.')[0]]
    whole = tmp_path / 'whole'
    whole.mkdir()
    write(whole / name)
    largest = max(file.stat().st_size for file in whole.rglob('*'))
    for limit in (largest - 10, largest // 3):
        with most_bytes(limit), pytest.raises(LunarRoverSimError, match=_FULL) as error:
            write(tmp_path / name)
        assert str(error.value).startswith(str(tmp_path / name))
        assert len(str(error.value)) - len(str(tmp_path / name)) < 80
        assert [path.name for path in tmp_path.iterdir()] == ['whole']


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a drive of a fifth of a second."""
    return synthetic_bag.write(tmp_path_factory.mktemp('drive') / 'bag', synthetic_bag.drive(0.2))


@pytest.mark.parametrize('kind', ['euroc', 'tum', 'kitti', 'tartanair', 'webdataset'])
def test_no_sequence_is_left(bag: Path, tmp_path: Path, kind: str) -> None:
    assert kind in FORMATS
    with most_bytes(3000), pytest.raises(LunarRoverSimError, match=_FULL):
        export(bag, tmp_path / kind, kind)
    assert not list(tmp_path.iterdir())
