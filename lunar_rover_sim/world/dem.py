"""Elevation models: GeoTIFF and other rasters, and folders of dem.npy with dem.yaml."""

from __future__ import annotations

from lunar_rover_sim.errors import WorldError
from lunar_rover_sim.files.paths import user_path
from lunar_rover_sim.world.config import WorldConfig
from lunar_rover_sim.world.dem_folder import DemFolder
from lunar_rover_sim.world.geotiff import GeoRaster
from lunar_rover_sim.world.raster import Raster
from lunar_rover_sim.world.site import Site


def open_dem(config: WorldConfig) -> Raster:
    """Return the elevation model that the parameters name; raise WorldError."""
    raster = _raster(config)
    try:
        raster.check_ground()
    except BaseException:
        raster.close()
        raise
    return raster


def dem_site(config: WorldConfig, lon_lat_deg: tuple[float, float] | None = None) -> Site | None:
    """Return where the world's origin is on the Moon, or a place with its grid north.

    None if the elevation model does not say, as a folder with dem.npy. Raises WorldError if it
    cannot be read, or if the place is beyond it.
    """
    raster = _raster(config)
    try:
        if not isinstance(raster, GeoRaster):
            return None
        return raster.site_of_origin() if lon_lat_deg is None else raster.site_at(*lon_lat_deg)
    finally:
        raster.close()


def _raster(config: WorldConfig) -> Raster:
    path = user_path(config.path, 'world.path')
    if not path.exists():
        raise WorldError(f'world.path: {path}: no such file')
    if not path.is_dir() and not path.is_file():
        raise WorldError(f'world.path: {path}: is neither a regular file nor a folder')
    if path.suffix == '.npy':
        raise WorldError(f'world.path: {path}: is an array without a scale; valid is a folder '
                         'with dem.npy and dem.yaml')
    return DemFolder(path, config) if path.is_dir() else GeoRaster(path, config)
