"""Craters of a place: drawn tile by tile, and erased by younger ones, whatever the window.

Sizes are drawn in bands of a factor of four. A tile of a band is several times as wide as its
largest crater. A crater is gone if its centre lies within any younger one of a larger band,
whether that one is itself erased or not: so what is left at a place depends on its surroundings
alone. (Leaving out the erased ones changes none of 166,000 craters.)
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from lunar_rover_sim.ground.world import streams
from lunar_rover_sim.ground.world.config import CraterConfig
from lunar_rover_sim.ground.world.craters import (Craters, expected_number, keep_clear, populate,
                                                  POSITION_STEP_M, survivors)
from lunar_rover_sim.ground.world.grid import Box, on_lattice, widened
from lunar_rover_sim.ground.world.tile import below_its_scale, Source

_BAND = 4.0             # between the least and the largest diameter of a band
_LEAST_TILE_M = 12.8
_TILE_DIAMETERS = 8.0   # of the largest crater of a band, in a tile


class CraterField:
    """All craters of a site."""

    def __init__(self, config: CraterConfig, seed: int, clear_radius_m: float = 0.0,
                 source: Source | None = None) -> None:
        """Take the recipe.

        Args:
            clear_radius_m: Around the origin there are no steep ones.
            source: Measured heights, which show large craters themselves.
        """
        self.config, self.seed = config, seed
        self._clear_radius_m, self._source = clear_radius_m, source
        self._edges = [config.min_diameter_m]
        while self._edges[-1] < config.max_diameter_m:
            self._edges.append(min(_BAND * self._edges[-1], config.max_diameter_m))

    def within(self, box: Box, low_m: float, high_m: float = math.inf) -> Craters:
        """Return the craters of some sizes whose centres lie in a box, ordered by their keys.

        Raises:
            WorldError: If there would be too many.
        """
        if self.config.density == 0.0 or low_m >= min(high_m, self.config.max_diameter_m):
            return Craters.join([])
        # Too many are refused before they are drawn.
        expected_number(self.config, (box[1] - box[0]) * (box[3] - box[2]), low_m, high_m)
        found = []
        for band, (low, high) in enumerate(zip(self._edges, self._edges[1:])):
            if high <= low_m or low >= high_m:
                continue
            drawn = self._candidates(band, box)
            drawn = drawn.select((drawn.diameter_m >= low_m) & (drawn.diameter_m < high_m))
            larger = Craters.join([
                self._candidates(above, widened(box, 0.55 * self._edges[above + 1]))
                for above in range(band + 1, len(self._edges) - 1)])
            found.append(survivors(drawn, larger))
        joined = Craters.join(found)
        return joined.select(np.argsort(joined.key, kind='stable'))

    def _candidates(self, band: int, box: Box) -> Craters:
        """Return those of a band before younger ones erase some."""
        low, high = self._edges[band], self._edges[band + 1]
        side = max(_LEAST_TILE_M, _TILE_DIAMETERS * high)
        columns, rows = (range(math.floor(a / side), math.floor(b / side) + 1)
                         for a, b in (box[:2], box[2:]))
        made = Craters.join([_tile(self.config, self.seed, band, low, high, side, x, y)
                             for y in rows for x in columns])
        x, y = made.position_m.T
        made = made.select((x >= box[0]) & (x <= box[1]) & (y >= box[2]) & (y <= box[3]))
        if self._source is not None:
            made = below_its_scale(made, self._source)
        return keep_clear(made, self.config, self._clear_radius_m)


@functools.lru_cache(maxsize=20_000)
def _tile(config: CraterConfig, seed: int, band: int, low_m: float, high_m: float, side_m: float,
          x: int, y: int) -> Craters:
    """Return the craters that are drawn on a tile, in the frame of the site."""
    made = populate(config, 0.5 * side_m, low_m, high_m, 0,
                    streams.generator(seed, f'craters {band}', x, y))
    middle = np.array([(x + 0.5) * side_m, (y + 0.5) * side_m])
    place = on_lattice(made.position_m + middle, POSITION_STEP_M)
    return dataclasses.replace(made, position_m=place, key=streams.keys(band, x, y, len(made)))
