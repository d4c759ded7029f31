"""`world export --orbital`: what other programs read of it."""

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
import worlds

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
from lunar_rover_sim.ground.world.world_folder import save_world


@pytest.fixture(scope='module', name='moon')
def _moon(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_world(worlds.small(), tmp_path_factory.mktemp('worlds') / 'moon')


def test_other_programs_read_heights_photo_and_craters(moon: Path, tmp_path: Path) -> None:
    maps = tmp_path / 'maps'
    assert main(['world', 'export', str(moon), '--orbital', '-o', str(maps), '--sun', '20',
                 '15', '--set', 'orbital.extent_m=120', '--set', 'orbital.pixel_m=5', '--set',
                 'orbital.photo_pixel_m=0.5']) == 0
    with rasterio.open(maps / 'heights.tif') as file:
        heights, bounds, size = file.read(1), file.bounds, file.res
    assert size == (5.0, 5.0) and tuple(bounds) == (-60.0, -60.0, 60.0, 60.0)
    # The error is of a metre or so, which is drawn once.
    x, y = np.meshgrid(np.arange(-57.5, 60.0, 5.0), np.arange(57.5, -60.0, -5.0))
    off = heights - worlds.small().height_at(np.stack([x, y], axis=-1))
    assert 0.1 < off.std() < 1.5 and abs(off.mean()) < 4.0
    with rasterio.open(maps / 'photo.tif') as file:
        photo = file.read(1)
        assert file.res == (0.5, 0.5)
    assert photo.shape == (240, 240) and 20 < photo.mean() < 235
    about = json.loads((maps / 'orbital.json').read_text())
    assert about['errors']['sun_elevation_deg'] == 15.0
    craters = json.loads((maps / 'craters.geojson').read_text())['features']
    assert all(abs(v) < 70.0 for one in craters for v in one['geometry']['coordinates'])
    read = OrbitalMap.load(maps)
    assert read.height_at((-57.5, 57.5)) == heights[0, 0] and len(read.craters) == len(craters)
    for wrong in (np.full_like(heights, np.nan), np.where(heights == heights.max(), np.inf,
                                                          heights).astype(np.float32)):
        with rasterio.open(maps / 'heights.tif', 'r+') as file:
            file.write(wrong, 1)
        with pytest.raises(WorldError, match='heights are infinite, or all missing'):
            OrbitalMap.load(maps)
