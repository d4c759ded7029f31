"""Maps as from orbit: heights and an orthophoto as GeoTIFF, rocks and craters.

Pixels are means over their area. Errors are drawn once with a seed: heights are off by noise that
is smooth over some pixels, as that of stereo from orbit, and the whole map is shifted.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
import scipy.ndimage

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz
from lunar_rover_sim.ground.world.map_projection import projected_origin
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.orbital_map import write_tif
from lunar_rover_sim.ground.world.shade import shaded, with_rocks

HEIGHTS, PHOTO = 'heights', 'photo'
SUFFIXES = ('.tif', '.tiff', '.geojson')
_SMOOTH_PX = 2.0            # over which errors of height are alike
_LEAST_PIXELS = 4


@dataclasses.dataclass(frozen=True)
class OrbitalErrors:
    """Errors of a map from orbit.

    Attributes:
        height_m: Standard deviation of the heights [m].
        shift_m: Standard deviation of the shift of the whole map, in x and in y [m].
        noise: Standard deviation of the brightness of the photo, as a share of full scale.
        seed: Of what is drawn.
    """

    height_m: float = 0.0
    shift_m: float = 0.0
    noise: float = 0.0
    seed: int = 1


def write_map(world: World, path: Path, resolution_m: float, what: str = HEIGHTS,
              errors: OrbitalErrors = OrbitalErrors(),
              sun_deg: tuple[float, float] = (60.0, 6.0)) -> None:
    """Write heights [m, float32] or a photo (8 bits) of the fine ground as GeoTIFF.

    The CRS is that of the elevation model that the world was made of; other worlds have none, and
    coordinates are metres east and north of the origin.

    Args:
        what: heights or photo, with rocks.
        sun_deg: Azimuth from east towards north and elevation of the sun of the photo.

    Raises:
        WorldError: If the resolution is not valid, or the file cannot be written.
    """
    world = world.local()
    ground = world.ground
    factor = round(resolution_m / ground.cell_m)
    pixels = (ground.n - 1) // factor if factor else 0
    if pixels < _LEAST_PIXELS:
        raise WorldError(
            f'--resolution: {resolution_m:g} is not valid; valid is {ground.cell_m:g} to '
            f'{2 * ground.half_extent_m / _LEAST_PIXELS:g} [m] for this world')
    rng = np.random.default_rng([errors.seed, 49])
    shift = errors.shift_m * rng.standard_normal(2)
    heights = with_rocks(world)
    if what == PHOTO:
        values = world.albedo * shaded(heights, ground.cell_m, *sun_deg)
        picture = _means(np.clip(values, 0.0, None), factor, pixels)
        white = float(np.percentile(picture, 99.5)) or 1.0
        picture = picture / white + errors.noise * rng.standard_normal(picture.shape)
        data: NDArray[Any] = np.clip(230.0 * picture, 0.0, 255.0).round().astype(np.uint8)
    else:
        data = _means(heights, factor, pixels)
        if errors.height_m:
            rough = scipy.ndimage.gaussian_filter(rng.standard_normal(data.shape), _SMOOTH_PX)
            data = data + errors.height_m * rough / rough.std()
        data = data.astype(np.float32)
    size = factor * ground.cell_m
    crs, origin = projected_origin(world)
    x, y = np.add(origin, shift) - 0.5 * (pixels - 1) * size
    tags = {'resolution_m': f'{size:g}', 'world_hash': world.hash, 'what': what,
            'shift_m': f'{shift[0]:.3f} {shift[1]:.3f}', 'height_error_m': f'{errors.height_m:g}'}
    write_tif(path, data, (float(x), float(y)), size, crs, tags)


def _means(values: NDArray[Any], factor: int, pixels: int) -> Array:
    """Return the means over square pixels around the middle, row 0 south."""
    used = factor * pixels
    first = (values.shape[0] - used) // 2
    inside = values[first:first + used, first:first + used].astype(float)
    return inside.reshape(pixels, factor, pixels, factor).mean(axis=(1, 3))


def write_features(world: World, path: Path, least_rock_m: float = 0.1,
                   least_crater_m: float = 0.5) -> int:
    """Write rocks and craters as GeoJSON points; return how many.

    Coordinates are those of `write_map`. Properties: `kind`, `diameter_m`, of rocks `top_m` (how
    far they rise over the ground), of craters `age` (0 fresh to 1).

    Raises:
        WorldError: If the file cannot be written.
    """
    world = world.local()
    crs, origin = projected_origin(world)
    rocks, craters, half = world.rocks, world.craters, world.ground.half_extent_m
    features = []

    def add(kind: str, xy: Array, **properties: float) -> None:
        place = [round(float(v) + o, 3) for v, o in zip(xy, origin)]
        features.append({'type': 'Feature',
                         'geometry': {'type': 'Point', 'coordinates': place},
                         'properties': {'kind': kind, **{name: round(float(value), 3)
                                                         for name, value in properties.items()}}})

    for k in np.flatnonzero(rocks.diameter_m >= least_rock_m):
        vertices = world.rock_shapes[int(rocks.shape[k])].vertices
        height = vertices @ matrix_from_wxyz(rocks.orientation_wxyz[k])[2] * rocks.diameter_m[k]
        position = rocks.position_m[k]
        ground = world.ground.height_at_point(float(position[0]), float(position[1]))
        add('rock', position[:2], diameter_m=rocks.diameter_m[k],
            top_m=position[2] + height.max() - ground)
    inside = np.abs(craters.position_m).max(axis=1, initial=0.0) <= half
    for k in np.flatnonzero(inside & (craters.diameter_m >= least_crater_m)):
        add('crater', craters.position_m[k], diameter_m=craters.diameter_m[k],
            age=craters.age[k])
    document = {'type': 'FeatureCollection', 'features': features, 'world_hash': world.hash,
                'coordinates': ('metres east and north of the origin' if crs is None
                                else f'metres in {crs.to_string()}')}
    atomic_write(path, json.dumps(document) + '\n', WorldError)
    return len(features)
