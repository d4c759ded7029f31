"""What is known of a site from orbit: heights, a photo and craters, with their errors.

Planner and localiser read these maps; they never see the ground itself.
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import json
import logging
import math
from pathlib import Path
from typing import Any
import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray
import rasterio
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import MemoryFile
from rasterio.transform import from_origin

from lunar_rover_sim.base.errors import brief, ConfigError, one_line, WorldError
from lunar_rover_sim.base.files.atomic import atomic_write, partial_folder
from lunar_rover_sim.base.files.library_output import stderr_to_log
from lunar_rover_sim.base.files.paths import check_regular
from lunar_rover_sim.base.files.yaml_text import read_text
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.ground.world.raster import MAX_HEIGHT_M

logger = logging.getLogger(__name__)

HEIGHTS_FILE, PHOTO_FILE = 'heights.tif', 'photo.tif'
CRATERS_FILE, ABOUT_FILE = 'craters.geojson', 'orbital.json'
FORMAT = 1
NO_PHOTO = 0                # value of a pixel without data
_MOST_BYTES = 1 << 28       # of a text


@dataclasses.dataclass(frozen=True)
class OrbitalConfig(Parameters):
    """Pixels and errors of maps from orbit.

    The defaults are those of elevation models from stereo of the Narrow Angle Camera, 2 m a pixel:
    about half a metre from place to place (Henriksen et al., Icarus 283, 2017), and a metre or so
    of the whole against the laser altimeter.
    """

    extent_m: float = param(0.0, 'side of the map around the origin of the site; 0: all of the '
                            'site', unit='m', low=0.0)
    pixel_m: float = param(2.0, 'side of a pixel of the heights', unit='m', low=0.2, high=100.0)
    photo_pixel_m: float = param(1.0, 'side of a pixel of the photo; 0: no photo', unit='m',
                                 low=0.0, high=100.0)
    smooth_m: float = param(2.0, 'standard deviation of the Gaussian through which heights are '
                            'seen: stereo resolves a few pixels', unit='m', low=0.0, high=100.0)
    height_stddev_m: float = param(0.5, 'error of a height', unit='m', low=0.0, high=100.0)
    correlation_m: float = param(20.0, 'distance at which the correlation of that error has '
                                 'fallen to 1/e, as a Gaussian', unit='m', low=0.0, high=1000.0)
    bias_stddev_m: float = param(1.0, 'error of all heights together', unit='m', low=0.0,
                                 high=1000.0)
    tilt_stddev_deg: float = param(0.02, 'tilt of the whole map, about x and about y',
                                   unit='deg', low=0.0, high=5.0)
    crater_place_m: float = param(1.0, 'error of the place of a crater, in x and in y', unit='m',
                                  low=0.0, high=100.0)
    crater_size: float = param(0.05, 'error of the diameter of a crater, as a share of it',
                               low=0.0, high=1.0)
    photo_noise: float = param(0.01, 'error of the brightness of the photo, as a share of full '
                               'scale', low=0.0, high=1.0)
    sun_azimuth_deg: float = param(210.0, 'sun of the photo, from east towards north',
                                   unit='deg', low=-360.0, high=360.0)
    sun_elevation_deg: float = param(25.0, 'its elevation', unit='deg', low=1.0, high=90.0)
    error_seed: int = param(1, 'seed of the errors', low=0)


@dataclasses.dataclass(frozen=True)
class MappedCraters:
    """Craters as they are seen from orbit; arrays of equal length m.

    Attributes:
        position_m: (m, 2) centre, site frame.
        diameter_m: (m,) from rim to rim.
    """

    position_m: Array
    diameter_m: Array

    def __len__(self) -> int:
        return len(self.diameter_m)


@dataclasses.dataclass(frozen=True)
class OrbitalMap:
    """Maps of a site from orbit, in the frame of the site.

    Row 0 is south, column 0 west; pixel [row, column] is the mean of a square whose middle is
    `first_m + pixel_m * (column, row)`.

    Attributes:
        heights_m: (rows, columns) float32; NaN where the source has no data.
        first_m: (2,) place of the middle of the pixel [0, 0].
        craters: Of at least two pixels.
        photo: (rows, columns) uint8, seen from above under the sun of the config; 0 where the
            source has no data. (0, 0) without a photo.
        photo_first_m: (2,) place of the middle of its pixel [0, 0].
        config: Pixels, sun and errors as stated; what was drawn is not known.
        recipe: Of the ground, as its parameters say it.
        name: Hash of the ground from which it was made.
        crs: Of the files: WKT; '': metres east and north of the origin of the site.
        origin_m: (2,) place of the origin of the site in that CRS.
    """

    heights_m: NDArray[np.float32]
    first_m: tuple[float, float]
    craters: MappedCraters
    photo: NDArray[np.uint8]
    photo_first_m: tuple[float, float]
    config: OrbitalConfig
    recipe: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    name: str = ''
    crs: str = ''
    origin_m: tuple[float, float] = (0.0, 0.0)

    def __repr__(self) -> str:
        rows, columns = self.heights_m.shape
        return (f'OrbitalMap({columns * self.pixel_m:g} m x {rows * self.pixel_m:g} m at '
                f'{self.pixel_m:g} m, {len(self.craters)} craters)')

    @property
    def pixel_m(self) -> float:
        """Side of a pixel of the heights."""
        return self.config.pixel_m

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """Least x, least y, greatest x and greatest y of the heights, site frame."""
        rows, columns = self.heights_m.shape
        west, south = (v - 0.5 * self.pixel_m for v in self.first_m)
        return west, south, west + columns * self.pixel_m, south + rows * self.pixel_m

    def height_at(self, xy_m: ArrayLike) -> Array:
        """Return heights [m] at (..., 2) places, bilinear; NaN beyond the map and at its holes."""
        return bilinear(self.heights_m, self.first_m, self.pixel_m, xy_m)

    def variance_m2(self, xy_m: ArrayLike) -> Array:
        """Return the variance of the heights at (..., 2) places: noise, bias and tilt [m^2]."""
        config, xy = self.config, np.asarray(xy_m, float)
        tilt = math.tan(math.radians(config.tilt_stddev_deg))
        return (config.height_stddev_m ** 2 + config.bias_stddev_m ** 2
                + tilt ** 2 * np.sum(xy * xy, axis=-1))

    def covariance_m2(self, a_m: ArrayLike, b_m: ArrayLike) -> Array:
        """Return the covariance of the heights at (..., 2) places a and b [m^2]."""
        config, a, b = self.config, np.asarray(a_m, float), np.asarray(b_m, float)
        tilt = math.tan(math.radians(config.tilt_stddev_deg))
        apart = np.linalg.norm(a - b, axis=-1)
        alike = (np.exp(-(apart / config.correlation_m) ** 2) if config.correlation_m
                 else apart < 0.5 * config.pixel_m)
        return (config.height_stddev_m ** 2 * alike + config.bias_stddev_m ** 2
                + tilt ** 2 * np.sum(a * b, axis=-1))

    def save(self, folder: Path) -> None:
        """Write heights.tif, photo.tif, craters.geojson, orbital.json into a folder, or nothing.

        Raises:
            WorldError: If one cannot be written.
        """
        with partial_folder(folder, WorldError) as there:
            self._write(there)
            folder.mkdir(parents=True, exist_ok=True)
            if not self.photo.size:     # that of an older export shows another ground or sun
                (folder / PHOTO_FILE).unlink(missing_ok=True)
            # The last one says that all are there.
            for file in sorted(there.iterdir(), key=lambda file: file.name == ABOUT_FILE):
                file.replace(folder / file.name)

    def _write(self, folder: Path) -> None:
        tags = {'ground': self.name, 'error_seed': str(self.config.error_seed)}
        files: list[tuple[str, NDArray[Any], tuple[float, float], float, float]] = [
            (HEIGHTS_FILE, self.heights_m, self.first_m, self.pixel_m, math.nan)]
        if self.photo.size:
            files.append((PHOTO_FILE, self.photo, self.photo_first_m, self.config.photo_pixel_m,
                          NO_PHOTO))
        for name, values, first, pixel, nodata in files:
            place = self.origin_m[0] + first[0], self.origin_m[1] + first[1]
            write_tif(folder / name, values, place, pixel, self.crs or None, tags, nodata=nodata)
        atomic_write(folder / CRATERS_FILE, json.dumps(self._features()) + '\n', WorldError)
        about = {'format': FORMAT, 'frame': self._frame(), 'crs': self.crs,
                 'origin_m': list(self.origin_m), 'errors': self.config.to_mapping(),
                 'ground': self.name, 'recipe': self.recipe}
        atomic_write(folder / ABOUT_FILE, json.dumps(about, indent=1) + '\n', WorldError)

    def _frame(self) -> str:
        return ('coordinates of the CRS' if self.crs
                else 'metres east and north of the origin of the site')

    def _features(self) -> dict[str, Any]:
        config, craters = self.config, self.craters
        places = (craters.position_m + self.origin_m).round(2).tolist()
        features = [{'type': 'Feature', 'geometry': {'type': 'Point', 'coordinates': place},
                     'properties': {'kind': 'crater', 'diameter_m': round(size, 2),
                                    'place_stddev_m': config.crater_place_m,
                                    'diameter_stddev_m': round(config.crater_size * size, 3)}}
                    for place, size in zip(places, craters.diameter_m.tolist())]
        return {'type': 'FeatureCollection', 'features': features, 'coordinates': self._frame(),
                'ground': self.name}

    @staticmethod
    def load(folder: Path) -> OrbitalMap:
        """Read what `save` wrote.

        Raises:
            WorldError: If a file is missing, or is not what it should be.
        """
        path = folder / ABOUT_FILE
        about = _json(path)
        if about.get('format') != FORMAT:
            raise WorldError(f'{path}: format {brief(about.get("format"))} is not valid; valid '
                             f'is {FORMAT}')
        try:
            config = OrbitalConfig.from_mapping(about['errors'])
            origin = tuple(float(v) for v in about['origin_m'])
            recipe, name, crs = dict(about['recipe']), str(about['ground']), str(about['crs'])
            if len(origin) != 2 or not all(map(math.isfinite, origin)):
                raise ValueError(f'origin_m: {brief(about["origin_m"])} is not valid')
        except (KeyError, TypeError, ValueError, OverflowError, ConfigError) as reason:
            what = f'{reason} is missing' if isinstance(reason, KeyError) else reason
            raise WorldError(f'{path}: is no description of orbital maps: {what}') from None
        heights, first = _read_tif(folder / HEIGHTS_FILE, config.pixel_m, np.float32(np.nan),
                                   origin, name)
        if (np.abs(heights) >= MAX_HEIGHT_M).any() or np.isnan(heights).all():
            raise WorldError(f'{folder / HEIGHTS_FILE}: its heights are infinite, or all missing; '
                             f'valid are those below {MAX_HEIGHT_M:g} m, and NaN or its nodata '
                             'where there are none')
        photo, photo_first = np.zeros((0, 0), np.uint8), (0.0, 0.0)
        if config.photo_pixel_m:
            photo, photo_first = _read_tif(folder / PHOTO_FILE, config.photo_pixel_m,
                                           np.uint8(NO_PHOTO), origin, name)
        return OrbitalMap(heights, first, _read_craters(folder / CRATERS_FILE, origin, name),
                          photo, photo_first, config, recipe, name, crs, (origin[0], origin[1]))


def write_tif(path: Path, values: NDArray[Any], first_m: tuple[float, float], pixel_m: float,
              crs: Any, tags: Mapping[str, str], **options: Any) -> None:
    """Write values (rows, columns), row 0 south, as GeoTIFF.

    Args:
        first_m: Place of the middle of the pixel [0, 0] in the CRS.
        crs: As rasterio takes it; None: no CRS.
        options: Further ones of the driver.

    Raises:
        WorldError: If it cannot be written.
    """
    west, north = first_m[0] - 0.5 * pixel_m, first_m[1] + (len(values) - 0.5) * pixel_m
    with MemoryFile() as memory:
        with memory.open(driver='GTiff', width=values.shape[1], height=values.shape[0], count=1,
                         dtype=values.dtype.name, crs=crs, compress='deflate', tiled=True,
                         transform=from_origin(west, north, pixel_m, pixel_m), **options) as out:
            out.write(values[::-1], 1)      # row 0 is in the north
            out.update_tags(**tags)
        atomic_write(path, bytes(memory.getbuffer()), WorldError)


def bilinear(values: NDArray[np.float32], first_m: tuple[float, float], pixel_m: float,
             xy_m: ArrayLike) -> Array:
    """Return values of a grid at (..., 2) places; NaN more than half a pixel beyond it.

    Args:
        first_m: (2,) place of the sample [0, 0].
    """
    place = (np.asarray(xy_m, float) - first_m) / pixel_m
    rows, columns = values.shape
    column, row = np.moveaxis(place, -1, 0)
    # Outer pixels reach half a pixel beyond their middles.
    inside = ((row >= -0.5) & (row <= rows - 0.5) & (column >= -0.5) & (column <= columns - 0.5))
    row, column = np.clip(row, 0.0, rows - 1.0), np.clip(column, 0.0, columns - 1.0)
    r = np.minimum(np.nan_to_num(row).astype(int), max(rows - 2, 0))
    c = np.minimum(np.nan_to_num(column).astype(int), max(columns - 2, 0))
    v, u = row - r, column - c
    r1, c1 = np.minimum(r + 1, rows - 1), np.minimum(c + 1, columns - 1)
    z = values.astype(float) if values.size < 4 else values
    height = ((1.0 - v) * ((1.0 - u) * z[r, c] + u * z[r, c1])
              + v * ((1.0 - u) * z[r1, c] + u * z[r1, c1]))
    return np.where(inside, height, np.nan)


def _json(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(read_text(path, _MOST_BYTES, WorldError))
    except WorldError as reason:
        raise WorldError(f'{reason}; valid is a folder of `world export --orbital`') from None
    except (ValueError, RecursionError):
        raise WorldError(f'{path}: is no JSON') from None
    if not isinstance(found, dict):
        raise WorldError(f'{path}: is no JSON object')
    return found


def _read_tif(path: Path, pixel_m: float, missing: np.generic, origin_m: tuple[float, ...],
              ground: str) -> tuple[NDArray[Any], tuple[float, float]]:
    """Return a raster, row 0 south, and the place of its first pixel in the site.

    Args:
        missing: Value where the file has no data, of the type that is valid.
        ground: Of the maps; a file that names another is refused.
    """
    check_regular(path, WorldError)
    dtype = missing.dtype.name
    try:
        with warnings.catch_warnings(), stderr_to_log(logger):
            warnings.simplefilter('ignore', NotGeoreferencedWarning)
            with rasterio.open(path) as file:
                t = file.transform
                if file.count != 1 or file.dtypes[0] != dtype:
                    raise WorldError(f'{path}: {file.count} bands of {file.dtypes[0]} are not '
                                     f'valid; valid is one of {dtype}')
                if t.b or t.d or abs(t.a - pixel_m) > 1e-6 or abs(t.e + pixel_m) > 1e-6:
                    raise WorldError(f'{path}: pixels of {t.a:g}, {t.e:g} with north not up are '
                                     f'not valid; valid is {pixel_m:g}, -{pixel_m:g} as in '
                                     f'{ABOUT_FILE}')
                _check_ground(path, file.tags().get('ground', ground), ground)
                # Other programs mark missing data by values of their own, as -9999.
                found = file.read(1, masked=True).filled(missing)
                first = (t.c + 0.5 * pixel_m - origin_m[0],
                         t.f - (file.height - 0.5) * pixel_m - origin_m[1])
    except (RasterioError, ValueError) as reason:
        raise WorldError(f'{path}: cannot be read, it may be damaged: {one_line(reason)}'
                         ) from None
    values = np.ascontiguousarray(found[::-1])
    values.setflags(write=False)
    return values, first


def _check_ground(path: Path, found: object, ground: str) -> None:
    if found != ground:
        raise WorldError(f'{path}: is of the ground {brief(found)}, and {ABOUT_FILE} of '
                         f'{brief(ground)}; valid are files of one export')


def _read_craters(path: Path, origin_m: tuple[float, ...], ground: str) -> MappedCraters:
    found = _json(path)
    _check_ground(path, found.get('ground', ground), ground)
    try:
        # Other programs add a height to a place.
        rows = [(*feature['geometry']['coordinates'][:2], feature['properties']['diameter_m'])
                for feature in found['features']]
        table = np.array(rows, float).reshape(len(rows), 3)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise WorldError(f'{path}: is no list of craters') from None
    if not np.isfinite(table).all() or (table[:, 2] <= 0.0).any():
        raise WorldError(f'{path}: places and diameters must be finite, diameters > 0 [m]')
    return MappedCraters(table[:, :2] - origin_m, table[:, 2])
