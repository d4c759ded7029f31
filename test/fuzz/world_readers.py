"""Readers of elevation models, meshes and worlds; see `readers.py`."""

import functools
import math
from pathlib import Path
import random
from typing import Any

from claims import claim, within_bounds
import numpy as np
import rasterio
from rasterio.crs import CRS
import samples

from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.dem import open_dem
from lunar_rover_sim.ground.world.mesh import MeshSource
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
from lunar_rover_sim.ground.world.world_folder import content_hash, load_world


def _config(**source: Any) -> WorldConfig:
    return WorldConfig.from_mapping({**samples.WORLD, **source})


def _ground(source: Any) -> None:
    """Heights are finite and those of the Moon, at fine and at coarse cells."""
    try:
        for half_m, cell_m in ((0.5 * samples.WINDOW_M, samples.CELL_M), (5.0, 0.8)):
            tile = source.tile((-half_m, half_m, -half_m, half_m), cell_m)
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
            tile = source.tile((-half_m, half_m, -half_m, half_m), cell_m)
            claim(tile is None or np.abs(tile.heights_m).max() < 50.0,
                  'a marker of missing data is ground')
    finally:
        source.close()


PROJECTIONS = (
    None, '+proj=merc', '+proj=eqc', '+proj=eqc +lat_ts=60', '+proj=longlat', '+proj=sinu',
    '+proj=stere +lat_0=-90', '+proj=stere +lat_0=90 +units=km', '+proj=ortho +lat_0=20',
    '+proj=gnom', '+proj=tmerc +lon_0=10', '+proj=geocent', '+proj=moll', '+proj=laea +lat_0=90')


def read_placed(folder: Path, _valid: Path, file: Path, rng: random.Random) -> None:
    """A raster of any projection, place, pixel, sense and unit is read or refused, in seconds."""
    whole = (file.is_file() and file.stat().st_size > 0     # those of /proc have none
             and file.read_bytes().startswith(b'II*'))
    if file.name != 'float.tif' or not whole:       # or a pipe, a device or a folder
        read_dem(folder, _valid, file, rng)
        return
    projection, odd = rng.choice(PROJECTIONS), rng.randrange(8)     # one thing is absurd, or none
    unit = 1.0 / 30323.0 if projection == '+proj=longlat' else 1.0
    sizes = (1e-12, 1e-4, 30.0, 1e6, 1e12, 0.0, math.nan) if odd == 0 else (0.1,)
    size = unit * rng.choice(sizes)
    turn = rng.choice((0.0, 0.0, 0.3, math.pi / 2, math.pi))
    aspect = rng.choice((20.0, 1e-3, 0.0)) if odd == 1 else rng.choice((1.0, -1.0))
    sense = rng.choice((-1.0, 1.0))
    far = (0.0, 2.7e6, 5.4e6, 1e9) if odd == 2 else (rng.uniform(-1.4e6, 1.4e6),)
    x, y = unit * rng.choice(far), unit * rng.choice(far) * 0.9
    with rasterio.open(file, 'r+') as raster:
        if projection is not None:
            raster.crs = CRS.from_user_input(f'{projection} +R=1737400')
        raster.transform = rasterio.Affine(
            aspect * size * math.cos(turn), -sense * size * math.sin(turn), x,
            aspect * size * math.sin(turn), sense * size * math.cos(turn), y)
        raster.units = (rng.choice(('km', 'ft', 'degree')) if odd == 3 else 'm',)
        raster.scales = (rng.choice((0.5, 0.0, float('nan'), 1e-300)) if odd == 4 else 1.0,)
    mode = rng.choice(('crs', 'lonlat') if odd == 5 else ('offset', 'pixel'))
    center = {'offset': [0.1, -0.2], 'pixel': [24.0, 24.0], 'crs': [x, y],
              'lonlat': [rng.uniform(-180.0, 360.0), rng.uniform(-100.0, 100.0)]}[mode]
    _ground(open_dem(_config(source='dem', path=str(file), dem={
        'nodata': 'fill', 'center_mode': mode, 'center': center})))


def read_mesh(_folder: Path, _valid: Path, file: Path, _rng: random.Random) -> None:
    """A mesh of any format."""
    _ground(MeshSource(_config(source='mesh', path=str(file), mesh={'holes': 'fill'})))


def read_world(folder: Path, valid: Path, _file: Path, _rng: random.Random) -> None:
    """What is accepted has the content of the valid world."""
    world = load_world(folder / 'world')
    claim(world.hash == content_hash(world), 'the hash is not that of the content')
    claim(world.hash == _hash_of(valid / 'world'), 'the content is another one')


def read_orbital(folder: Path, _valid: Path, _file: Path, _rng: random.Random) -> None:
    """Heights are those of the Moon or missing, craters have a place and a size."""
    maps = OrbitalMap.load(folder / 'maps')
    claim(np.nanmax(np.abs(maps.heights_m)) < 1e5, 'heights beyond any on the Moon')
    claim(maps.craters.position_m.shape == (len(maps.craters), 2), 'a place is no x, y')
    claim(np.isfinite(maps.craters.position_m).all(), 'a crater is nowhere')
    claim((maps.craters.diameter_m > 0.0).all(), 'a crater has no size')
    within_bounds(maps.config)


@functools.lru_cache(maxsize=1)
def _hash_of(folder: Path) -> str:
    return load_world(folder).hash
