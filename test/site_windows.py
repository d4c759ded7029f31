"""Windows of a site that are cut from one wide world, with equal ground where they overlap."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses

import numpy as np

from lunar_rover_sim.ground.world import levels as nest
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks


def cut(wide: World, middle_m: tuple[float, float], samples: list[int],
        moved_m: tuple[float, float] = (0.0, 0.0)) -> World:
    """Return a window of a wide world about the origin; it has no hash.

    Args:
        middle_m: Of the window, a multiple of all cells.
        samples: Along a side of each level.
        moved_m: Where the origin of the wide world lies in the site.
    """
    grids = []
    for grid, n in zip(wide.levels, samples):
        column, row = (round(m / grid.cell_m + 0.5 * (grid.n - n)) for m in middle_m)
        assert min(column, row) >= 0 and max(column, row) + n <= grid.n
        heights = grid.heights_m[row:row + n, column:column + n].copy()
        grids.append(HeightGrid(heights, grid.cell_m))
    for k in range(len(grids) - 2, -1, -1):
        nest.close_seam(grids[k].heights_m, grids[k].cell_m, grids[k + 1])
    for grid in grids:
        grid.heights_m.setflags(write=False)
    place = np.add(middle_m, moved_m)
    middle = float(place[0]), float(place[1])
    grids = [dataclasses.replace(grid, middle_m=middle) for grid in grids]
    n, fine = samples[0], wide.ground
    column, row = (round(m / fine.cell_m + 0.5 * (fine.n - n)) for m in middle_m)
    albedo = wide.albedo[row:row + n, column:column + n].copy()
    albedo.setflags(write=False)
    rocks, half_m = wide.rocks, grids[0].half_extent_m
    inside = np.abs(rocks.position_m[:, :2] - middle_m).max(axis=1) < half_m - rocks.diameter_m
    chosen = {field.name: getattr(rocks, field.name)[inside]
              for field in dataclasses.fields(Rocks) if field.name != 'size_classes_m'}
    chosen['position_m'] = chosen['position_m'] + [*moved_m, 0.0]
    craters = dataclasses.replace(wide.craters, position_m=wide.craters.position_m + moved_m,
                                  key=np.arange(len(wide.craters), dtype=np.uint64))
    near = np.abs(craters.position_m - middle).max(axis=1) < grids[-1].half_extent_m
    kept: Craters = craters.select(near)
    return dataclasses.replace(
        wide, levels=tuple(grids), albedo=albedo, hash='', craters=kept,
        rocks=Rocks(size_classes_m=rocks.size_classes_m, **chosen))


class Windows:
    """A site of windows that are 12.8 m apart, in a row from west to east."""

    step_m = 12.8

    def __init__(self, windows: Sequence[World]) -> None:
        self._windows = {world.ground.middle_m: world for world in windows}
        self.asked: list[tuple[float, float]] = []

    def middle(self, xy_m: Sequence[float],
               now_m: tuple[float, float] | None = None) -> tuple[float, float]:
        """Return the middle of the nearest window."""
        if now_m is not None and max(abs(a - b) for a, b in zip(xy_m, now_m)) < 0.75 * self.step_m:
            return now_m
        return min(self._windows, key=lambda m: abs(m[0] - xy_m[0]))

    def window(self, middle_m: tuple[float, float]) -> World:
        """Return a window."""
        self.asked.append(middle_m)
        return self._windows[middle_m]

    def close(self) -> None:
        """Do nothing."""
