"""Building a window of a site from its recipe."""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.errors import check_argument
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world import albedo, block_means
from lunar_rover_sim.ground.world import levels as nest
from lunar_rover_sim.ground.world import rockfield, shapes, spline
from lunar_rover_sim.ground.world import tile as measured
from lunar_rover_sim.ground.world import world_folder
from lunar_rover_sim.ground.world.config import DEM, MESH, WorldConfig
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.dem import open_dem
from lunar_rover_sim.ground.world.grid import (Box, height_step_m, HeightGrid, on_lattice,
                                               round_to, widened)
from lunar_rover_sim.ground.world.levels import axis_m
from lunar_rover_sim.ground.world.mesh import MeshSource
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.raster import Raster
from lunar_rover_sim.ground.world.spline import F32
from lunar_rover_sim.ground.world.terrain import Terrain

MOON_RADIUS_M = 1_737_400.0     # of the reference sphere of LOLA (Smith et al., 2010)
_STRIP = 64                     # rows bent at once
# Sizes of craters, and how far their rocks and bright soil reach beyond their middle, in
# diameters: rims and ejecta, and rays of large ones.
_GATHERING = ((0.8, 1.6, 1.3), (1.6, 4.8, 1.3), (4.8, 12.8, 1.75), (12.8, math.inf, 3.0))

Progress = Callable[[str, float], None]


def drop_m(square_m2: ArrayLike, level_radius_m: float) -> NDArray[np.float64]:
    """Return how far the sphere lies below the plane, for squares of distances [m^2].

    Args:
        level_radius_m: Ground nearer than that to the middle is level.
    """
    beyond = np.maximum(np.asarray(square_m2, np.float64) - level_radius_m * level_radius_m, 0.0)
    return beyond / (2.0 * MOON_RADIUS_M)


def bend(heights: F32, cell_m: float, level_radius_m: float) -> None:
    """Subtract the drop from (n, n) heights over the plane; in place.

    It consists of sums, products and quotients alone, which all machines round alike. So it needs
    no lattice, on which a plain would have terraces.
    """
    square = axis_m(len(heights), cell_m)
    square *= square
    for start in range(0, len(heights), _STRIP):
        rows = slice(start, start + _STRIP)
        heights[rows] -= drop_m(square[rows, None] + square, level_radius_m).astype(np.float32)


def build_world(config: WorldConfig, seed: int = 0, progress: Progress | None = None) -> World:
    """Return the world that the parameters describe: the window around the origin of its site.

    Args:
        seed: Used if `config.seed` is -1; the config of the world then has it. The same parameters
            and seed give the same world on one machine.
        progress: Called with the name of the present step and the fraction done so far.

    Raises:
        ConfigError: If the seed is not valid.
        WorldError: If the source cannot be read or used.
    """
    check_argument('config', config, WorldConfig, 'a WorldConfig (Scenario.world)')
    builder = Builder(config.with_seed(seed))
    try:
        return builder.window((0.0, 0.0), progress)
    finally:
        builder.close()


