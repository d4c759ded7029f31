"""Elevation models: GeoTIFF and other rasters, and folders of dem.npy with dem.yaml."""

from __future__ import annotations

import contextlib
import logging
import math
import pathlib
import re
from typing import Any
import warnings

import numpy as np
from numpy.typing import NDArray
import rasterio
from rasterio.crs import CRS
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.transform import Affine
from rasterio.vrt import WarpedVRT
from rasterio.warp import transform
from rasterio.windows import Window

from lunar_rover_sim.base.errors import brief, one_line, WorldError
from lunar_rover_sim.base.files.arrays import map_array
from lunar_rover_sim.base.files.library_output import stderr_to_log
from lunar_rover_sim.base.files.paths import user_path
from lunar_rover_sim.base.files.yaml_text import read_yaml
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world import levels
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.map_projection import (body_radius_m, local_crs, local_scale,
                                                         lon_lat_crs, metres_per_unit, MOON_M,
                                                         site_of, transformed)
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


logger = logging.getLogger(__name__)

_COLOURS = (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha,
            ColorInterp.palette)
# Units of heights as GDAL, GeoTIFF and PDS write them, in lower case [m].
_UNITS_M = {'': 1.0, 'm': 1.0, 'metre': 1.0, 'meter': 1.0, 'metres': 1.0, 'meters': 1.0,
            'km': 1e3, 'kilometre': 1e3, 'kilometer': 1e3, 'kilometres': 1e3, 'kilometers': 1e3,
            'cm': 1e-2, 'centimetre': 1e-2, 'centimeter': 1e-2, 'dm': 1e-1,
            'mm': 1e-3, 'millimetre': 1e-3, 'millimeter': 1e-3,
            'ft': 0.3048, 'foot': 0.3048, 'feet': 0.3048, 'international foot': 0.3048,
            'us-ft': 1200 / 3937, 'us survey foot': 1200 / 3937, 'foot_us': 1200 / 3937,
            'us_survey_foot': 1200 / 3937, 'survey foot': 1200 / 3937}
_SAME_SCALE = 0.005     # a projection that is truer than this is taken as it is
_CYLINDRICAL = ('eqc', 'merc', 'cea', 'mill')
_LEAST_ASPECT = 1 / 16  # of the sides of a resampled pixel
_UNIT = re.compile(r'UNIT\["[^"]*",\s*([0-9.eE+-]+)')
_MOST_SIDE = 1 << 30     # pixels, for GDAL
_EDGE_POINTS = 65       # along each edge of a file


def _at(grid: Affine, column: Any, row: Any) -> tuple[Any, Any]:
    """Return the coordinates of a place in pixels."""
    return (grid.a * column + grid.b * row + grid.c, grid.d * column + grid.e * row + grid.f)


