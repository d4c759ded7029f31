"""One piece of ground with rocks and craters, and windows of it in the frame of a site."""

from collections.abc import Sequence
import dataclasses
import functools

import numpy as np
from physics_scene import make_world

from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.grid import height_step_m, HeightGrid, on_lattice
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks, RockShape

CELL_M = 0.025
_ROCKS = 120


def grid(middle_m: tuple[float, float], half_m: float) -> HeightGrid:
    """Return a window of relief that never repeats: the same bits wherever windows overlap."""
    n = 2 * round(half_m / CELL_M) + 1
    first = HeightGrid(np.zeros((n, n), np.float32), CELL_M, middle_m).first
    x, y = ((np.arange(n) + f) * CELL_M for f in first)
    heights = np.zeros((n, n))
    for k, length in enumerate((17.3, 5.9, 2.1, 0.83, 0.37)):
        angle = 2.4 * k
        phase = 2.0 * np.pi / length * np.add.outer(np.sin(angle) * y, np.cos(angle) * x)
        heights += 0.005 * length * np.sin(phase + k)
    return HeightGrid(on_lattice(heights, height_step_m(CELL_M)).astype(np.float32), CELL_M,
                      middle_m)


def octahedron() -> RockShape:
    """Return an octahedron of unit size."""
    vertices = 0.5 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1],
                               [0, 0, -1]], np.float32)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5],
                      [0, 3, 5]], np.int32)
    return RockShape('octahedron', vertices, faces)


@functools.lru_cache(maxsize=8)
def window(middle_m: tuple[float, float], half_m: float, around: tuple[float, float],
           seed: int = 1) -> World:
    """Return a window of a site, with many rocks and fresh craters around a place.

    Rocks are listed in another order in each window.
    """
    ground, rng = grid(middle_m, half_m), np.random.default_rng(seed)
    xy = np.array(around) + rng.normal(0.0, 0.8, (_ROCKS, 2))
    size = rng.integers(0, 2, _ROCKS)
    turn = rng.normal(size=(_ROCKS, 4))
    z = rng.uniform(-0.01, 0.01, _ROCKS)
    order = np.random.default_rng(abs(hash((middle_m, half_m)))).permutation(_ROCKS)
    order = order[ground.contains(xy[order])]
    place = np.column_stack([xy, z])[order]
    place[:, 2] += ground.height_at(place[:, :2])
    rocks = Rocks(np.zeros(len(order), np.int32), size[order].astype(np.int32), place,
                  (turn / np.linalg.norm(turn, axis=1, keepdims=True))[order],
                  np.ones(len(order), np.float32), np.array([0.03, 0.06]),
                  (1000 + 7 * order).astype(np.uint64))
    craters = Craters(np.array(around) + rng.uniform(-3.0, 3.0, (9, 2)), rng.uniform(0.6, 4.0, 9),
                      rng.uniform(0.0, 0.3, 9), np.zeros(9, np.int32))
    world = make_world(ground.heights_m, CELL_M, rocks, (octahedron(),))
    return dataclasses.replace(world, levels=(ground,), craters=craters)


class CutSite:
    """A site of windows around a place, with steps as small as a test wants them.

    Attributes:
        entered_m: Middles of those that were asked for.
    """

    def __init__(self, around: tuple[float, float], step_m: float = 12.8, half_m: float = 12.8,
                 reach_m: float = 1e3) -> None:
        self.step_m, self.half_extent_m = step_m, reach_m + half_m
        self._around, self._half_m, self._reach = around, half_m, round(reach_m / step_m)
        self.entered_m: list[tuple[float, float]] = []

    def middle(self, xy_m: Sequence[float],
               now_m: tuple[float, float] | None = None) -> tuple[float, float]:
        """Return the middle of the window for a rover at a place."""
        if now_m is not None and max(abs(a - b) for a, b in zip(xy_m, now_m)) < 0.75 * self.step_m:
            return now_m
        x, y = (round(self.step_m * min(max(round(a / self.step_m), -self._reach), self._reach), 9)
                for a in xy_m)
        return x, y

    def window(self, middle_m: tuple[float, float]) -> World:
        """Return the window."""
        self.entered_m.append(middle_m)
        return window(middle_m, self._half_m, self._around)

    def close(self) -> None:
        """Do nothing."""