class Builder:
    """Builds windows of one site; it keeps what neighbouring ones share."""

    def __init__(self, config: WorldConfig) -> None:
        """Open the source.

        Args:
            config: Its seed is set.

        Raises:
            WorldError: If the source cannot be read or used.
        """
        self.config = config
        self.source: measured.Source | None = None
        if config.source == DEM:
            self.source = open_dem(config)
        elif config.source == MESH:
            self.source = MeshSource(config)
        self._terrain = Terrain(config, self.source)
        self._origin_m: float | None = None
        self._bright_last: spline.Area | None = None

    def close(self) -> None:
        """Close the source."""
        if self.source is not None:
            self.source.close()
            self.source = None

    def window(self, middle_m: tuple[float, float], progress: Progress | None = None) -> World:
        """Return the window around a place.

        The fine ground, its rocks and its albedo are the same, bit by bit, in all windows; but the
        outermost samples of the ground are those of the next level, and the albedo fades to 1 in
        the last 60 cells. Coarse levels show the finer ones within them, fade into each other in
        the last 60 cells, and fall off with the sphere from the middle of the window.

        Args:
            middle_m: A multiple of the cells of the first coarse level.

        Raises:
            WorldError: If the source lacks heights there.
        """
        tell = progress or (lambda what, fraction: None)
        config = self.config
        if self.source is not None and middle_m != (0.0, 0.0):
            self.source.check_window(middle_m)
        arrays = self._terrain.levels(middle_m, tell)
        for heights, cell in zip(arrays, self.cells):
            self._over_origin(heights, cell)
        report = dict(self.source.report) if self.source is not None else {}
        report['recipe'] = world_folder.RECIPE
        report['origin_height_m'] = self._height_of_origin() + (
            self.source.reference_m if self.source is not None else 0.0)
        tell('albedo and rocks', 0.85)
        drawn = self._terrain.catalogue(middle_m)
        arrays[0].setflags(write=False)
        ground = HeightGrid(arrays[0], config.cell_m, middle_m)
        library = shapes.library()
        around = rockfield.known_around(config.rocks, widened(
            ground.box_m, config.rocks.max_diameter_m))
        rocks, all_rocks = rockfield.scatter(config.rocks, config.seed, ground, library,
                                             self.reaching(around), config.clear_radius_m)
        ground = rockfield.fillets(config.rocks, ground, all_rocks)
        light = albedo.fine_albedo(self._albedo_change(ground))
        levels = self._nested([ground.heights_m.copy(), *arrays[1:]], middle_m)
        tell('hash', 0.95)
        world = world_folder.sealed(World(levels, light, rocks, library, config, '', drawn,
                                          report))
        tell('done', 1.0)
        return world

    def _albedo_change(self, ground: HeightGrid) -> F32:
        """Return by how much the albedo of the fine ground differs from 1."""
        def make(first: tuple[int, int], shape: tuple[int, int]) -> F32:
            box = spline.box_of(first, shape, ground.cell_m)
            return albedo.fine_change(self.config, first, shape, self._bright(box))

        first = round(ground.first[0]), round(ground.first[1])
        change = spline.extended(self._bright_last, first, (ground.n, ground.n), make)
        self._bright_last = spline.Area(change, first, ground.cell_m)
        return change

    def _height_of_origin(self) -> float:
        """Return the height of the origin over the source's reference."""
        if self._origin_m is None:
            height = float(self._terrain.rectangle(0, (0, 0), (1, 1))[0, 0])
            self._origin_m = float(on_lattice(height, height_step_m(self.config.cell_m)))
        return self._origin_m

    @property
    def cells(self) -> list[float]:
        """Cells of the levels of the site [m], finest first."""
        return self._terrain.cells

    def heights(self, k: int, first: tuple[int, int], shape: tuple[int, int]) -> F32:
        """Return heights of a level on a rectangle, which may be of any place and size [m].

        They are over the sphere, without soil at the feet of rocks.

        Args:
            first: Column and row at which it begins, on the lattice of the level.
            shape: Its rows and columns.

        Raises:
            WorldError: If the source cannot be read.
        """
        return self._over_origin(self._terrain.rectangle(k, first, shape), self.cells[k])

    def has_ground(self, x_m: Array, y_m: Array) -> NDArray[np.bool_]:
        """Return where windows can be made as far as the ground itself goes: it has no hole.

        Args:
            x_m, y_m: (n,) and (m,), ascending, evenly spaced.

        Returns:
            (m, n). Holes that are filled are none.
        """
        filled = self.config.dem.nodata if isinstance(self.source, Raster) else (
            self.config.mesh.holes)
        if self.source is None or filled == 'fill':
            return np.ones((len(y_m), len(x_m)), bool)
        return self.source.has_data(x_m, y_m)

    def craters(self, box: Box, least_m: float) -> Craters:
        """Return the craters of a least diameter whose centres lie in a box."""
        return self._terrain.craters.within(box, least_m)

    def reaching(self, box: Box, least_m: float = 0.0) -> Craters:
        """Return the craters of a least diameter around which rocks of a box may gather."""
        return Craters.join([self._terrain.craters.within(widened(
            box, reach * min(high, self.config.craters.max_diameter_m)), max(low, least_m), high)
            for low, high, reach in _GATHERING if high > least_m])

    def _over_origin(self, heights: F32, cell_m: float) -> F32:
        """Return heights over that of the origin, on their lattice; in place."""
        heights -= np.float32(self._height_of_origin())
        round_to(heights, height_step_m(cell_m))
        return heights

    def _bright(self, box: Box) -> Craters:
        """Return the craters whose bright soil reaches a box, and large ones of its blocks."""
        blocks = block_means.box_of(block_means.field_for(box))
        large, largest = albedo.BLOCK_CRATER_M, self.config.craters.max_diameter_m
        return Craters.join([
            self._terrain.craters.within(widened(box, 1.75 * large), 6.0 * self.config.cell_m,
                                         large),
            self._terrain.craters.within(widened(blocks, 1.75 * largest), large)])

    def _nested(self, arrays: list[F32],
                middle_m: tuple[float, float]) -> tuple[HeightGrid, ...]:
        """Return the finished levels: on the sphere, without seams.

        Each level shows the finer one within it.
        """
        cells = [cell for _, cell in self._terrain.plan]
        for k in range(len(arrays) - 2, 0, -1):
            nest.fit_border(arrays[k], cells[k], HeightGrid(arrays[k + 1], cells[k + 1]))
            round_to(arrays[k], height_step_m(cells[k]))
        for heights, cell in zip(arrays[1:], cells[1:]):
            bend(heights, cell, math.sqrt(0.5) * self.config.size_m)
        for k in range(1, len(arrays)):
            nest.embed(arrays[k], arrays[k - 1])
        for k in range(len(arrays) - 2, -1, -1):
            nest.close_seam(arrays[k], cells[k], HeightGrid(arrays[k + 1], cells[k + 1]))
        for heights in arrays:
            heights.setflags(write=False)
        return tuple(HeightGrid(heights, cell, middle_m) for heights, cell in zip(arrays, cells))
