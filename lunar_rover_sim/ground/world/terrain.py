"""Heights of a site: relief, craters and measured terrain, at any place, the same in all windows.

Levels form a chain without borders. A level is the spline through the next coarser one, with
craters of its sizes drawn into it and relief of its wavelengths on top. The chain goes on until a
level holds the longest wavelength. What a window shows of its coarse levels has smaller craters
too, which the finer levels of the chain draw better.
"""

from __future__ import annotations

import math

import numpy as np

from lunar_rover_sim.ground.world import levels as nest
from lunar_rover_sim.ground.world import spline, stamping, tile
from lunar_rover_sim.ground.world.config import LEVEL_RATIO, WorldConfig
from lunar_rover_sim.ground.world.crater_field import CraterField
from lunar_rover_sim.ground.world.craters import Craters, REACH
from lunar_rover_sim.ground.world.grid import Box, box_around, height_step_m, round_to, widened
from lunar_rover_sim.ground.world.relief import Relief, SPLIT_CELLS
from lunar_rover_sim.ground.world.spline import Area, F32

# Cells along the diameter of a crater: the least that the finest level draws, that a window shows
# on a coarse one, and that the chain draws, which leaves smaller ones to the finer level.
LEAST_CELLS, SHOWN_CELLS, CHAIN_CELLS = 6.0, 8.0, 24.0
_MEASURED_CELLS = 2.0       # of craters that count in the means over pixels
_RESTORED_CELLS = 8.0       # least cells of a pixel on the level that restores its mean
_MOST_LEVELS = 12


