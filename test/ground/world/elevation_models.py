"""Elevation models and meshes that tests write, and worlds of them."""

import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
from rasterio.transform import from_origin
import trimesh
import worlds

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.parameters import merge
from lunar_rover_sim.ground.world import export
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.dem import open_dem
from lunar_rover_sim.ground.world.grid import HeightGrid

MOON = '+proj=stere +lat_0=-90 +lon_0=0 +k=1 +x_0=0 +y_0=0 +R=1737400 +units=m +no_defs'


def write_tiff(path, heights, pixel=2.0, crs=MOON, west=1000.0, north=-3000.0, nodata=None):
    """Write heights, row 0 north."""
    with rasterio.open(path, 'w', driver='GTiff', width=heights.shape[1], height=heights.shape[0],
                       count=1, dtype=heights.dtype, crs=CRS.from_user_input(crs) if crs else None,
                       transform=from_origin(west, north, pixel, pixel) if pixel else None,
                       nodata=nodata) as file:
        file.write(heights, 1)
    return path


def hills(n=48, pixel=2.0, seed=0):
    """Return smooth random heights, row 0 north, far from zero."""
    axis = np.arange(n) * pixel
    rng = np.random.default_rng(seed)
    heights = np.full((n, n), -1834.0)
    for _ in range(12):
        k = rng.uniform(-1.0, 1.0, 2) / rng.uniform(3.0, 12.0)
        wave = np.sin(k[0] * axis + (k[1] * axis)[:, None] + rng.uniform(0, 6.28))
        heights += 0.15 / np.linalg.norm(k) * wave / 3.0
    return heights.astype(np.float32)


def config(path, **parameters):
    """Return the parameters of a small world from an elevation model."""
    return WorldConfig.from_mapping(
        merge(merge(worlds.SMALL, {'source': 'dem', 'path': str(path)}), parameters))


def refused(path, message, **parameters):
    """Check that an elevation model is refused in one line that says why."""
    with pytest.raises(WorldError, match=message) as error:
        open_dem(config(path, **parameters))
    assert '\n' not in str(error.value)


def bumps(n=41, cell=0.5):
    """Return a mesh of a bumpy square and the same surface as a grid."""
    axis = (np.arange(n) - 0.5 * (n - 1)) * cell
    heights = (0.4 * np.sin(0.7 * axis) * np.cos(0.5 * axis[:, None])
               + 0.05 * axis).astype(np.float32)
    grid = HeightGrid(heights, cell)
    vertices, faces = export.surface(grid)
    return trimesh.Trimesh(vertices, faces, process=False), grid
