"""Elevation models: GeoTIFF and other rasters, and folders of dem.npy with dem.yaml."""

from __future__ import annotations

import contextlib
import logging
import pathlib
import warnings

import numpy as np
from numpy.typing import NDArray
import rasterio
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from lunar_rover_sim.base.arguments import brief
from lunar_rover_sim.base.errors import one_line, WorldError
from lunar_rover_sim.base.files.arrays import map_array
from lunar_rover_sim.base.files.library_output import stderr_to_log
from lunar_rover_sim.base.files.paths import user_path
from lunar_rover_sim.base.files.yaml_text import read_yaml
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.map_projection import lon_lat_crs, site_of, transformed
from lunar_rover_sim.ground.world.raster import MAX_HEIGHT_M, Raster
from lunar_rover_sim.ground.world.site import Site

logger = logging.getLogger(__name__)

_MAX_BYTES = 1 << 18     # of dem.yaml
_MAX_PIXEL_M = 1e6
_COLOURS = (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha,
            ColorInterp.palette)


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
        raise WorldError(f'world.path: {path}: no such file')
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


def _is_length(value: object) -> bool:
    return (isinstance(value, (int, float)) and not isinstance(value, bool)
            and 0.0 < abs(value) <= _MAX_PIXEL_M)


class GeoRaster(Raster):
    """A raster that rasterio reads."""

    def __init__(self, path: pathlib.Path, config: WorldConfig) -> None:
        super().__init__(path, config)
        # Within an Env, what GDAL says is logged by rasterio; else GDAL prints it.
        self._open_files = contextlib.ExitStack()
        self._open_files.enter_context(rasterio.Env())
        try:
            with warnings.catch_warnings(), stderr_to_log(logger):
                warnings.simplefilter('ignore', NotGeoreferencedWarning)
                self._data = self._open_files.enter_context(rasterio.open(path))
            self._interpret()
        except (RasterioError, ValueError) as error:     # CRSError, UnicodeDecodeError
            self.close()
            raise WorldError(f'{path}: not a raster that can be read: '
                             f'{one_line(error)}') from None
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Release the file."""
        self._open_files.close()

    def _interpret(self) -> None:
        data, dem = self._data, self.config.dem
        if dem.band > data.count:
            raise WorldError(f'world.dem.band: {dem.band}; {self.path} has {data.count}')
        if np.dtype(data.dtypes[dem.band - 1]).kind not in 'iuf':
            raise WorldError(f'{self.path}: {data.dtypes[dem.band - 1]} is not a type for heights')
        colour = data.colorinterp[dem.band - 1]
        if colour in _COLOURS or (data.dtypes[dem.band - 1] in ('uint8', 'int8')
                                  and dem.height_scale == 1.0):
            raise WorldError(f'{self.path}: band {dem.band} ({data.dtypes[dem.band - 1]}, '
                             f'{colour.name}) is a picture, not heights; name another '
                             'world.dem.band, or for heights in 8 bits set '
                             'world.dem.height_scale')
        self.width, self.height = data.width, data.height
        grid = data.transform
        unit = 1.0
        if grid.is_identity:
            if not dem.pixel_m:
                raise WorldError(f'{self.path}: it does not say how large its pixels are; set '
                                 'world.dem.pixel_m')
            size_x = size_y = dem.pixel_m
        else:
            if grid.b or grid.d or grid.a <= 0.0:
                raise WorldError(f'{self.path}: its rows do not run west to east; rewrite it with '
                                 '`gdalwarp`')
            if data.crs is not None and data.crs.is_geographic:
                raise WorldError(
                    f'{self.path}: its coordinates are degrees, not metres; reproject it, for '
                    "example with `gdalwarp -t_srs '+proj=stere +lat_0=-90 +R=1737400 +units=m'`")
            if data.crs is None:
                logger.warning('%s: no CRS; its unit of length is taken as the metre', self.path)
            else:
                unit = float(data.crs.linear_units_factor[1])
            size_x, size_y = grid.a * unit, abs(grid.e) * unit
            self.south_up = grid.e > 0.0
            if dem.pixel_m:
                size_x = size_y = dem.pixel_m
        self.pixel_x_m, self.pixel_y_m = size_x, size_y
        self.report['crs'] = data.crs.to_string() if data.crs is not None else ''
        self.column0, self.row0 = self._middle()
        site = self.site_of_origin()
        if site is not None:
            self.report.update(site.to_report())

    def _middle(self) -> tuple[float, float]:
        """Return the column and row, in pixels from the corner, of the world's origin."""
        data, dem = self._data, self.config.dem
        a, b = dem.center
        if dem.center_mode in ('pixel', 'offset'):
            return self.middle_in_pixels()
        if data.transform.is_identity or (data.crs is None and dem.center_mode == 'lonlat'):
            raise WorldError(f'world.dem.center_mode: {dem.center_mode}; {self.path} has no CRS: '
                             'use offset or pixel')
        if dem.center_mode == 'lonlat':
            projected = transformed(lon_lat_crs(data.crs), data.crs, a, b)
            if projected is None:
                raise WorldError(f'world.dem.center: {a:g}, {b:g} cannot be projected to the CRS '
                                 f'of {self.path}')
            a, b = projected
        grid = data.transform
        return float((a - grid.c) / grid.a), float((b - grid.f) / grid.e)

    def site_of_origin(self) -> Site | None:
        """Return where the world's origin is on the Moon.

        None if the file does not say, or its CRS is of another body.
        """
        data = self._data
        if data.crs is None or data.transform.is_identity:
            return None
        grid = data.transform
        return site_of(data.crs, grid.c + self.column0 * grid.a, grid.f + self.row0 * grid.e)

    def site_at(self, lon_deg: float, lat_deg: float) -> Site | None:
        """Return a place with the direction of the grid there; None as `site_of_origin`.

        Raises:
            WorldError: If it is beyond the file.
        """
        if self.site_of_origin() is None:
            return None
        crs, bounds = self._data.crs, self._data.bounds
        projected = transformed(lon_lat_crs(crs), crs, lon_deg, lat_deg)
        if projected is None or not (bounds.left <= projected[0] <= bounds.right
                                     and min(bounds.bottom, bounds.top) <= projected[1]
                                     <= max(bounds.bottom, bounds.top)):
            where = '' if projected is None else f' (x {projected[0]:.6g}, y {projected[1]:.6g})'
            raise WorldError(
                f'longitude {lon_deg:g}, latitude {lat_deg:g}{where} is not on {self.path}; valid '
                f'is x {bounds.left:.6g} to {bounds.right:.6g}, y {bounds.bottom:.6g} to '
                f'{bounds.top:.6g}')
        return site_of(crs, *projected)

    def read(self, rows: slice, columns: slice, factor: int) -> tuple[NDArray, NDArray]:
        """Return a window; overviews are used if the file has them."""
        band = self.config.dem.band
        window = Window(columns.start, rows.start, columns.stop - columns.start,
                        rows.stop - rows.start)
        shape = ((rows.stop - rows.start) // factor, (columns.stop - columns.start) // factor)
        try:
            with stderr_to_log(logger):
                values = self._data.read(band, window=window, out_shape=shape, masked=True,
                                         resampling=Resampling.average)
        except RasterioError as error:
            reason = one_line(error.__cause__ or error)
            raise WorldError(f'{self.path}: cannot be read, it may be cut short: '
                             f'{reason}') from None
        known = ~np.ma.getmaskarray(values)
        with np.errstate(invalid='ignore'):     # signalling NaN, which is refused as NaN is
            heights = np.ma.getdata(values).astype(float)
        scale, offset = self._data.scales[band - 1], self._data.offsets[band - 1]
        return heights * scale + offset, known
