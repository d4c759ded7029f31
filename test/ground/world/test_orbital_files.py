"""Folders of maps from orbit that other programs have written, or that are damaged."""

import dataclasses
import json
import os

import numpy as np
import pytest
import rasterio

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.ground.world.orbital_map import MappedCraters, OrbitalConfig, OrbitalMap


@pytest.fixture(name='maps')
def _maps(tmp_path):
    write(tmp_path / 'maps')
    return tmp_path / 'maps'


def write(folder, ground='a'):
    heights = np.arange(400, dtype=np.float32).reshape(20, 20)
    craters = MappedCraters(np.array([[3.0, -4.0], [9.0, 8.0], [2.0, 2.0], [7.0, 1.0]]),
                            np.array([6.0, 11.0, 5.0, 4.5]))
    OrbitalMap(heights, (-19.0, -19.0), craters, np.full((40, 40), 200, np.uint8),
               (-19.5, -19.5), OrbitalConfig(), name=ground).save(folder)


def rewritten(path, nodata, pixels, **profile):
    """Write a raster as another program does that marks missing data by a value."""
    with rasterio.open(path) as file:
        values, made = file.read(1), {**file.profile, **profile, 'nodata': nodata}
    values[pixels] = nodata
    with rasterio.open(path, 'w', **made) as file:
        file.write(values, 1)


def edited(path, edit):
    document = json.loads(path.read_text())
    edit(document)
    path.write_text(json.dumps(document))


def test_missing_data_is_missing_whatever_marks_it(maps):
    rewritten(maps / 'heights.tif', -9999.0, (slice(0, 3), slice(5, 9)))
    rewritten(maps / 'photo.tif', 255, (slice(0, 2), slice(0, 4)))
    read = OrbitalMap.load(maps)
    assert np.isnan(read.heights_m).sum() == 12 and np.nanmin(read.heights_m) == 0.0
    assert np.isnan(read.height_at((-9.0, 19.0)))       # the first row of a file is in the north
    assert (read.photo == 0).sum() == 8 and (read.photo == 200).sum() == 1592


def test_an_older_photo_does_not_stay_beside_maps_without_one(maps):
    read = OrbitalMap.load(maps)
    dataclasses.replace(read, photo=read.photo[:0, :0], config=dataclasses.replace(
        read.config, photo_pixel_m=0.0)).save(maps)
    assert sorted(path.name for path in maps.iterdir()) == [
        'craters.geojson', 'heights.tif', 'orbital.json']
    assert OrbitalMap.load(maps).photo.size == 0


def test_places_of_craters_may_have_a_height(maps):
    before = OrbitalMap.load(maps).craters
    edited(maps / 'craters.geojson', lambda document: [
        feature['geometry']['coordinates'].append(5.0) for feature in document['features']])
    read = OrbitalMap.load(maps).craters
    np.testing.assert_array_equal(read.position_m, before.position_m)
    np.testing.assert_array_equal(read.diameter_m, before.diameter_m)


@pytest.mark.parametrize('file', ['heights.tif', 'photo.tif', 'craters.geojson'])
def test_a_file_of_another_export_is_refused(maps, tmp_path, file):
    write(tmp_path / 'others', 'b')
    (tmp_path / 'others' / file).replace(maps / file)
    with pytest.raises(WorldError, match=f"{file}: is of the ground 'b', and .* 'a'"):
        OrbitalMap.load(maps)


def test_heights_beyond_any_on_the_moon_are_refused(maps):
    rewritten(maps / 'heights.tif', -1e32, (0, 0))
    with rasterio.open(maps / 'heights.tif', 'r+') as file:
        file.nodata = None
    with pytest.raises(WorldError, match='heights.tif: its heights are infinite.* below 100000 m'):
        OrbitalMap.load(maps)


def deep(path):
    path.write_text('[' * 100_000)


def huge(path):
    edited(path, lambda document: document.update(origin_m=[10 ** 400, 0])
           if 'origin_m' in document
           else document['features'][0]['properties'].update(diameter_m=10 ** 400))


def pipe(path):
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize('file, damage', [
    *((name, damage) for name in ('orbital.json', 'craters.geojson')
      for damage in (deep, huge, pipe)), ('heights.tif', pipe), ('photo.tif', pipe)])
def test_a_damaged_file_is_named(maps, file, damage):
    damage(maps / file)
    with pytest.raises(WorldError, match=f'{file}: '):
        OrbitalMap.load(maps)
