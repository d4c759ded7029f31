"""Elevation models: GeoTIFF and other rasters, and folders of dem.npy with dem.yaml.

Only the window that a world needs is read, decimated to the resolution that it needs.
"""

from __future__ import annotations

import abc
import logging
import pathlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.errors import WorldError
from lunar_rover_sim.world.config import WorldConfig
from lunar_rover_sim.world.fill import harmonic_fill
from lunar_rover_sim.world.tile import Tile

logger = logging.getLogger(__name__)

_PAD_PIXELS = 3
_ABSURD_M = 1e5  # no height on the Moon is so far from anything: a marker for no data


def open_dem(config: WorldConfig) -> Raster:
    """Return the elevation model that the parameters name; raise WorldError."""
    path = pathlib.Path(config.path).expanduser()
    if not path.exists():
        raise WorldError(f'path: {path}: no such file')
    raster = NumpyFolder(path, config) if path.is_dir() else GeoRaster(path, config)
    try:
        raster.check_ground()
    except BaseException:
        raster.close()
        raise
    return raster


class Raster(abc.ABC):
    """A grid of heights; a `tile.Source`. Rows count from the north, unless `south_up`."""

    def __init__(self, path: pathlib.Path, config: WorldConfig) -> None:
        self.path = path
        self.config = config
        self.reference_m = 0.0
        self.report: dict[str, Any] = {'file': str(path)}
        self.south_up = False
        self.width = self.height = 0
        self.pixel_x_m = self.pixel_y_m = 1.0
        self.column0 = self.row0 = 0.0

    @abc.abstractmethod
    def read(self, rows: slice, columns: slice, factor: int) -> tuple[NDArray, NDArray]:
        """Return heights [m] and whether they are data, averaged over factor x factor pixels."""

    @abc.abstractmethod
    def close(self) -> None:
        """Release the file."""

    @property
    def pixel_m(self) -> float:
        """The larger side of a pixel."""
        return max(self.pixel_x_m, self.pixel_y_m)

    @property
    def area_m(self) -> tuple[float, float, float, float]:
        """x low, x high, y low, y high of the file's pixels, world frame."""
        south, north = self.row0 - self.height, self.row0
        if self.south_up:
            south, north = -self.row0, self.height - self.row0
        return (-self.column0 * self.pixel_x_m, (self.width - self.column0) * self.pixel_x_m,
                south * self.pixel_y_m, north * self.pixel_y_m)

    def check_ground(self) -> None:
        """Check that the ground lies in the file and has data; set the reference height."""
        half = 0.5 * self.config.size_m
        area = self.area_m
        names = ('west', 'east', 'south', 'north')
        beyond = (area[0] + half, half - area[1], area[2] + half, half - area[3])
        worst = int(np.argmax(beyond))
        if beyond[worst] > 1e-6:
            wide, high = area[1] - area[0], area[3] - area[2]
            raise WorldError(
                f'{self.path}: the window of {self.config.size_m:g} m reaches '
                f'{beyond[worst]:.4g} m beyond the {names[worst]} edge of the file '
                f'({wide:.5g} x {high:.5g} m); move dem.center or make size_m smaller')
        heights, known, _, _ = self._window(half, self.config.cell_m)
        if not known.all():
            missing = int((~known).sum())
            if self.config.dem.nodata == 'refuse' or missing == known.size:
                raise WorldError(
                    f'{self.path}: {missing} of {known.size} pixels in the window have no data; '
                    'move dem.center' + ('' if missing == known.size
                                         else ' or set dem.nodata to fill'))
            logger.warning('%s: %d of %d pixels without data are filled', self.path, missing,
                           known.size)
        self.report['filled_pixels'] = int((~known).sum())
        middle = harmonic_fill((heights - heights[known][0]).astype(np.float32), known)
        self.reference_m = float(heights[known][0]
                                 + middle[middle.shape[0] // 2, middle.shape[1] // 2])
        self.report['pixel_m'] = [self.pixel_x_m, self.pixel_y_m]

    def tile(self, half_extent_m: float, cell_m: float) -> Tile | None:
        """Return what the file knows of [-h, h]^2, averaged to about a cell."""
        heights, known, x, y = self._window(half_extent_m, cell_m)
        if min(heights.shape) < 2 or not known.any():
            return None
        heights = harmonic_fill((heights - self.reference_m).astype(np.float32), known)
        return Tile(heights, x, y, float(max(x[1] - x[0], y[1] - y[0])))

    def _window(self, half_m: float,
                cell_m: float) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Return heights, data mask (row 0 south), and pixel centres in x and y."""
        factor = max(int(cell_m / self.pixel_m), 1)
        c0, c1 = _clip(self.column0, half_m / self.pixel_x_m, self.width, factor)
        r0, r1 = _clip(self.row0, half_m / self.pixel_y_m, self.height, factor)
        if c1 - c0 < factor or r1 - r0 < factor:
            empty = np.empty((0, 0))
            return empty, empty.astype(bool), empty[0:0], empty[0:0]
        heights, known = self.read(slice(r0, r1), slice(c0, c1), factor)
        heights = np.asarray(heights, float) * self.config.dem.height_scale
        known = known & np.isfinite(heights) & (np.abs(np.nan_to_num(heights)) < _ABSURD_M)
        heights = np.where(known, heights, 0.0)
        x = (c0 + (np.arange(heights.shape[1]) + 0.5) * factor - self.column0) * self.pixel_x_m
        y = (r0 + (np.arange(heights.shape[0]) + 0.5) * factor - self.row0) * self.pixel_y_m
        if not self.south_up:
            heights, known, y = heights[::-1], known[::-1], -y[::-1]
        return heights, known, x, y


def _clip(middle: float, half: float, size: int, factor: int) -> tuple[int, int]:
    """Return the first and last pixel of a window with a margin, a multiple of the factor."""
    pad = _PAD_PIXELS * factor
    low = max(int(np.floor(middle - half)) - pad, 0)
    high = min(int(np.ceil(middle + half)) + pad, size)
    return low, low + max(high - low, 0) // factor * factor


class GeoRaster(Raster):
    """A raster that rasterio reads."""

    def __init__(self, path: pathlib.Path, config: WorldConfig) -> None:
        super().__init__(path, config)
        import warnings

        import rasterio
        import rasterio.errors
        try:
            with warnings.catch_warnings():
                warnings.simplefilter('ignore', rasterio.errors.NotGeoreferencedWarning)
                self._data = rasterio.open(path)
        except rasterio.errors.RasterioError as error:
            raise WorldError(f'{path}: not a raster that can be read: '
                             f'{" ".join(str(error).split())}') from None
        try:
            self._interpret()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Release the file."""
        self._data.close()

    def _interpret(self) -> None:
        data, dem = self._data, self.config.dem
        if dem.band > data.count:
            raise WorldError(f'dem.band: {dem.band}; {self.path} has {data.count}')
        if np.dtype(data.dtypes[dem.band - 1]).kind not in 'iuf':
            raise WorldError(f'{self.path}: {data.dtypes[dem.band - 1]} is not a type for heights')
        self.width, self.height = data.width, data.height
        transform = data.transform
        unit = 1.0
        if transform.is_identity:
            if not dem.pixel_m:
                raise WorldError(f'{self.path}: it does not say how large its pixels are; set '
                                 'dem.pixel_m')
            size_x = size_y = dem.pixel_m
        else:
            if transform.b or transform.d or transform.a <= 0.0:
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
            size_x, size_y = transform.a * unit, abs(transform.e) * unit
            self.south_up = transform.e > 0.0
            if dem.pixel_m:
                size_x = size_y = dem.pixel_m
        self.pixel_x_m, self.pixel_y_m = size_x, size_y
        self.report['crs'] = data.crs.to_string() if data.crs is not None else ''
        self.column0, self.row0 = self._middle()

    def _middle(self) -> tuple[float, float]:
        """Return the column and row, in pixels from the corner, of the world's origin."""
        data, dem = self._data, self.config.dem
        a, b = dem.center
        if dem.center_mode == 'pixel':
            return a, b
        if dem.center_mode == 'offset':
            sign = 1.0 if self.south_up else -1.0
            return (self.width / 2.0 + a / self.pixel_x_m,
                    self.height / 2.0 + sign * b / self.pixel_y_m)
        if data.transform.is_identity or (data.crs is None and dem.center_mode == 'lonlat'):
            raise WorldError(f'dem.center_mode: {dem.center_mode}; {self.path} has no CRS: use '
                             'offset or pixel')
        if dem.center_mode == 'lonlat':
            from rasterio.crs import CRS
            from rasterio.warp import transform
            body = data.crs.to_dict()
            keys = {k: body[k] for k in ('R', 'a', 'b', 'rf', 'ellps', 'datum') if k in body}
            sphere = CRS.from_dict(proj='longlat', no_defs=True, **(keys or {'R': 1737400.0}))
            try:
                xs, ys = transform(sphere, data.crs, [a], [b])
            except Exception:  # GDAL's errors have no public class
                xs, ys = [np.inf], [np.inf]
            if not np.all(np.isfinite([*xs, *ys])):
                raise WorldError(f'dem.center: {a:g}, {b:g} cannot be projected to the CRS of '
                                 f'{self.path}')
            a, b = xs[0], ys[0]
        grid = data.transform
        return float((a - grid.c) / grid.a), float((b - grid.f) / grid.e)

    def read(self, rows: slice, columns: slice, factor: int) -> tuple[NDArray, NDArray]:
        """Return a window through rasterio; overviews are used where the file has them."""
        from rasterio.enums import Resampling
        import rasterio.errors
        from rasterio.windows import Window
        band = self.config.dem.band
        window = Window(columns.start, rows.start, columns.stop - columns.start,
                        rows.stop - rows.start)
        shape = ((rows.stop - rows.start) // factor, (columns.stop - columns.start) // factor)
        try:
            values = self._data.read(band, window=window, out_shape=shape, masked=True,
                                     resampling=Resampling.average)
        except rasterio.errors.RasterioError as error:
            reason = ' '.join(str(error.__cause__ or error).split())
            raise WorldError(f'{self.path}: cannot be read, it may be cut short: '
                             f'{reason}') from None
        known = ~np.ma.getmaskarray(values)
        heights = np.ma.getdata(values).astype(float)
        scale, offset = self._data.scales[band - 1], self._data.offsets[band - 1]
        return heights * scale + offset, known


class NumpyFolder(Raster):
    """A folder of dem.npy (row 0 north) and dem.yaml (size, pixel_size, center_coordinates)."""

    def __init__(self, path: pathlib.Path, config: WorldConfig) -> None:
        super().__init__(path, config)
        import yaml
        try:
            self._data = np.load(path / 'dem.npy', mmap_mode='r', allow_pickle=False)
            document = yaml.safe_load((path / 'dem.yaml').read_text(encoding='utf-8'))
        except FileNotFoundError as error:
            raise WorldError(f'{path}: {pathlib.Path(error.filename).name} is missing; a folder '
                             'needs dem.npy and dem.yaml') from None
        except (OSError, ValueError, EOFError, yaml.YAMLError) as error:
            raise WorldError(f'{path}: {" ".join(str(error).split())}') from None
        if (not isinstance(self._data, np.ndarray) or self._data.ndim != 2
                or self._data.dtype.kind not in 'iuf'):
            raise WorldError(f'{path}/dem.npy: not a two-dimensional array of heights')
        self.height, self.width = self._data.shape
        document = document if isinstance(document, dict) else {}
        size = document.get('size', [self.width, self.height])
        if list(size) != [self.width, self.height]:
            raise WorldError(f'{path}/dem.yaml: size: {size}; dem.npy is {self.width} wide and '
                             f'{self.height} high')
        pixel = document.get('pixel_size', [config.dem.pixel_m, -config.dem.pixel_m])
        if (not isinstance(pixel, list) or len(pixel) != 2
                or not all(isinstance(p, (int, float)) and p for p in pixel)):
            raise WorldError(f'{path}/dem.yaml: pixel_size: {pixel!r} is not two lengths [m]; '
                             'correct it or set dem.pixel_m')
        if config.dem.pixel_m:
            pixel = [config.dem.pixel_m, np.copysign(config.dem.pixel_m, pixel[1])]
        self.pixel_x_m, self.pixel_y_m = abs(float(pixel[0])), abs(float(pixel[1]))
        self.south_up = float(pixel[1]) > 0.0
        self.report['center_lon_lat_deg'] = document.get('center_coordinates')
        a, b = config.dem.center
        if config.dem.center_mode == 'pixel':
            self.column0, self.row0 = a, b
        elif config.dem.center_mode == 'offset':
            sign = 1.0 if self.south_up else -1.0
            self.column0 = self.width / 2.0 + a / self.pixel_x_m
            self.row0 = self.height / 2.0 + sign * b / self.pixel_y_m
        else:
            raise WorldError(f'dem.center_mode: {config.dem.center_mode}; {path} has no CRS: use '
                             'offset or pixel')

    def close(self) -> None:
        """Release the file."""
        del self._data

    def read(self, rows: slice, columns: slice, factor: int) -> tuple[NDArray, NDArray]:
        """Return a window of the mapped array, averaged strip by strip."""
        count = (columns.stop - columns.start) // factor
        strips, masks = [], []
        for start in range(rows.start, rows.stop, factor):
            block = np.asarray(self._data[start:start + factor, columns], float)
            known = np.isfinite(block) & (np.abs(block) < _ABSURD_M)
            total = np.where(known, block, 0.0).reshape(factor, count, factor).sum(axis=(0, 2))
            data = known.reshape(factor, count, factor).sum(axis=(0, 2))
            strips.append(total / np.maximum(data, 1))
            masks.append(data > 0)
        return np.array(strips), np.array(masks)
