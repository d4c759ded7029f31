"""Elevation models: GeoTIFF and other rasters, and folders of dem.npy with dem.yaml."""

from __future__ import annotations

import pathlib

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import brief, WorldError
from lunar_rover_sim.base.files.arrays import map_array
from lunar_rover_sim.base.files.paths import user_path
from lunar_rover_sim.base.files.yaml_text import read_yaml
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.geo_raster import GeoRaster
from lunar_rover_sim.ground.world.moon_place import MoonPlace
from lunar_rover_sim.ground.world.raster import MAX_HEIGHT_M, MAX_PIXEL_M, Raster

_MAX_BYTES = 1 << 18     # of dem.yaml


def open_dem(config: WorldConfig) -> Raster:
    """Return the elevation model that the parameters name; raise WorldError."""
    raster = _raster(config)
    try:
        raster.check_ground()
    except BaseException:
        raster.close()
        raise
    return raster


def dem_site(config: WorldConfig,
             lon_lat_deg: tuple[float, float] | None = None) -> MoonPlace | None:
    """Return where the world's origin is on the Moon, or a place with its grid north.

    None if the elevation model does not say, as a folder with dem.npy.

    Raises:
        WorldError: If it cannot be read, or if the place is beyond it.
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
        raise WorldError(f'world.path: {path}: no such file; --set world.path=FILE: '
                         'a GeoTIFF or folder')
    if not path.is_dir() and not path.is_file():
        raise WorldError(f'world.path: {path}: is neither a regular file nor a folder')
    if path.suffix == '.npy':
        raise WorldError(f'world.path: {path}: is an array without a scale; valid is a folder '
                         'with dem.npy and dem.yaml')
    return DemFolder(path, config) if path.is_dir() else GeoRaster(path, config)


class DemFolder(Raster):
    """A folder of dem.npy (row 0 north) and dem.yaml (size, pixel_size, center_coordinates)."""

    def __init__(self, path: pathlib.Path, config: WorldConfig) -> None:
        super().__init__(path, config)
        for name in ('dem.npy', 'dem.yaml'):
            if not (path / name).exists():
                raise WorldError(f'{path}: {name} is missing; a folder needs dem.npy and dem.yaml')
        self._data = map_array(path / 'dem.npy', WorldError)
        document = read_yaml(path / 'dem.yaml', _MAX_BYTES, WorldError)
        if self._data.ndim != 2 or self._data.dtype.kind not in 'iuf':
            raise WorldError(f'{path}/dem.npy: not a two-dimensional array of heights')
        self.height, self.width = self._data.shape
        document = document if isinstance(document, dict) else {}
        size = document.get('size', [self.width, self.height])
        if size != [self.width, self.height]:
            raise WorldError(f'{path}/dem.yaml: size: {brief(size)}; dem.npy is {self.width} wide '
                             f'and {self.height} high')
        if 'pixel_size' not in document and not config.dem.pixel_m:
            raise WorldError(f'{path}/dem.yaml: pixel_size is missing; add it, as [1.0, -1.0] in '
                             'metres, or set world.dem.pixel_m')
        pixel = document.get('pixel_size', [config.dem.pixel_m, -config.dem.pixel_m])
        if (not isinstance(pixel, list) or len(pixel) != 2
                or not all(_is_length(p) for p in pixel)):
            raise WorldError(f'{path}/dem.yaml: pixel_size: {brief(pixel)} is not two lengths '
                             '[m]; correct it or set world.dem.pixel_m')
        if config.dem.pixel_m:
            pixel = [config.dem.pixel_m, np.copysign(config.dem.pixel_m, pixel[1])]
        self.pixel_x_m, self.pixel_y_m = abs(float(pixel[0])), abs(float(pixel[1]))
        self.south_up = float(pixel[1]) > 0.0
        self.report['center_lon_lat_deg'] = document.get('center_coordinates')
        if config.dem.center_mode not in ('pixel', 'offset'):
            raise WorldError(f'world.dem.center_mode: {config.dem.center_mode}; {path} has no '
                             'CRS: use offset or pixel')
        self.column0, self.row0 = self.middle_in_pixels()

    def close(self) -> None:
        """Release the file."""
        del self._data

    def read(self, rows: slice, columns: slice, factor: int) -> tuple[NDArray, NDArray]:
        """Return a window of the mapped array, averaged strip by strip."""
        count = (columns.stop - columns.start) // factor
        strips, masks = [], []
        for start in range(rows.start, rows.stop, factor):
            with np.errstate(invalid='ignore'):     # a NaN of any bits is no data
                block = np.asarray(self._data[start:start + factor, columns], float)
            known = np.isfinite(block) & (np.abs(block) < MAX_HEIGHT_M)
            total = np.where(known, block, 0.0).reshape(factor, count, factor).sum(axis=(0, 2))
            data = known.reshape(factor, count, factor).sum(axis=(0, 2))
            strips.append(total / np.maximum(data, 1))
            masks.append(data > 0)
        return np.array(strips), np.array(masks)

    def read_raw(self, rows: slice, columns: slice) -> NDArray:
        """Return a part of the mapped array."""
        return np.asarray(self._data[rows, columns])


def _is_length(value: object) -> bool:
    return (isinstance(value, (int, float)) and not isinstance(value, bool)
            and 0.0 < abs(value) <= MAX_PIXEL_M)