class GeoRaster(Raster):
    """A raster that rasterio reads, resampled to metres where its projection is not true."""

    def __init__(self, path: pathlib.Path, config: WorldConfig) -> None:
        super().__init__(path, config)
        # Within an Env, what GDAL says is logged by rasterio; else GDAL prints it.
        self._open_files = contextlib.ExitStack()
        self._open_files.enter_context(rasterio.Env())
        try:
            with warnings.catch_warnings(), stderr_to_log(logger):
                warnings.simplefilter('ignore', NotGeoreferencedWarning)
                self._data = self._nearest = self._open_files.enter_context(rasterio.open(path))
            self._scale, self._offset, self._unit_m = self._interpret_band()
            with stderr_to_log(logger):
                self._interpret_grid()
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

    def _interpret_band(self) -> tuple[float, float, float]:
        """Return scale and offset of the band, and its unit [m]."""
        data, dem = self._data, self.config.dem
        if dem.band > data.count:
            raise WorldError(f'world.dem.band: {dem.band}; {self.path} has {data.count}')
        kind, colour = data.dtypes[dem.band - 1], data.colorinterp[dem.band - 1]
        if kind.startswith('complex') or np.dtype(kind).kind not in 'iuf':
            raise WorldError(f'{self.path}: {kind} is not a type for heights')
        if colour in _COLOURS or (kind in ('uint8', 'int8') and dem.height_scale == 1.0):
            raise WorldError(f'{self.path}: band {dem.band} ({kind}, {colour.name}) is a picture, '
                             'not heights; name another world.dem.band, or for heights in 8 bits '
                             'set world.dem.height_scale')
        scale, offset = data.scales[dem.band - 1], data.offsets[dem.band - 1]
        if not (math.isfinite(scale) and scale != 0.0 and math.isfinite(offset)):
            raise WorldError(f'{self.path}: band {dem.band} has the scale {scale:g} and the '
                             f'offset {offset:g}; valid are numbers, and a scale other than 0: '
                             'mend them with `gdal_edit.py -scale 1 -offset 0`')
        text = data.units[dem.band - 1] or ''
        unit = _UNITS_M.get(text.strip().lower())
        if dem.height_scale != 1.0:
            if unit != 1.0:
                logger.warning('%s: world.dem.height_scale, %g m, is taken in place of the unit '
                               '%s of band %d', self.path, dem.height_scale, brief(text), dem.band)
            unit = dem.height_scale
        elif unit is None:
            raise WorldError(f'{self.path}: the heights of band {dem.band} are in {brief(text)}; '
                             'valid are m, km, cm, mm, ft and US survey foot: mend it with '
                             '`gdal_translate`, or set world.dem.height_scale to its metres')
        return scale, offset, unit

    def _interpret_grid(self) -> None:
        """Set the size of pixels and the place of the world's origin; resample if necessary."""
        data, dem = self._data, self.config.dem
        self.width, self.height = data.width, data.height
        grid, crs = data.transform, data.crs
        if grid.is_identity:
            if not dem.pixel_m:
                raise WorldError(f'{self.path}: it does not say how large its pixels are; set '
                                 'world.dem.pixel_m')
            self.pixel_x_m = self.pixel_y_m = dem.pixel_m
            self.report['crs'] = crs.to_string() if crs is not None else ''
            if dem.center_mode in ('crs', 'lonlat'):
                self._refuse_center_mode()
            self.column0, self.row0 = self.middle_in_pixels()
            return
        if not all(map(math.isfinite, grid)) or grid.determinant == 0.0:
            raise WorldError(f'{self.path}: its geotransform is {brief(grid.to_gdal())}, whose '
                             'pixels have no area; mend it with `gdal_edit.py -tr`')
        radius = body_radius_m(crs) if crs is not None else None
        if radius is None:      # none, or that of a plane
            self._refuse_turned(grid)
            stated = _UNIT.search(crs.to_wkt()) if crs is not None else None
            if stated is None:
                logger.warning('%s: no CRS; its unit of length is taken as the metre', self.path)
            self._take_grid(grid, float(stated.group(1)) if stated else 1.0)
            return
        if not MOON_M[0] <= radius <= MOON_M[1]:
            raise WorldError(f'{self.path}: its CRS is of a body of {radius / 1e3:.6g} km; valid '
                             f'is the Moon, {MOON_M[0] / 1e3:g} to {MOON_M[1] / 1e3:g} km; to '
                             'take its shape only, remove the CRS: `gdal_edit.py -a_srs None`')
        if not (crs.is_projected or crs.is_geographic):
            raise WorldError(f'{self.path}: its CRS is not that of a map; reproject it with '
                             '`gdalwarp`')
        if dem.pixel_m and crs.is_geographic:
            raise WorldError(f'world.dem.pixel_m: {dem.pixel_m:g}; {self.path} says itself how '
                             'large its pixels are; leave it at 0')
        unit = 1.0 if crs.is_geographic else float(crs.linear_units_factor[1])
        x, y = self._origin()
        scale = local_scale(crs, x, y)
        if scale is None:
            raise WorldError(f'{self.path}: {x:.9g}, {y:.9g} in its CRS is not a place on the '
                             'Moon; move world.dem.center')
        stretch = np.linalg.svd(scale / unit, compute_uv=False)
        true = not crs.is_geographic and np.abs(stretch - 1.0).max() <= _SAME_SCALE
        if dem.pixel_m or (true and not (grid.b or grid.d or grid.a < 0.0)):
            self._refuse_turned(grid)
            self._take_grid(grid, unit)
            return
        sides = np.hypot(*(scale @ [[grid.a, grid.b], [grid.d, grid.e]]).T)
        if not crs.is_geographic and stretch.all():
            logger.info('%s: its projection stretches lengths by %.4g and %.4g at the origin; it '
                        'is resampled to metres', self.path, *1.0 / stretch)
        self._resample(x, y, np.maximum(sides, _LEAST_ASPECT * sides.max()))

    def _refuse_turned(self, grid: Affine) -> None:
        if grid.b or grid.d or grid.a <= 0.0:
            raise WorldError(f'{self.path}: its rows do not run west to east, and without a CRS, '
                             'or with world.dem.pixel_m, it is not resampled; rewrite it with '
                             '`gdalwarp`')

    def _refuse_center_mode(self) -> None:
        raise WorldError(f'world.dem.center_mode: {self.config.dem.center_mode}; {self.path} has '
                         'no CRS: use offset or pixel')

    def _take_grid(self, grid: Affine, unit_m: float) -> None:
        """Take pixels as they are: rows run west to east."""
        dem, crs = self.config.dem, self._data.crs
        self.pixel_x_m, self.pixel_y_m = grid.a * unit_m, abs(grid.e) * unit_m
        self.south_up = grid.e > 0.0
        if dem.pixel_m:
            self.pixel_x_m = self.pixel_y_m = dem.pixel_m
        self._check_pixels()
        self.report['crs'] = crs.to_string() if crs is not None else ''
        if dem.center_mode in ('pixel', 'offset'):
            self.column0, self.row0 = self.middle_in_pixels()
        else:
            x, y = self._given_origin()
            self.column0, self.row0 = float((x - grid.c) / grid.a), float((y - grid.f) / grid.e)
        site = self.site_of_origin()
        if site is not None:
            self.report.update(site.to_report())

    def _check_pixels(self) -> None:
        for size in (self.pixel_x_m, self.pixel_y_m):
            if not 0.0 < size <= MAX_PIXEL_M:
                raise WorldError(f'{self.path}: its pixels are {self.pixel_x_m:g} x '
                                 f'{self.pixel_y_m:g} m; valid is up to {MAX_PIXEL_M:g} m; mend '
                                 'it with `gdal_edit.py -tr`')

    def _given_origin(self) -> tuple[float, float]:
        """Return the world's origin in the CRS, given as `crs` or `lonlat`."""
        a, b = self.config.dem.center
        if self.config.dem.center_mode == 'crs':
            return a, b
        crs = self._data.crs
        if crs is None or body_radius_m(crs) is None:
            self._refuse_center_mode()
        projected = transformed(lon_lat_crs(crs), crs, a, b)
        if projected is None or abs(b) > 90.0:
            raise WorldError(f'world.dem.center: {a:g}, {b:g} cannot be projected to the CRS of '
                             f'{self.path}')
        return projected

    def _origin(self) -> tuple[float, float]:
        """Return the world's origin in the CRS, however it is given."""
        dem, data = self.config.dem, self._data
        if dem.center_mode == 'pixel':
            return _at(data.transform, *dem.center)
        if dem.center_mode != 'offset':
            return self._given_origin()
        x, y = _at(data.transform, 0.5 * data.width, 0.5 * data.height)
        if not any(dem.center):
            return x, y
        middle = transformed(data.crs, lon_lat_crs(data.crs), x, y)
        there = middle and transformed(local_crs(data.crs, *middle), data.crs, *dem.center)
        if there is None:
            raise WorldError(f'world.dem.center: {dem.center[0]:g}, {dem.center[1]:g} m from the '
                             f'middle of {self.path} is not in its CRS')
        return there

    def _resample(self, x: float, y: float, sides_m: Array) -> None:
        """Read through a map in metres east and north of the origin instead.

        Args:
            x, y: The origin in the CRS of the file.
            sides_m: Of a pixel, along east and north.
        """
        source = self._data
        self.pixel_x_m, self.pixel_y_m = map(float, sides_m)
        self._check_pixels()
        here = transformed(source.crs, lon_lat_crs(source.crs), x, y)
        assert here is not None     # local_scale found it
        local = local_crs(source.crs, *here)
        crs, grid = self._about_meridian(x, here[0])
        n, cell_m = levels.plan(self.config)[-1]
        half = 0.5 * n * cell_m + 500.0 * self.config.site_km + 4.0 * self.pixel_m
        low, high = self._reach(crs, grid, local)
        west, south = (max(int(-(-v // s)), int(-half // s)) for v, s in zip(low, sides_m))
        east, north = (min(int(v // s), int(-(-half // s))) for v, s in zip(high, sides_m))
        self.width, self.height = max(east - west, 1), max(north - south, 1)
        if max(self.width, self.height) > _MOST_SIDE:
            raise WorldError(f'{self.path}: its pixels are {self.pixel_x_m:g} x '
                             f'{self.pixel_y_m:g} m, {self.width} x {self.height} for the world; '
                             'resample it with `gdalwarp -tr`')
        self.column0, self.row0 = float(-west), float(north)
        place = Affine(self.pixel_x_m, 0.0, west * self.pixel_x_m,
                       0.0, -self.pixel_y_m, north * self.pixel_y_m)
        # Marks of missing data are looked for in values of the file, not in means of them.
        self._data, self._nearest = (self._open_files.enter_context(WarpedVRT(
            source, src_crs=crs, src_transform=grid, crs=local, transform=place,
            width=self.width, height=self.height, nodata=math.nan, dtype='float64',
            tolerance=0.01, resampling=how)) for how in (Resampling.cubic, Resampling.nearest))
        self.report['crs'] = local.to_string()
        self.report.update(MoonPlace(*here).to_report())

    def _about_meridian(self, x: float, lon_deg: float) -> tuple[CRS, Affine]:
        """Return CRS and geotransform of the file, counted from the meridian of the origin.

        Where x is a longitude, in degrees or in a cylindrical projection, the window may lie
        across the meridian at which PROJ's longitudes jump, or the file count on from there.
        """
        crs, grid = self._data.crs, self._data.transform
        moved = Affine(*grid[:2], grid.c - x, *grid[3:6])
        if crs.is_geographic:
            unit, radius = metres_per_unit(crs), body_radius_m(crs)
            return (CRS.from_dict(proj='eqc', lon_0=lon_deg, R=radius, units='m', no_defs=True),
                    Affine(*(unit * v for v in moved[:6])))
        keys = crs.to_dict()
        if keys.get('proj') in _CYLINDRICAL:
            return CRS.from_dict({**keys, 'lon_0': lon_deg, 'x_0': 0.0}), moved
        return crs, grid

    def _reach(self, crs: CRS, grid: Affine, local: CRS) -> tuple[Array, Array]:
        """Return the least and greatest local coordinates of the edge of the file [m]."""
        t = np.linspace(0.0, 1.0, _EDGE_POINTS)
        zero, one = np.zeros_like(t), np.ones_like(t)
        columns = self._data.width * np.concatenate([t, t, zero, one])
        rows = self._data.height * np.concatenate([zero, one, t, t])
        xs, ys = _at(grid, columns, rows)
        try:
            points = np.array(transform(crs, local, xs, ys)[:2])
        except Exception:  # rasterio has no public class for the errors of PROJ
            points = np.full((2, 1), np.nan)
        points = points[:, np.isfinite(points).all(axis=0)]
        if not points.size:
            return np.full(2, -1e9), np.full(2, 1e9)
        return points.min(axis=1), points.max(axis=1)

    def site_of_origin(self) -> MoonPlace | None:
        """Return where the world's origin is on the Moon.

        None if the file does not say, or its CRS is of another body.
        """
        data = self._data
        if data.crs is None or data.transform.is_identity or body_radius_m(data.crs) is None:
            return None
        grid = data.transform
        return site_of(data.crs, grid.c + self.column0 * grid.a, grid.f + self.row0 * grid.e)

    def site_at(self, lon_deg: float, lat_deg: float) -> MoonPlace | None:
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
        shape = ((rows.stop - rows.start) // factor, (columns.stop - columns.start) // factor)
        values = self._values(self._data, rows, columns, shape)
        known = ~np.ma.getmaskarray(values)
        return np.ma.getdata(values), known

    def to_metres(self, values: NDArray) -> NDArray:
        """Return the heights that values of the band stand for."""
        return (values.astype(float) * self._scale + self._offset) * self._unit_m

    def read_raw(self, rows: slice, columns: slice) -> NDArray:
        """Return the values of the file at a part of the pixels, as a masked array."""
        return self._values(self._nearest, rows, columns)

    def _values(self, data: Any, rows: slice, columns: slice,
                shape: tuple[int, int] | None = None) -> NDArray:
        window = Window(columns.start, rows.start, columns.stop - columns.start,
                        rows.stop - rows.start)
        try:
            with stderr_to_log(logger):
                return data.read(self.config.dem.band, window=window, out_shape=shape, masked=True,
                                 resampling=Resampling.average)
        except RasterioError as error:
            reason = one_line(error.__cause__ or error)
            raise WorldError(f'{self.path}: cannot be read, it may be cut short: '
                             f'{reason}') from None
