"""Elevation models: GeoTIFF and other rasters, and folders of dem.npy with dem.yaml."""

from __future__ import annotations

from lunar_rover_sim.errors import WorldError
from lunar_rover_sim.files.folders import user_path
from lunar_rover_sim.world.config import WorldConfig
from lunar_rover_sim.world.dem_folder import DemFolder
from lunar_rover_sim.world.geotiff import GeoRaster
from lunar_rover_sim.world.raster import Raster


def open_dem(config: WorldConfig) -> Raster:
    """Return the elevation model that the parameters name; raise WorldError."""
    path = user_path(config.path, 'path')
    if not path.exists():
        raise WorldError(f'path: {path}: no such file')
    if not path.is_dir() and not path.is_file():
        raise WorldError(f'path: {path}: is neither a regular file nor a folder')
    raster = DemFolder(path, config) if path.is_dir() else GeoRaster(path, config)
    try:
        raster.check_ground()
    except BaseException:
        raster.close()
        raise
    return raster
