"""Making maps from orbit of a site, block by block, so that memory does not grow with samples.

Pixels are means of samples of the ground over their area. Errors are drawn with a seed of their
own, which the ground does not know.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
import scipy.ndimage

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.albedo import far_albedo
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.far_rocks import far_rocks
from lunar_rover_sim.ground.world.map_projection import projected_origin
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.orbital_map import MappedCraters, OrbitalConfig, OrbitalMap
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.ground.world.shade import add_domes, line_of_sight, shaded

F32 = NDArray[np.float32]
OnAxes = Callable[[Array, Array], Array]
Progress = Callable[[str, float], object]

_BLOCK_PX = 256
_SAMPLE_M = 0.5             # of the ground, at least one and at most four along a pixel
_MOST_SAMPLES = 4
_NEAR_M = 40.0              # shadows of nearer ground are those of the photo's own samples
_LEAST_PX = 8
_CRATER_PX = 2.0            # diameter of the smallest mapped crater, in pixels of the heights
_FULL = 230.0               # of the photo: ground that is white
_TRUNCATE = 4.0             # standard deviations of the kernel of the errors


@dataclasses.dataclass(frozen=True)
class MappedGround:
    """Ground of which a map is made, in the frame of the site.

    Attributes:
        heights: Takes x (n,) and y (m,) and returns heights (m, n) [m], NaN where there are none.
        albedo: Takes the same and returns the albedo factor (m, n).
        half_extent_m: It reaches so far from the origin, in x and in y.
        craters: All that may be mapped.
        rocks: Takes a least diameter [m]; returns all larger rocks.
        recipe, name: As of `OrbitalMap`.
        crs, origin_m: As of `OrbitalMap`.
    """

    heights: OnAxes
    albedo: OnAxes
    half_extent_m: float
    craters: Craters
    rocks: Callable[[float], Rocks]
    recipe: Mapping[str, Any]
    name: str
    crs: str = ''
    origin_m: tuple[float, float] = (0.0, 0.0)

    @staticmethod
    def of(world: World) -> MappedGround:
        """Return the ground of a world with its coarse levels."""
        last = world.levels[-1]

        def heights(x_m: Array, y_m: Array) -> Array:
            found = np.full((len(y_m), len(x_m)), np.nan)
            for level in reversed(world.levels):
                rows, columns = (np.abs(axis - middle) <= level.half_extent_m
                                 for axis, middle in zip((y_m, x_m), level.middle_m[::-1]))
                if rows.any() and columns.any():
                    found[np.ix_(rows, columns)] = on_axes(
                        level.heights_m, _first(level.n, level.cell_m, level.middle_m),
                        level.cell_m, x_m[columns], y_m[rows])
            return found

        factor = far_albedo(world, len(world.levels) - 1) if len(world.levels) > 1 else None

        def albedo(x_m: Array, y_m: Array) -> Array:
            if factor is None:
                return np.ones((len(y_m), len(x_m)))
            return on_axes(factor, _first(last.n, last.cell_m, last.middle_m), last.cell_m,
                           x_m, y_m)

        def rocks(least_m: float) -> Rocks:
            far = far_rocks(world, last.half_extent_m)
            all_rocks = world.rocks.joined(far) if len(far) else world.rocks
            return all_rocks.select(all_rocks.diameter_m >= least_m)

        crs, origin = projected_origin(world)
        return MappedGround(heights, albedo, last.half_extent_m, world.craters, rocks,
                            world.config.to_mapping(), world.hash,
                            '' if crs is None else crs.to_wkt(), origin)


def orbital_map(ground: World | MappedGround, config: OrbitalConfig = OrbitalConfig(),
                progress: Progress | None = None) -> OrbitalMap:
    """Return the maps of a site from orbit.

    Args:
        ground: A world, with all of its levels, or another source.
        config: Extent, pixels, sun of the photo, errors and their seed.
        progress: Called with what is being made and the fraction done so far.

    Raises:
        WorldError: If the map would have fewer than 8 pixels along a side, or reaches beyond the
            ground.
    """
    source = ground if isinstance(ground, MappedGround) else MappedGround.of(ground)
    tell = progress or (lambda what, fraction: None)
    half = 0.5 * config.extent_m or source.half_extent_m
    if half > source.half_extent_m:
        raise WorldError(f'extent_m: {config.extent_m:g} is not valid; valid is <= '
                         f'{2.0 * source.half_extent_m:g} [m], of this ground')
    for name, pixel in (('pixel_m', config.pixel_m), ('photo_pixel_m', config.photo_pixel_m)):
        if pixel and 2.0 * half / pixel < _LEAST_PX:
            raise WorldError(f'{name}: {pixel:g} is not valid; valid is <= '
                             f'{2.0 * half / _LEAST_PX:g} [m], for {2.0 * half:g} m of ground')
    true = _true_heights(source, half, config.pixel_m, lambda share: tell('heights', share))
    n = len(true)
    first = 0.5 * (1 - n) * config.pixel_m
    photo = np.zeros((0, 0), np.uint8)
    if config.photo_pixel_m:
        photo = _photo(source, half, config, true, lambda share: tell('photo', share))
    axis = np.asarray(first + config.pixel_m * np.arange(n), np.float64)
    heights = (true + _height_errors(config, axis)).astype(np.float32)
    for array in (heights, photo):
        array.setflags(write=False)
    photo_first = 0.5 * (1 - len(photo)) * config.photo_pixel_m
    return OrbitalMap(heights, (first, first), _mapped(source.craters, config, half), photo,
                      (photo_first, photo_first), config, source.recipe, source.name,
                      source.crs, source.origin_m)


def on_axes(values: NDArray[Any], first_m: tuple[float, float], cell_m: float, x_m: Array,
            y_m: Array) -> Array:
    """Return values of a grid at the places of columns x (n,) and rows y (m,), bilinear, (m, n).

    Args:
        first_m: (2,) place of the sample [0, 0]. Beyond the grid its border goes on.
    """
    taps = []
    for at, first, size in zip((y_m, x_m), first_m[::-1], values.shape):
        place = np.clip((at - first) / cell_m, 0.0, size - 1.0)
        low = np.minimum(place.astype(int), size - 2)
        taps.append((low, place - low))
    (row, v), (column, u) = taps
    low, high = int(column.min()), int(column.max()) + 2
    part = values[:, low:high]
    lines = (1.0 - v)[:, None] * part[row] + v[:, None] * part[row + 1]
    left = np.take(lines, column - low, axis=1)
    return left + u * (np.take(lines, column - low + 1, axis=1) - left)


def _first(n: int, cell_m: float, middle_m: tuple[float, float]) -> tuple[float, float]:
    x, y = (middle - 0.5 * (n - 1) * cell_m for middle in middle_m)
    return x, y


def _blocks(n: int) -> Iterator[tuple[slice, slice]]:
    starts = range(0, n, _BLOCK_PX)
    for row in starts:
        for column in starts:
            yield (slice(row, min(row + _BLOCK_PX, n)), slice(column, min(column + _BLOCK_PX, n)))


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
    for rows, columns in _blocks(n):
        tell(rows.start / n)
        x, y = (_sample_axis(part, n, pixel_m, samples) for part in (columns, rows))
        heights[rows, columns] = _means(source.heights(x, y), samples)
    return heights


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


def _photo(source: MappedGround, half_m: float, config: OrbitalConfig, coarse: F32,
           tell: Callable[[float], object]) -> NDArray[np.uint8]:
    """Return the photo; shadows of far relief are those of the coarse heights."""
    pixel, sun = config.photo_pixel_m, (config.sun_azimuth_deg, config.sun_elevation_deg)
    n, samples = int(2.0 * half_m / pixel + 1e-9), _samples(config.photo_pixel_m)
    cell = pixel / samples
    margin = math.ceil(_NEAR_M / cell)
    lowest = float(np.nanmin(coarse)) if np.isfinite(coarse).any() else 0.0
    sight = line_of_sight(np.nan_to_num(coarse, nan=lowest), config.pixel_m, *sun,
                          from_cells=max(_NEAR_M / config.pixel_m, 1.0))
    sight_first = 0.5 * (1 - len(coarse)) * config.pixel_m
    rocks = source.rocks(pixel)
    photo = np.empty((n, n), np.uint8)
    for rows, columns in _blocks(n):
        tell((rows.start + columns.start / n * _BLOCK_PX) / n)
        x, y = (_sample_axis(part, n, pixel, samples, margin) for part in (columns, rows))
        heights = np.asarray(source.heights(x, y), np.float32)
        known = np.isfinite(heights)
        heights[~known] = lowest
        add_domes(heights, cell, (x[0] / cell, y[0] / cell), _within(rocks, x, y))
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
        photo[rows, columns] = values
    return photo


def _within(rocks: Rocks, x_m: Array, y_m: Array) -> Rocks:
    """Return the rocks that reach into the rectangle of two axes."""
    x, y = rocks.position_m[:, :2].T
    reach = 0.5 * rocks.diameter_m
    return rocks.select((x + reach >= x_m[0]) & (x - reach <= x_m[-1])
                        & (y + reach >= y_m[0]) & (y - reach <= y_m[-1]))
