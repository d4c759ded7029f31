"""Maps from orbit: means over pixels, errors of the stated size, features where they are."""

import json

import numpy as np
import pytest
import rasterio
import worlds

from lunar_rover_sim.errors import WorldError
from lunar_rover_sim.world.orbital import OrbitalErrors, PHOTO, write_features, write_map
from lunar_rover_sim.world.shade import with_rocks


@pytest.fixture(scope='module')
def world():
    return worlds.small(3)


def test_heights_are_means_over_the_pixel_at_its_place(world, tmp_path):
    write_map(world, tmp_path / 'h.tif', 0.2)
    with rasterio.open(tmp_path / 'h.tif') as file:
        heights = file.read(1)
        assert heights.shape == (64, 64) and file.crs is None
        assert tuple(file.bounds) == pytest.approx((-6.4, -6.4, 6.4, 6.4))
        row, column = file.index(1.1, -2.3)
    fine = with_rocks(world)
    rows = slice(round((-2.4 + 6.4) / 0.025), round((-2.2 + 6.4) / 0.025))
    columns = slice(round((1.0 + 6.4) / 0.025), round((1.2 + 6.4) / 0.025))
    assert heights[row, column] == pytest.approx(fine[rows, columns].mean(), abs=1e-4)


def test_errors_have_the_stated_size_and_depend_on_the_seed(world, tmp_path):
    found = {}
    for name, errors in (('none', OrbitalErrors()), ('a', OrbitalErrors(0.1, 0.5, seed=1)),
                         ('b', OrbitalErrors(0.1, 0.5, seed=1)),
                         ('c', OrbitalErrors(0.1, 0.5, seed=2))):
        write_map(world, tmp_path / f'{name}.tif', 0.1, errors=errors)
        with rasterio.open(tmp_path / f'{name}.tif') as file:
            found[name] = file.read(1), file.bounds.left
    off = found['a'][0] - found['none'][0]
    assert off.std() == pytest.approx(0.1, rel=0.05)
    assert np.corrcoef(off[:, 1:].ravel(), off[:, :-1].ravel())[0, 1] > 0.8    # smooth
    np.testing.assert_array_equal(found['a'][0], found['b'][0])
    assert not np.array_equal(found['a'][0], found['c'][0])
    assert 0.0 < abs(found['a'][1] + 6.4) < 2.0 and found['a'][1] == found['b'][1]


def test_a_photo_has_shadows_that_turn_with_the_sun(world, tmp_path):
    pictures = []
    for azimuth in (0.0, 180.0):
        write_map(world, tmp_path / 'p.tif', 0.1, PHOTO, sun_deg=(azimuth, 8.0))
        with rasterio.open(tmp_path / 'p.tif') as file:
            pictures.append(file.read(1).astype(float))
    assert all(20.0 < p.mean() < 240.0 and p.std() > 5.0 for p in pictures)
    assert np.corrcoef(pictures[0].ravel(), pictures[1].ravel())[0, 1] < 0.5


def test_rocks_and_craters_are_where_they_are(world, tmp_path):
    count = write_features(world, tmp_path / 'f.geojson', least_rock_m=0.05)
    document = json.loads((tmp_path / 'f.geojson').read_text())
    rocks = [f for f in document['features'] if f['properties']['kind'] == 'rock']
    assert len(document['features']) == count
    assert len(rocks) == np.count_nonzero(world.rocks.diameter_m >= 0.05) > 0
    largest = max(rocks, key=lambda f: f['properties']['diameter_m'])
    k = int(np.argmax(world.rocks.diameter_m))
    assert largest['geometry']['coordinates'] == pytest.approx(
        world.rocks.position_m[k, :2].tolist(), abs=1e-3)
    # The formula of a rise: at most six tenths or so of the diameter.
    assert all(-0.1 < f['properties']['top_m'] < f['properties']['diameter_m'] for f in rocks)


@pytest.mark.parametrize('resolution_m', [0.001, 10.0])
def test_resolutions_beyond_the_world_are_refused(world, tmp_path, resolution_m):
    with pytest.raises(WorldError, match='--resolution: .*valid is'):
        write_map(world, tmp_path / 'x.tif', resolution_m)
    assert not list(tmp_path.iterdir())
