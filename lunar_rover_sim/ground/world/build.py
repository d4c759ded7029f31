"""Building a world from its parameters."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import logging
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
import scipy.ndimage

from lunar_rover_sim.base.arguments import check_argument
from lunar_rover_sim.ground.world import levels as nest
from lunar_rover_sim.ground.world import relief, rockfield, shapes, stamping
from lunar_rover_sim.ground.world import tile as measured
from lunar_rover_sim.ground.world import world_folder
from lunar_rover_sim.ground.world.config import DEM, MESH, WorldConfig
from lunar_rover_sim.ground.world.craters import Craters, keep_clear, populate, survivors
from lunar_rover_sim.ground.world.dem import open_dem
from lunar_rover_sim.ground.world.grid import (ALBEDO_STEP, height_step_m, HeightGrid, on_lattice,
                                               round_to)
from lunar_rover_sim.ground.world.levels import axis_m
from lunar_rover_sim.ground.world.mesh import MeshSource
from lunar_rover_sim.ground.world.model import World

MOON_RADIUS_M = 1_737_400.0     # of the reference sphere of LOLA (Smith et al., 2010)
_STRIP = 64                     # rows bent at once


def drop_m(square_m2: ArrayLike, level_radius_m: float) -> NDArray[np.float64]:
    """Return how far the sphere lies below the plane, for squares of distances [m^2].

    Args:
        level_radius_m: Ground nearer than that to the origin is level.
    """
    beyond = np.maximum(np.asarray(square_m2, np.float64) - level_radius_m * level_radius_m, 0.0)
    return beyond / (2.0 * MOON_RADIUS_M)


def bend(heights: NDArray[np.float32], cell_m: float, level_radius_m: float) -> None:
    """Subtract the drop from (n, n) heights over the plane; in place.

    It consists of sums, products and quotients alone, which all machines round alike. So it needs
    no lattice, on which a plain would have terraces.
    """
    square = axis_m(len(heights), cell_m)
    square *= square
    for start in range(0, len(heights), _STRIP):
        rows = slice(start, start + _STRIP)
        heights[rows] -= drop_m(square[rows, None] + square, level_radius_m).astype(np.float32)


logger = logging.getLogger(__name__)

Progress = Callable[[str, float], None]

# Cells along the diameter of a crater: the least that a level makes itself; below the second
# number a crater is left to the finer level; the least on the finest level.
_RESOLVED_CELLS, _FULL_CELLS, _LEAST_CELLS = 8.0, 24.0, 6.0


def build_world(config: WorldConfig, seed: int = 0, progress: Progress | None = None) -> World:
    """Return the world that the parameters describe.

    Args:
        seed: Used if `config.seed` is -1; the config of the world then has it. The same parameters
            and seed give the same world on one machine.
        progress: Called with the name of the present step and the fraction done so far.

    Raises:
        ConfigError: If the seed is not valid.
        WorldError: If the source cannot be read or used.
    """
    check_argument('config', config, WorldConfig, 'a WorldConfig (Scenario.world)')
    config = config.with_seed(seed)
    tell = progress or (lambda what, fraction: None)
    source = _open(config)
    try:
        builder = _Builder(config, source, tell)
        grids = builder.levels()
    finally:
        if source is not None:
            source.close()
    tell('albedo and rocks', 0.85)
    drawn = Craters.join(builder.drawn)
    albedo = _albedo(config, drawn, builder.rng('albedo'))
    library = shapes.library()
    rocks = rockfield.scatter(config.rocks, grids[0], library, drawn, config.clear_radius_m,
                              builder.rng('rocks'))
    grids = _shown(rockfield.fillets(config.rocks, grids[0], rocks, builder.rng('fillets')),
                   grids[1:])
    tell('hash', 0.95)
    world = world_folder.sealed(World(grids, albedo, rocks, library, config, '', drawn,
                                      builder.report))
    tell('done', 1.0)
    return world


def _shown(ground: HeightGrid, coarser: tuple[HeightGrid, ...]) -> tuple[HeightGrid, ...]:
    """Return ground and coarser levels, which show its heights."""
    levels = [ground]
    for level in coarser:
        heights = level.heights_m.copy()
        nest.embed(heights, levels[-1].heights_m)
        heights.setflags(write=False)
        levels.append(HeightGrid(heights, level.cell_m))
    return tuple(levels)


def _open(config: WorldConfig) -> measured.Source | None:
    if config.source == DEM:
        return open_dem(config)
    if config.source == MESH:
        return MeshSource(config)
    return None


class _Builder:
    """Builds the levels from the coarsest to the finest, then closes the seams."""

    def __init__(self, config: WorldConfig, source: measured.Source | None,
                 tell: Progress) -> None:
        self.config = config
        self.source = source
        self.tell = tell
        self.plan = nest.plan(config)
        self.spectrum = relief.spectrum(config.relief)
        self.drawn: list[Craters] = []
        self.report: dict = dict(source.report) if source is not None else {}

    def rng(self, purpose: str) -> np.random.Generator:
        """Return a generator that depends on the seed and the purpose only."""
        return np.random.default_rng([self.config.seed, *purpose.encode()])

    def levels(self) -> tuple[HeightGrid, ...]:
        """Return all levels, finest first."""
        deferred = Craters.join([])
        finished: list[tuple[NDArray[np.float32], float]] = []
        parent: HeightGrid | None = None
        for k in reversed(range(len(self.plan))):
            n, cell = self.plan[k]
            self.tell(f'relief at {cell:g} m', 0.8 * (1 - (k + 1) / len(self.plan)))
            here, deferred = self._craters(k, deferred)
            self.drawn.append(here)
            heights = self._level(k, parent, here)
            parent = HeightGrid(heights, cell)
            finished.append((heights, cell))
        return self._sealed(finished[::-1])

    def _level(self, k: int, parent: HeightGrid | None, craters: Craters) -> NDArray[np.float32]:
        """Return the heights of one level: large shape, craters, relief, measured terrain."""
        n, cell = self.plan[k]
        keep = 0.5 * self.config.size_m
        detail = relief.synthesise(self.spectrum, n, cell, parent.cell_m if parent else None,
                                   k == 0, self.rng(f'relief {k}'))
        heights = detail if parent is None else nest.refine(parent, n, cell)
        tile = self.source.tile(0.5 * (n - 1) * cell, cell) if self.source is not None else None
        refined = self._refined(k)
        if tile is not None and refined and not self._refined(k + 1):
            measured.lay(heights, cell, tile, keep)
        stamping.stamp(heights, cell, craters, self.config.craters, self.rng(f'outlines {k}'))
        # The relief of the largest scales is older than the craters. That of the others has formed
        # in the soil since, and lies on top.
        if parent is not None:
            heights += detail
        elif tile is not None and refined:
            # Relief below the scale of the measured terrain, which has replaced the rest.
            heights += relief.synthesise(self.spectrum, n, cell,
                                         2.0 * tile.pixel_m / relief.SPLIT_CELLS, k == 0,
                                         self.rng('relief below the source'))
        if tile is not None and refined:
            measured.restore(heights, cell, tile, keep)
        elif tile is not None:
            measured.lay(heights, cell, tile, keep)
        if parent is not None:
            nest.fit_border(heights, cell, parent)
        return heights

    def _refined(self, k: int) -> bool:
        """Return whether a level adds detail to measured heights instead of averaging them."""
        return (self.source is not None and k < len(self.plan)
                and self.plan[k][1] < measured.REFINED_BELOW * self.source.pixel_m)

    def _craters(self, k: int, deferred: Craters) -> tuple[Craters, Craters]:
        """Return the craters drawn on level k, and those left to the next finer level.

        Each level makes the sizes that it resolves and its parent does not. A crater that would
        be coarse here and lies completely within the finer level is left to that one.
        """
        n, cell = self.plan[k]
        config = self.config.craters
        half = 0.5 * (n - 1) * cell
        last = k == len(self.plan) - 1
        low = _RESOLVED_CELLS * cell if k else _LEAST_CELLS * cell
        high = np.inf if last else _RESOLVED_CELLS * self.plan[k + 1][1]
        made = populate(config, half, low, high, k, self.rng(f'craters {k}'))
        if self.source is not None:
            made = measured.below_its_scale(made, self.source)
        made = keep_clear(made, config, self.config.clear_radius_m)
        made = survivors(made, Craters.join(self.drawn + [deferred]))
        made = Craters.join([deferred, made])
        if k == 0:
            return made, Craters.join([])
        inner_n, inner_cell = self.plan[k - 1]
        inner = 0.5 * (inner_n - 1) * inner_cell - nest.FADE_CELLS * inner_cell
        reach = np.abs(made.position_m).max(axis=1, initial=0.0) + 1.3 * made.diameter_m
        finer = (reach < inner) & (made.diameter_m < _FULL_CELLS * cell)
        left = made.select(finer)
        return made.select(~finer), dataclasses.replace(left, level=left.level - 1)

    def _sealed(self, arrays: list[tuple[NDArray[np.float32], float]]) -> tuple[HeightGrid, ...]:
        """Return the finished levels: origin at height 0, on the sphere, without seams.

        Each level shows the finer one within it.
        """
        offset = float(on_lattice(HeightGrid(*arrays[0]).height_at((0.0, 0.0)),
                                  height_step_m(arrays[0][1])))
        reference = self.source.reference_m if self.source is not None else 0.0
        self.report['origin_height_m'] = reference + offset
        for heights, cell in arrays:
            heights -= np.float32(offset)
            round_to(heights, height_step_m(cell))
        for heights, cell in arrays[1:]:
            bend(heights, cell, math.sqrt(0.5) * self.config.size_m)
        for (child, cell), parent in zip(arrays[-2::-1], arrays[::-1]):
            nest.close_seam(child, cell, HeightGrid(*parent))
        for (child, _), (heights, _) in zip(arrays, arrays[1:]):
            nest.embed(heights, child)
        for heights, _ in arrays:
            heights.setflags(write=False)
        return tuple(HeightGrid(heights, cell) for heights, cell in arrays)


def _albedo(config: WorldConfig, craters: Craters,
            rng: np.random.Generator) -> NDArray[np.float32]:
    """Return the albedo factor on the samples of the ground, 1 on average and at the border."""
    n, cell = config.samples, config.cell_m
    variation = np.zeros((n, n), np.float32)
    if config.albedo.variation > 0.0:
        # Patches from 3 dm to several metres; smaller ones are fainter.
        for wavelength, part in ((6.4, 0.75), (1.6, 0.55), (0.4, 0.35)):
            sigma = min(wavelength / 4.0 / cell, n / 8.0)
            coarse = max(int(sigma / 2.0), 1)
            small = rng.standard_normal((n // coarse + 3,) * 2)
            small = on_lattice(scipy.ndimage.gaussian_filter(small, sigma / coarse, mode='wrap'),
                               2.0**-20)
            axis = np.arange(small.shape[0]) * float(coarse)
            fine = nest.spline(axis, axis, small, np.arange(n, dtype=float),
                               np.arange(n, dtype=float))
            spread = np.std(fine, dtype=np.float64)
            variation += np.float32(on_lattice(part / spread, 2.0**-16)) * fine
        variation *= np.float32(config.albedo.variation)
    if config.albedo.grain > 0.0:
        # Uniform, not normal: exact on every machine, and of the same RMS.
        grain = rng.random((n, n), np.float32)
        grain -= np.float32(0.5)
        grain *= np.float32(config.albedo.grain * math.sqrt(12.0))
        variation += grain
    if config.albedo.fresh_crater > 0.0:
        stamping.brighten(variation, cell, craters, config.albedo.fresh_crater)
    variation -= np.float32(on_lattice(np.mean(variation, dtype=np.float64), ALBEDO_STEP))
    edge = nest.fade(n)
    variation *= edge[:, None] * edge
    albedo = np.clip(1.0 + variation, 0.4, 1.8, dtype=np.float32)
    round_to(albedo, ALBEDO_STEP)
    albedo.setflags(write=False)
    return albedo
