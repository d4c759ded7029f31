"""Making maps from orbit of a site, block by block, so that memory does not grow with samples.

Pixels are means of samples of the ground over their area. Errors are drawn with a seed of their
own, which the ground does not know.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import math

import numpy as np
from numpy.typing import NDArray
import scipy.ndimage

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.grid import Box
from lunar_rover_sim.ground.world.mapped_ground import MappedGround, on_axes
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.orbital_map import MappedCraters, OrbitalConfig, OrbitalMap
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.ground.world.shade import add_domes, line_of_sight, shaded
from lunar_rover_sim.ground.world.site import Site

F32 = NDArray[np.float32]
Progress = Callable[[str, float], object]

_BLOCK_PX = 256
_SAMPLE_M = 0.5             # of the ground, at least one and at most four along a pixel
_MOST_SAMPLES = 4
_NEAR_M = 40.0              # shadows of nearer ground are those of the photo's own samples
_LEAST_PX, _MOST_PX = 8, 12_000     # along a side; the most take 0.6 GB
_CRATER_PX = 2.0            # diameter of the smallest mapped crater, in pixels of the heights
_FULL = 230.0               # of the photo: ground that is white
_TRUNCATE = 4.0             # standard deviations of the kernel of the errors


def orbital_map(ground: World | Site | MappedGround, config: OrbitalConfig = OrbitalConfig(),
                progress: Progress | None = None, *, coarse: bool = False,
                photo_box: Box | None = None) -> OrbitalMap:
    """Return the maps of a site from orbit.

    Args:
        ground: A site, or a world: all of the site of which it is a window.
        config: Extent, pixels, sun of the photo, errors and their seed.
        progress: Called with what is being made and the fraction done so far.
        coarse: Take heights of a site's ground on cells as large as pixels, which is made much
            faster; craters of a few pixels are missing, others have a slightly other shape.
        photo_box: Part of which there is a photo, as far as the map reaches; None: all.

    Raises:
        WorldError: If the map would have fewer than 8 pixels along a side or more than 12,000, or
            reaches beyond the ground.
    """
    def on(cell_m: float) -> MappedGround:
        return ground if isinstance(ground, MappedGround) else MappedGround.of(ground, cell_m)

    fine_m = min(0.5 * config.pixel_m, config.photo_pixel_m or config.pixel_m)
    source = on(config.pixel_m if coarse else fine_m)
    tell = progress or (lambda what, fraction: None)
    half = 0.5 * config.extent_m or source.half_extent_m
    if half > source.half_extent_m:
        raise WorldError(f'extent_m: {config.extent_m:g} is not valid; valid is <= '
                         f'{2.0 * source.half_extent_m:g} [m], of this ground')
    for name, pixel in (('pixel_m', config.pixel_m), ('photo_pixel_m', config.photo_pixel_m)):
        least, most = 2.0 * half / _MOST_PX, 2.0 * half / _LEAST_PX
        if pixel and not least <= pixel <= most:
            valid = f'<= {most:g}' if pixel > most else f'>= {least:.3g}'
            raise WorldError(f'{name}: {pixel:g} is not valid; valid is {valid} [m], for '
                             f'{2.0 * half:g} m of ground')
    true = _true_heights(source, half, config.pixel_m, lambda share: tell('heights', share))
    n = len(true)
    first = 0.5 * (1 - n) * config.pixel_m
    photo, photo_first = np.zeros((0, 0), np.uint8), (0.0, 0.0)
    if config.photo_pixel_m:
        photo, photo_first = _photo(on(fine_m) if coarse else source, half, photo_box, config,
                                    true, lambda share: tell('photo', share))
    axis = np.asarray(first + config.pixel_m * np.arange(n), np.float64)
    heights = (_smoothed(true, config.smooth_m / config.pixel_m)
               + _height_errors(config, axis)).astype(np.float32)
    for array in (heights, photo):
        array.setflags(write=False)
    craters = _mapped(source.craters(_CRATER_PX * config.pixel_m), config, half)
    return OrbitalMap(heights, (first, first), craters, photo, photo_first, config,
                      source.recipe, source.name, source.crs, source.origin_m)


def _blocks(rows: slice, columns: slice) -> Iterator[tuple[slice, slice]]:
    for row in range(rows.start, rows.stop, _BLOCK_PX):
        for column in range(columns.start, columns.stop, _BLOCK_PX):
            yield (slice(row, min(row + _BLOCK_PX, rows.stop)),
                   slice(column, min(column + _BLOCK_PX, columns.stop)))


def _samples(pixel_m: float) -> int:
    return min(max(round(pixel_m / _SAMPLE_M), 2), _MOST_SAMPLES)


def _sample_axis(part: slice, n: int, pixel_m: float, samples: int, margin: int = 0) -> Array:
    """Return where the samples of some of n pixels lie, with more of them on either side [m]."""
    index = np.arange(part.start * samples - margin, part.stop * samples + margin)
    return (index + 0.5) * (pixel_m / samples) - 0.5 * n * pixel_m


def _means(values: Array, samples: int) -> Array:
    rows, columns = (size // samples for size in values.shape)
    return np.asarray(values.reshape(rows, samples, columns, samples).mean(axis=(1, 3)))


def _true_heights(source: MappedGround, half_m: float, pixel_m: float,
                  tell: Callable[[float], object]) -> F32:
    n, samples = int(2.0 * half_m / pixel_m + 1e-9), _samples(pixel_m)
    heights = np.empty((n, n), np.float32)
    for rows, columns in _blocks(slice(0, n), slice(0, n)):
        tell(rows.start / n)
        x, y = (_sample_axis(part, n, pixel_m, samples) for part in (columns, rows))
        heights[rows, columns] = _means(source.heights(x, y), samples)
    return heights


def _smoothed(heights_m: F32, sigma_px: float) -> F32:
    """Return heights through a Gaussian; what is missing stays so, and counts for nothing."""
    known = np.isfinite(heights_m)
    weight = scipy.ndimage.gaussian_filter(known.astype(np.float32), sigma_px, mode='nearest')
    total = scipy.ndimage.gaussian_filter(np.where(known, heights_m, np.float32(0.0)), sigma_px,
                                          mode='nearest')
    return np.where(known, total / np.maximum(weight, np.float32(1e-6)), heights_m)


def _height_errors(config: OrbitalConfig, axis_m: Array) -> Array:
    """Return what is wrong with the heights of a square map: noise, bias and tilt (n, n) [m]."""
    n = len(axis_m)
    rng = np.random.default_rng([config.error_seed, *b'heights'])
    bias = config.bias_stddev_m * rng.standard_normal()
    tilt = math.tan(math.radians(config.tilt_stddev_deg)) * rng.standard_normal(2)
    noise = config.height_stddev_m * _correlated(n, 0.5 * config.correlation_m / config.pixel_m,
                                                 rng)
    return np.asarray(noise + bias + tilt[0] * axis_m + tilt[1] * axis_m[:, None])


def _correlated(n: int, sigma_px: float, rng: np.random.Generator) -> Array:
    """Return Gaussian noise (n, n) of variance 1 everywhere.

    White noise is smoothed by a Gaussian of this standard deviation s; the correlation is then
    exp(-(d / 2 s)^2).
    """
    reach = int(_TRUNCATE * sigma_px + 0.5)
    noise = rng.standard_normal((n + 2 * reach, n + 2 * reach))
    if reach == 0:
        return noise
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_px) ** 2)
    kernel /= np.sqrt(np.sum(kernel ** 2))
    for axis in (0, 1):
        noise = scipy.ndimage.convolve1d(noise, kernel, axis=axis, mode='constant')
    return np.asarray(noise[reach:-reach, reach:-reach])


def _mapped(craters: Craters, config: OrbitalConfig, half_m: float) -> MappedCraters:
    """Return the craters that are seen on a map, with errors, the largest first."""
    rng = np.random.default_rng([config.error_seed, *b'craters'])
    large = craters.diameter_m >= _CRATER_PX * config.pixel_m
    inside = np.abs(craters.position_m).max(axis=1, initial=0.0) <= half_m
    seen = craters.select(np.flatnonzero(large & inside))
    seen = seen.select(np.argsort(-seen.diameter_m, kind='stable'))
    place = seen.position_m + config.crater_place_m * rng.standard_normal((len(seen), 2))
    size = seen.diameter_m * np.exp(config.crater_size * rng.standard_normal(len(seen)))
    return MappedCraters(place, size)


def _photo(source: MappedGround, half_m: float, box: Box | None, config: OrbitalConfig,
           coarse: F32, tell: Callable[[float], object]
           ) -> tuple[NDArray[np.uint8], tuple[float, float]]:
    """Return the photo of a box and where its first pixel has its middle.

    Shadows of far relief are those of the coarse heights.
    """
    pixel, sun = config.photo_pixel_m, (config.sun_azimuth_deg, config.sun_elevation_deg)
    n, samples = int(2.0 * half_m / pixel + 1e-9), _samples(config.photo_pixel_m)
    cell = pixel / samples
    margin = math.ceil(_NEAR_M / cell)
    lowest = float(np.nanmin(coarse)) if np.isfinite(coarse).any() else 0.0
    sight = line_of_sight(np.nan_to_num(coarse, nan=lowest), config.pixel_m, *sun,
                          from_cells=max(_NEAR_M / config.pixel_m, 1.0))
    sight_first = 0.5 * (1 - len(coarse)) * config.pixel_m
    west, east, south, north = box or (-half_m, half_m, -half_m, half_m)
    across, up = (slice(*np.clip([math.floor(low / pixel + 0.5 * n),
                                  math.ceil(high / pixel + 0.5 * n)], 0, n).tolist())
                  for low, high in ((west, east), (south, north)))
    photo = np.empty((up.stop - up.start, across.stop - across.start), np.uint8)
    done = 0
    for rows, columns in _blocks(up, across):
        tell(done / photo.size)
        x, y = (_sample_axis(part, n, pixel, samples, margin) for part in (columns, rows))
        heights = np.asarray(source.heights(x, y), np.float32)
        known = np.isfinite(heights)
        heights[~known] = lowest
        seen = float(x[0]), float(x[-1]), float(y[0]), float(y[-1])
        add_domes(heights, cell, (x[0] / cell, y[0] / cell),
                  _within(source.rocks(pixel, seen), seen))
        inner = np.s_[margin:-margin, margin:-margin]
        light = shaded(heights, cell, *sun)[inner]
        x, y = x[margin:-margin], y[margin:-margin]
        hidden = on_axes(sight, (sight_first, sight_first), config.pixel_m, x, y)
        light[hidden > heights[inner]] = 0.0
        bright = _FULL / 255.0 * _means(light * source.albedo(x, y), samples)
        rng = np.random.default_rng([config.error_seed, *b'photo', rows.start, columns.start])
        bright += config.photo_noise * rng.standard_normal(bright.shape)
        values = np.clip(255.0 * bright, 1.0, 255.0).round().astype(np.uint8)
        values[_means(known[inner], samples) < 1.0] = 0
        photo[rows.start - up.start:rows.stop - up.start,
              columns.start - across.start:columns.stop - across.start] = values
        done += values.size
    return photo, (pixel * (across.start + 0.5 * (1 - n)), pixel * (up.start + 0.5 * (1 - n)))


def _within(rocks: Rocks, box: Box) -> Rocks:
    """Return the rocks that reach into a box."""
    x, y = rocks.position_m[:, :2].T
    reach = 0.5 * rocks.diameter_m
    return rocks.select((x + reach >= box[0]) & (x - reach <= box[1])
                        & (y + reach >= box[2]) & (y - reach <= box[3]))