class Terrain:
    """The heights of a site, over a plane.

    What the next window shares with the last one is kept: relief, and heights that depend on their
    place alone.
    """

    def __init__(self, config: WorldConfig, source: tile.Source | None = None) -> None:
        """Take the recipe, whose seed is set."""
        self.config, self.source = config, source
        self.craters = CraterField(config.craters, config.seed, config.clear_radius_m, source)
        self._relief = Relief(config.relief, config.seed)
        self.plan = nest.plan(config)
        self.cells = [cell for _, cell in self.plan]
        while self._goes_on():
            self.cells.append(LEVEL_RATIO * self.cells[-1])
        pixel = source.pixel_m if source is not None else 0.0
        # The coarsest level that adds detail to measured heights, and the one that then restores
        # their means; -1 if the cells are not fine enough.
        self._refined = max((k for k, cell in enumerate(self.cells)
                             if cell < tile.REFINED_BELOW * pixel), default=-1)
        self._restored = max((k for k in range(self._refined + 1)
                              if _RESTORED_CELLS * self.cells[k] <= pixel), default=0)
        if self._refined < 0:
            self._restored = -1
        self._shown_last: dict[int, Area] = {}
        # Whether the heights of `_ground` depend on their place alone, whatever the area: those
        # made last, and those of the chain by their level. Beyond measured ground, and in filled
        # gaps of it, they do not.
        self._of_place = self._covered = True
        self._chain_of_place: dict[int, bool] = {}

    def _goes_on(self) -> bool:
        cell = self.cells[-1]
        longest = math.sqrt(2.0) * self.config.relief.longest_wavelength_m
        pixel = self.source.pixel_m if self.source is not None else 0.0
        return len(self.cells) < _MOST_LEVELS and (
            SPLIT_CELLS * cell < longest or cell < tile.REFINED_BELOW * pixel)

    def levels(self, middle_m: tuple[float, float], tell) -> list[F32]:  # type: ignore
        """Return the heights of a window's levels, finest first."""
        boxes = [self._box(k, middle_m) for k in range(len(self.plan))]
        chain = self._chain(dict(enumerate(boxes)))
        shown = []
        for k in reversed(range(len(self.plan))):
            tell(f'relief at {self.cells[k]:g} m', 0.8 * (1 - (k + 1) / len(self.plan)))
            shown.append(self._shown(k, middle_m, chain))
        return shown[::-1]

    def rectangle(self, k: int, first: tuple[int, int], shape: tuple[int, int]) -> F32:
        """Return the heights of a level on a rectangle of its lattice."""
        chain = self._chain({k: spline.box_of(first, shape, self.cells[k])})
        return self._ground(k, first, shape, chain.get(k + 1), SHOWN_CELLS if k else LEAST_CELLS)

    def catalogue(self, middle_m: tuple[float, float]) -> Craters:
        """Return the craters that reach a window, with the level on which each is drawn."""
        found: list[Craters] = []
        for k, cell in enumerate(self.cells[:len(self.plan)]):
            last = k == len(self.plan) - 1
            low = SHOWN_CELLS * cell if k else LEAST_CELLS * cell
            high = math.inf if last else SHOWN_CELLS * LEVEL_RATIO * cell
            # Ejecta reach two diameters.
            box = widened(self._box(k, middle_m),
                          2.0 * min(high, self.config.craters.max_diameter_m))
            here = self.craters.within(box, low, high)
            beyond = np.abs(here.position_m - middle_m).max(axis=1, initial=0.0)
            half = 0.5 * (self.plan[k][0] - 1) * cell
            here = here.select(beyond <= half + 2.0 * here.diameter_m)
            level = np.full(len(here), k, np.int32)
            if k:
                n, inner_cell = self.plan[k - 1]
                inner = 0.5 * (n - 1) * inner_cell
                reach = (np.abs(here.position_m - middle_m).max(axis=1, initial=0.0)
                         + 1.3 * here.diameter_m)
                level[(reach < inner) & (here.diameter_m < CHAIN_CELLS * cell)] -= 1
            found.append(Craters(here.position_m, here.diameter_m, here.age, level, here.key))
        return Craters.join(found)

    def _box(self, k: int, middle_m: tuple[float, float]) -> Box:
        n, cell = self.plan[k]
        return box_around(middle_m, 0.5 * (n - 1) * cell)

    def _margin_m(self, k: int) -> float:
        """Return how far beyond an area of a level its ground depends on the next coarser one."""
        return (stamping.plane_margin_m(self._largest_m(k))
                + 2 * stamping.COARSER * self.cells[k])

    def _largest_m(self, k: int) -> float:
        """Return the diameter of the largest crater that a level draws."""
        top = k == len(self.cells) - 1
        largest = self.config.craters.max_diameter_m
        return largest if top else min(largest, CHAIN_CELLS * self.cells[k + 1])

    def _chain(self, boxes: dict[int, Box]) -> dict[int, Area]:
        """Return the chain above the finest of some levels, as far as these need it.

        Args:
            boxes: Where heights of a level are wanted, by its number.
        """
        wanted: dict[int, Box] = {}
        for k in range(min(boxes) + 1, len(self.cells)):
            below = [some[k - 1] for some in (wanted, boxes) if k - 1 in some]
            west, east, south, north = zip(*below)
            wanted[k] = widened(
                widened((min(west), max(east), min(south), max(north)),
                        self._margin_m(k - 1) + self._pixels_m(k - 1)),
                (spline.MARGIN + 2) * self.cells[k])
        chain: dict[int, Area] = {}
        for k in sorted(wanted, reverse=True):
            first, shape = _lattice(wanted[k], self.cells[k])
            heights = self._ground(k, first, shape, chain.get(k + 1), CHAIN_CELLS)
            chain[k] = Area(heights, first, self.cells[k])
            self._chain_of_place[k] = self._of_place
        return chain

    def _shown(self, k: int, middle_m: tuple[float, float], chain: dict[int, Area]) -> F32:
        """Return the (n, n) heights that a window shows of a level."""
        n, cell = self.plan[k]
        least = SHOWN_CELLS if k else LEAST_CELLS
        place = [m / cell - 0.5 * (n - 1) for m in middle_m]
        whole = [round(p) for p in place]
        if max(abs(p - w) for p, w in zip(place, whole)) < 1e-6:
            return self._continued(k, (whole[0], whole[1]), chain.get(k + 1), least)
        # The cell is wider than the step of windows: between the samples of the lattice.
        margin = spline.MARGIN
        begin = [math.floor(p) - margin for p in place]
        heights = self._ground(k, (begin[0], begin[1]), (n + 2 * margin + 1,) * 2,
                               chain.get(k + 1), least)
        columns, rows = (p - f - spline.TAPS + np.arange(n, dtype=float)
                         for p, f in zip(place, begin))
        return spline.evaluated(spline.coefficients(heights), columns, rows)

    def _continued(self, k: int, first: tuple[int, int], parent: Area | None,
                   least_cells: float) -> F32:
        """Return the (n, n) heights of a level that begins there; what the last window had stays.
        """
        n, cell = self.plan[k]
        # Averages of pixels may depend on what is read with them.
        of_place = [self.source is None or cell < 2.0 * self.source.pixel_m]

        def make(first: tuple[int, int], shape: tuple[int, int]) -> F32:
            heights = self._ground(k, first, shape, parent, least_cells)
            of_place.append(self._of_place)
            return heights

        known = self._shown_last.pop(k, None)
        heights = spline.extended(known, first, (n, n), make)
        if not all(of_place):
            return heights if known is None else make(first, (n, n))
        self._shown_last[k] = Area(heights, first, cell)
        return heights.copy()

    def _ground(self, k: int, first: tuple[int, int], shape: tuple[int, int],
                parent: Area | None, least_cells: float) -> F32:
        """Return heights of a level with craters of so many cells or more."""
        cell, self._covered = self.cells[k], True
        if k == self._restored:
            border = math.ceil(self._pixels_m(k) / cell)
            outer = (first[0] - border, first[1] - border)
            size = (shape[0] + 2 * border, shape[1] + 2 * border)
            heights = self._added(k, outer, size, parent, least_cells)
            measured = (heights if least_cells <= SHOWN_CELLS else
                        self._added(k, outer, size, parent, _MEASURED_CELLS))
            found = self._tile(k, outer, size)
            if found is not None:
                heights += tile.correction(Area(measured, outer, cell), found)
            heights = heights[border:-border, border:-border]
        else:
            heights = self._added(k, first, shape, parent, least_cells)
        if k > self._refined and self.source is not None:
            found = self._tile(k, first, shape)
            self._covered &= found is not None and tile.lay(Area(heights, first, cell), found)
        self._of_place = self._covered and (
            (self.source is not None and k >= self._refined)
            or self._chain_of_place.get(k + 1, True))
        heights = np.ascontiguousarray(heights)
        round_to(heights, height_step_m(cell))
        return heights

    def _added(self, k: int, first: tuple[int, int], shape: tuple[int, int],
               parent: Area | None, least_cells: float) -> F32:
        """Return large shape, craters and relief of a level."""
        cell, largest = self.cells[k], self._largest_m(k)
        ground = Area(self._base(k, first, shape, parent, 1), first, cell)
        box = spline.box_of(first, shape, cell)
        wide = widened(box, stamping.plane_margin_m(largest))
        near = widened(box, 0.5 * REACH * largest + cell)
        craters = Craters.join([
            self.craters.within(wide, max(least_cells, stamping.FLATTENED_CELLS) * cell, largest),
            self.craters.within(near, least_cells * cell,
                                min(stamping.FLATTENED_CELLS * cell, largest))])
        if len(craters):
            ratio = stamping.COARSER
            begin, size = _lattice(wide, ratio * cell)
            coarse = Area(self._base(k, begin, size, parent, ratio), begin, ratio * cell)
            stamping.stamp(ground, craters, self.config.craters, coarse)
        # The relief of the largest scales is older than the craters. That of the others has formed
        # in the soil since, and lies on top.
        parent_cell = self.cells[k + 1] if k + 1 < len(self.cells) else None
        heights = ground.values
        heights += self._relief.detail(k, cell, parent_cell, first, shape)
        return heights

    def _base(self, k: int, first: tuple[int, int], shape: tuple[int, int],
              parent: Area | None, ratio: int) -> F32:
        """Return the ground of a level before its craters, on every `ratio`-th of its samples."""
        if parent is None:
            base = np.zeros(shape, np.float32)
        else:
            base = spline.refined(parent, first, shape, LEVEL_RATIO // ratio)
        if k == self._refined and self.source is not None:
            found = self._tile(k, first, shape, ratio)
            self._covered &= found is not None and tile.lay(
                Area(base, first, ratio * self.cells[k]), found)
        return base

    def _tile(self, k: int, first: tuple[int, int], shape: tuple[int, int],
              ratio: int = 1) -> tile.Tile | None:
        """Return the measured heights of an area of a level."""
        assert self.source is not None
        found = self.source.tile(spline.box_of(first, shape, ratio * self.cells[k]),
                                 self.cells[k])
        self._covered &= found is not None and not found.filled
        return found

    def _pixels_m(self, k: int) -> float:
        """Return how far beyond an area a level needs means over pixels."""
        if k != self._restored or self.source is None:
            return 0.0
        return tile.CORRECTION_PIXELS * self.source.pixel_m


def _lattice(box: Box, cell_m: float) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return where the samples begin that cover a box, and their rows and columns."""
    x, y = math.floor(box[0] / cell_m), math.floor(box[2] / cell_m)
    return (x, y), (math.ceil(box[3] / cell_m) - y + 1, math.ceil(box[1] / cell_m) - x + 1)
