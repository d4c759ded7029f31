"""The world, as physics and camera use it."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.rocks import Rocks, RockShape


@dataclasses.dataclass(frozen=True)
class World:
    """A window of a site on the Moon; places are in the frame of the site.

    Attributes:
        levels: Nested height grids, finest first, with one middle. levels[0] is the
            ground that the rover walks on (2.5 cm cells, 51.2 m wide by default); each further
            level is coarser and wider and covers the inner ones too, to at least 1 km. At the
            border of a level its heights are those of the next level's surface, so that there is
            no crack.
        albedo: (n, n) float32 on the samples of levels[0]: factor on the single-scattering albedo,
            about 1; outside levels[0] the factor is 1.
        rocks: Instances of `rock_shapes`.
        rock_shapes: The library that `rocks` index.
        config: The parameters it was built from.
        hash: Hexadecimal content hash of everything else except the report.
        craters: Those that were drawn.
        report: Facts about the source: the height of the origin there, gaps, overhangs.
        origin_m: Place of this world's (0, 0) in the site [m]; not (0, 0) after `local` only.
    """

    levels: tuple[HeightGrid, ...]
    albedo: NDArray[np.float32]
    rocks: Rocks
    rock_shapes: tuple[RockShape, ...]
    config: WorldConfig
    hash: str
    craters: Craters = dataclasses.field(default_factory=lambda: Craters.join([]))
    report: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    origin_m: tuple[float, float] = (0.0, 0.0)

    def local(self) -> World:
        """Return this window in a frame whose origin is its middle, as images need it.

        Single precision holds such places. z stays. `origin_m` says where the frame lies, for what
        depends on the place in the site: the phase of relief, patches of colour.
        """
        x, y = self.ground.middle_m
        if x == 0.0 and y == 0.0:
            return self
        rocks = dataclasses.replace(self.rocks,
                                    position_m=self.rocks.position_m - np.array([x, y, 0.0]))
        craters = dataclasses.replace(self.craters,
                                      position_m=self.craters.position_m - np.array([x, y]))
        levels = tuple(dataclasses.replace(level, middle_m=(0.0, 0.0)) for level in self.levels)
        return dataclasses.replace(self, levels=levels, rocks=rocks, craters=craters,
                                   origin_m=(self.origin_m[0] + x, self.origin_m[1] + y))

    def __repr__(self) -> str:
        return (f'World({self.hash}: {2 * self.ground.half_extent_m:g} m at '
                f'{self.ground.cell_m:g} m, {len(self.rocks)} rocks, seed {self.config.seed})')

    def _repr_html_(self) -> str:
        """Return the ground, lit from the east and north up, for a notebook."""
        # Here, because OpenCV takes time to import.
        from lunar_rover_sim.base.files.images import notebook_html
        return notebook_html(repr(self), self.relief_picture(256))

    def relief_picture(self, pixels: int) -> NDArray[np.uint8]:
        """Return the ground lit from the east, north up, with at most twice `pixels` a side."""
        step = max(1, len(self.ground.heights_m) // pixels)
        slope = np.gradient(self.ground.heights_m[::-step, ::step], step * self.ground.cell_m,
                            axis=1)
        return np.clip(128 - 300 * slope, 0, 255).astype(np.uint8)

    @property
    def ground(self) -> HeightGrid:
        """The finest level, with which the rover collides."""
        return self.levels[0]

    def outside(self, x_m: float, y_m: float) -> str:
        """Return what is wrong with a place outside the world, and what is valid; '' within."""
        if np.isfinite(self.height_at((x_m, y_m))):
            return ''
        widest = self.levels[-1]
        around = '' if widest.middle_m == (0.0, 0.0) else ' of (%g, %g)' % widest.middle_m
        return (f'({x_m:g}, {y_m:g}) lies outside the world; valid are x and y within '
                f'{widest.half_extent_m:g} m{around}')

    def height_at(self, xy_m: ArrayLike) -> NDArray[np.float64]:
        """Return the ground height [m] (rocks not included) at (..., 2) positions [m].

        Each position takes the finest level that contains it; beyond all levels it is NaN.
        """
        xy = np.asarray(xy_m, dtype=float)
        height = np.full(xy.shape[:-1], np.nan)
        for level in self.levels:
            todo = np.isnan(height)
            if not np.any(todo):
                break
            height = np.where(todo, level.height_at(xy), height)
        return height
