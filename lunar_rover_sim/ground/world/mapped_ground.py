"""Ground of which a map from orbit is made: of a whole site, tile by tile, or of one world."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import dataclasses
import functools
import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world import rockfield, shapes
from lunar_rover_sim.ground.world.albedo import coarse_change, far_albedo
from lunar_rover_sim.ground.world.build import Builder
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.far_rocks import far_rocks
from lunar_rover_sim.ground.world.grid import Box, box_around, HeightGrid, widened
from lunar_rover_sim.ground.world.map_projection import projected_origin
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.orbital_map import bilinear
from lunar_rover_sim.ground.world.rays import RAY_REACH
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.ground.world.spline import Area, box_of

OnAxes = Callable[[Array, Array], Array]

_CELLS = 1024           # along a side of a tile
_BORDER = 4             # samples beyond it
_AROUND_M = 64.0        # of the site, whose ground throws shadows into it


@dataclasses.dataclass(frozen=True)
class MappedGround:
    """Ground of which a map is made, in the frame of the site.

    Attributes:
        heights: Takes x (n,) and y (m,), ascending, and returns heights (m, n) [m], NaN where
            there are none, as in holes of an elevation model that are not to be filled.
        albedo: Takes the same and returns the albedo factor (m, n).
        half_extent_m: It reaches so far from the origin, in x and in y.
        craters: Takes a least diameter [m]; returns all larger craters, and perhaps smaller ones.
        rocks: Takes a least diameter [m] and a box; returns all larger rocks in it, and perhaps
            others.
        recipe, name: As of `OrbitalMap`.
        crs, origin_m: As of `OrbitalMap`.
    """

    heights: OnAxes
    albedo: OnAxes
    half_extent_m: float
    craters: Callable[[float], Craters]
    rocks: Callable[[float, Box], Rocks]
    recipe: Mapping[str, Any]
    name: str
    crs: str = ''
    origin_m: tuple[float, float] = (0.0, 0.0)

    @staticmethod
    def of(ground: World | Site, cell_m: float) -> MappedGround:
        """Return the ground of a site; of a world that is its own only window, its levels.

        Heights of a site are those over the sphere, as all its windows have them where one drives.

        Args:
            cell_m: The ground is on the coarsest cells that are not larger.

        Raises:
            WorldError: If the site cannot be built.
        """
        site = Site.of(ground) if isinstance(ground, World) else ground
        world = ground if isinstance(ground, World) else site.window(site.middle((0.0, 0.0)))
        crs, origin = projected_origin(world)
        if isinstance(site, Site):
            parts: _SiteTiles | _Levels = _SiteTiles(site, cell_m)
        else:
            parts = _Levels(world)
        return MappedGround(parts.heights, parts.albedo, parts.half_extent_m, parts.craters,
                            parts.rocks, world.config.to_mapping(), world.hash,
                            '' if crs is None else crs.to_wkt(), origin)


class _Levels:
    """One world with its coarse levels."""

    def __init__(self, world: World) -> None:
        self._world, self._last = world, world.levels[-1]
        self.half_extent_m = self._last.half_extent_m
        self._factor = far_albedo(world, len(world.levels) - 1) if len(world.levels) > 1 else None
        # Millions lie on the last level.
        self._rocks_to = functools.lru_cache(1)(self._all_rocks)

    def heights(self, x_m: Array, y_m: Array) -> Array:
        found = np.full((len(y_m), len(x_m)), np.nan)
        for level in reversed(self._world.levels):
            rows, columns = (np.abs(axis - middle) <= level.half_extent_m
                             for axis, middle in zip((y_m, x_m), level.middle_m[::-1]))
            if rows.any() and columns.any():
                found[np.ix_(rows, columns)] = on_axes(level.heights_m, _first_m(level),
                                                       level.cell_m, x_m[columns], y_m[rows])
        return found

    def albedo(self, x_m: Array, y_m: Array) -> Array:
        if self._factor is None:
            return np.ones((len(y_m), len(x_m)))
        return on_axes(self._factor, _first_m(self._last), self._last.cell_m, x_m, y_m)

    def craters(self, least_m: float) -> Craters:
        return self._world.craters

    def rocks(self, least_m: float, box: Box) -> Rocks:
        half = self._world.ground.half_extent_m
        away = max(*map(abs, box), half) + self._world.config.rocks.max_diameter_m
        reach = min(half * 2.0 ** math.ceil(math.log2(away / half)), self.half_extent_m)
        rocks = self._rocks_to(reach)
        return rocks.select(rocks.diameter_m >= least_m)

    def _all_rocks(self, reach_m: float) -> Rocks:
        far = far_rocks(self._world, reach_m)
        return self._world.rocks.joined(far) if len(far) else self._world.rocks


@dataclasses.dataclass(frozen=True)
class _Tile(Area):
    """A part of the heights or of the albedo factor of a site."""

    @property
    def first_m(self) -> tuple[float, float]:
        """Place of the first sample."""
        return self.first[0] * self.cell_m, self.first[1] * self.cell_m

    def height_at(self, xy_m: ArrayLike) -> Array:
        """Return heights [m] at (..., 2) places."""
        return bilinear(self.values, self.first_m, self.cell_m, xy_m)


class _SiteTiles:
    """All of a site, on cells of one level; tiles of two rows are in memory at a time."""

    def __init__(self, site: Site, cell_m: float) -> None:
        self._builder, self._config = Builder(site.config), site.config
        cells = self._builder.cells
        self._level = max((k for k, cell in enumerate(cells) if cell <= cell_m), default=0)
        self._cell = cells[self._level]
        self.half_extent_m = site.half_extent_m
        self._box = widened(box_around((0.0, 0.0), site.half_extent_m), _AROUND_M)
        most = 2 * (math.ceil((self._box[1] - self._box[0]) / (_CELLS * self._cell)) + 1)
        self._heights = functools.lru_cache(most)(self._heights_of)
        self._albedo = functools.lru_cache(most)(self._albedo_of)
        self._rocks = functools.lru_cache(most)(self._rocks_of)

    def heights(self, x_m: Array, y_m: Array) -> Array:
        return self._on_axes(self._heights, x_m, y_m)

    def albedo(self, x_m: Array, y_m: Array) -> Array:
        return self._on_axes(self._albedo, x_m, y_m)

    def craters(self, least_m: float) -> Craters:
        boxes = (self._box_of(place) for place in self._places(self._box))
        return Craters.join([self._builder.craters(box, least_m) for box in boxes])

    def rocks(self, least_m: float, box: Box) -> Rocks:
        return functools.reduce(Rocks.joined, (
            self._rocks(place, least_m)
            for place in self._places(widened(box, self._config.rocks.max_diameter_m))),
            rockfield.no_rocks(self._config.rocks))

    def _places(self, box: Box) -> Iterator[tuple[int, int]]:
        side = _CELLS * self._cell
        columns, rows = (range(math.floor(max(low, least) / side),
                               math.floor(min(high, most) / side) + 1)
                         for low, high, least, most in ((*box[:2], *self._box[:2]),
                                                        (*box[2:], *self._box[2:])))
        return itertools.product(columns, rows)

    def _box_of(self, place: tuple[int, int]) -> Box:
        """Return the part of the site that is a tile."""
        side = _CELLS * self._cell
        (x, y), (west, east, south, north) = place, self._box
        return (max(x * side, west), min((x + 1) * side, east), max(y * side, south),
                min((y + 1) * side, north))

    def _lattice(self, place: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return where the samples of a tile begin, and their rows and columns."""
        cell, (west, east, south, north) = self._cell, self._box_of(place)
        first = math.floor(west / cell) - _BORDER, math.floor(south / cell) - _BORDER
        return first, (math.ceil(north / cell) + _BORDER - first[1] + 1,
                       math.ceil(east / cell) + _BORDER - first[0] + 1)

    def _heights_of(self, place: tuple[int, int]) -> _Tile:
        first, shape = self._lattice(place)
        heights = self._builder.heights(self._level, first, shape)
        x, y = (np.asarray((k + np.arange(n)) * self._cell, np.float64)
                for k, n in zip(first, shape[::-1]))
        heights[~self._builder.has_ground(x, y)] = np.nan
        return _Tile(heights, first, self._cell)

    def _albedo_of(self, place: tuple[int, int]) -> _Tile:
        (first, shape), cell = self._lattice(place), self._cell
        largest = self._config.craters.max_diameter_m
        craters = self._builder.craters(
            widened(box_of(first, shape, cell), 0.5 * RAY_REACH * largest), 6.0 * cell)
        change = coarse_change(self._config, first, shape, cell, dataclasses.replace(
            craters, position_m=craters.position_m - np.multiply(first, cell)))
        return _Tile(np.float32(1.0) + change, first, cell)

    def _rocks_of(self, place: tuple[int, int], least_m: float) -> Rocks:
        config, box = self._config.rocks, self._box_of(place)
        craters = self._builder.reaching(rockfield.known_around(config, box),
                                         rockfield.least_crater_m(least_m))
        found = rockfield.population(config, self._config.seed, box, craters,
                                     self._config.clear_radius_m, least_m)
        some = found.select(rockfield.size_classes(config)[found.size] >= least_m)
        rocks = rockfield.laid(config, self._heights(place), shapes.library(), some)
        return rocks.select(np.isfinite(rocks.position_m[:, 2]))

    def _on_axes(self, made: Callable[[tuple[int, int]], _Tile], x_m: Array,
                 y_m: Array) -> Array:
        found = np.full((len(y_m), len(x_m)), np.nan)
        for place in self._places((x_m[0], x_m[-1], y_m[0], y_m[-1])):
            west, east, south, north = self._box_of(place)
            columns = (x_m >= west) & (x_m <= east)
            rows = (y_m >= south) & (y_m <= north)
            if columns.any() and rows.any():
                tile = made(place)
                found[np.ix_(rows, columns)] = on_axes(tile.values, tile.first_m, tile.cell_m,
                                                       x_m[columns], y_m[rows])
        return found


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


def _first_m(grid: HeightGrid) -> tuple[float, float]:
    return grid.box_m[0], grid.box_m[2]
