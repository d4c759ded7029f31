"""Elevation models in folders: an array with a text beside it."""

import json

import numpy as np
import pytest
from world.elevation_models import config, hills, refused, write_tiff

from lunar_rover_sim.world.dem import open_dem


def write_folder(folder, heights, pixel=(5.0, -5.0), **more):
    """Write dem.npy and dem.yaml."""
    folder.mkdir()
    np.save(folder / 'dem.npy', heights)
    document = {'size': list(heights.shape[::-1]), 'pixel_size': list(pixel),
                'center_coordinates': [12.3, -89.5], **more}
    (folder / 'dem.yaml').write_text(json.dumps(document))  # JSON is YAML
    return folder


def test_folder_of_an_array_equals_the_raster(tmp_path):
    heights = hills(60, 5.0)
    folder = write_folder(tmp_path / 'site', heights)
    tiff = write_tiff(tmp_path / 'site.tif', heights, pixel=5.0)
    a, b = open_dem(config(folder)), open_dem(config(tiff))
    assert a.reference_m == pytest.approx(b.reference_m)
    for half, cell in ((6.4, 0.025), (200.0, 1.6), (1600.0, 12.8)):
        one, other = a.tile(half, cell), b.tile(half, cell)
        assert np.allclose(one.heights_m, other.heights_m, atol=1e-3)
        assert np.allclose(one.x_m, other.x_m) and np.allclose(one.y_m, other.y_m)
    assert a.report['center_lon_lat_deg'] == [12.3, -89.5]
    a.close(), b.close()


def test_rows_from_the_south(tmp_path):
    heights = hills(60, 5.0)
    north = open_dem(config(write_folder(tmp_path / 'a', heights)))
    south = open_dem(config(write_folder(tmp_path / 'b', heights[::-1], (5.0, 5.0))))
    a, b = north.tile(30.0, 0.2), south.tile(30.0, 0.2)
    assert np.allclose(a.heights_m, b.heights_m) and np.allclose(a.y_m, b.y_m)


def test_folder_refusals(tmp_path):
    heights = hills(60, 5.0)
    refused(write_folder(tmp_path / 'size', heights, size=[10, 10]), r'dem.yaml: size: \[10, 10\]')
    refused(write_folder(tmp_path / 'pixel', heights, pixel_size=[0, 'x']), 'pixel_size')
    (tmp_path / 'pixel' / 'dem.yaml').write_text('size: [60, 60]')
    refused(tmp_path / 'pixel', 'dem.yaml: pixel_size is missing')
    refused(tmp_path / 'pixel' / 'dem.npy', 'array without a scale; valid is a folder')
    refused(write_folder(tmp_path / 'number', heights, size=5), 'dem.yaml: size: 5; dem.npy is')
    refused(write_folder(tmp_path / 'huge', heights, pixel_size=[10**400, 1]), 'pixel_size')
    refused(write_folder(tmp_path / 'lonlat', heights), 'has no CRS: use offset or pixel',
            dem={'center_mode': 'lonlat'})
    refused(write_folder(tmp_path / 'cube', heights[None]), 'not a two-dimensional array')
    (tmp_path / 'pickle').mkdir()
    np.save(tmp_path / 'pickle' / 'dem.npy', np.array([{}], object), allow_pickle=True)
    (tmp_path / 'pickle' / 'dem.yaml').write_text('{}')
    refused(tmp_path / 'pickle', 'Python objects')
