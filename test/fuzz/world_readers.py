"""Readers of elevation models, meshes and worlds; see `readers.py`."""

import functools
from pathlib import Path
import random
from typing import Any

from claims import claim
import numpy as np
import samples

from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.dem import open_dem
from lunar_rover_sim.ground.world.mesh import MeshSource
from lunar_rover_sim.ground.world.world_folder import content_hash, load_world


def _config(**source: Any) -> WorldConfig:
    return WorldConfig.from_mapping({**samples.WORLD, **source})


def _ground(source: Any) -> None:
    """Heights are finite and those of the Moon, at fine and at coarse cells."""
    try:
        for half_m, cell_m in ((0.5 * samples.WINDOW_M, samples.CELL_M), (5.0, 0.8)):
            tile = source.tile(half_m, cell_m)
            if tile is not None:
                claim(np.isfinite(tile.heights_m).all(), 'heights are not finite')
                claim(np.abs(tile.heights_m).max() <= 2e5, 'heights beyond any on the Moon')
                claim((np.diff(tile.x_m) > 0.0).all() and (np.diff(tile.y_m) > 0.0).all(),
                      'pixels do not follow each other')
    finally:
        source.close()


def read_dem(folder: Path, _valid: Path, file: Path, _rng: random.Random) -> None:
    """A GeoTIFF, or a folder of dem.npy and dem.yaml."""
    path = folder if file.name.startswith('dem.') else file
    _ground(open_dem(_config(source='dem', path=str(path), dem={'nodata': 'fill'})))


MARKERS = (-9999.0, -32768.0, 32767.0, 65535.0, 99999.0, 9999.0, -1e4, 3.4e38, -3.4028227e38, 1e20)


def read_marked(folder: Path, _valid: Path, _file: Path, rng: random.Random) -> None:
    """No marker of missing data becomes ground, wherever it stands; else it is refused."""
    if not (folder / 'dem.npy').is_file():      # a pipe, a device or a folder in its place
        open_dem(_config(source='dem', path=str(folder))).close()
        return
    heights = np.load(folder / 'dem.npy', allow_pickle=False)
    claim(heights.shape == (160, 160), 'the sample is another one')
    row, column = rng.randrange(160), rng.randrange(160)
    high, wide = (rng.choice((1, 2, 7, 40, 160)) for _ in 'xy')
    heights[row:row + high, column:column + wide] = rng.choice(MARKERS)
    np.save(folder / 'dem.npy', heights)
    source = open_dem(_config(source='dem', path=str(folder), dem={'nodata': 'fill'}))
    try:
        for half_m, cell_m in ((0.5 * samples.WINDOW_M, samples.CELL_M), (8.0, 0.2), (8.0, 0.8)):
            tile = source.tile(half_m, cell_m)
            claim(tile is None or np.abs(tile.heights_m).max() < 50.0,
                  'a marker of missing data is ground')
    finally:
        source.close()


def read_mesh(_folder: Path, _valid: Path, file: Path, _rng: random.Random) -> None:
    """A mesh of any format."""
    _ground(MeshSource(_config(source='mesh', path=str(file), mesh={'holes': 'fill'})))


def read_world(folder: Path, valid: Path, _file: Path, _rng: random.Random) -> None:
    """What is accepted has the content of the valid world."""
    world = load_world(folder / 'world')
    claim(world.hash == content_hash(world), 'the hash is not that of the content')
    claim(world.hash == _hash_of(valid / 'world'), 'the content is another one')


@functools.lru_cache(maxsize=1)
def _hash_of(folder: Path) -> str:
    return load_world(folder).hash
