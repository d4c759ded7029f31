"""Small worlds, grounds and rocks of the regression cases, without symmetry or round numbers."""

import dataclasses

import numpy as np

from lunar_rover_sim.ground.world import shapes
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks


def hills(n: int, cell_m: float, height_m: float = 0.1, steepness: float = 0.0) -> HeightGrid:
    """Return a grid of waves in odd directions, of 0.7 m and more; steepness: of a slope."""
    axis = (np.arange(n) - 0.5 * (n - 1)) * cell_m
    x, y = np.meshgrid(axis, axis)
    heights = (np.sin(2.3 * x + 1.1 * y + 0.4) + 0.6 * np.sin(0.9 * x - 3.7 * y + 1.3)
               + 0.3 * np.cos(5.1 * x + 7.3 * y)) * height_m + steepness * (x - 0.4 * y)
    return HeightGrid(heights.astype(np.float32), cell_m)


def hilly_levels() -> tuple[HeightGrid, ...]:
    """Return three nested levels, each coarser by 8, with hills to hide a low sun."""
    return (hills(97, 0.05), hills(65, 0.4, 0.5, 0.02), hills(65, 3.2, 9.0, -0.01))


def craters() -> Craters:
    """Return a few craters, fresh and old, small and large, on and beyond the ground."""
    return Craters(
        np.array([[0.7, -1.1], [-1.9, 0.6], [8.3, 5.2], [-21.0, 13.0], [2.4, 2.2], [-3.1, -2.9]]),
        np.array([1.3, 0.62, 4.4, 17.0, 0.45, 2.1]),
        np.array([0.03, 0.21, 0.11, 0.07, 0.3, 0.62]),
        np.array([0, 0, 1, 2, 0, 1], np.int32))


def stones(ground: HeightGrid, count: int = 14, seed: int = 5, reach: float = 1.05) -> Rocks:
    """Return rocks in random poses on a ground and beside it, some deep and some with a flat top.

    reach: how far they lie, in half widths of the ground
    """
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(count, 4))
    xy = rng.uniform(-reach, reach, (count, 2)) * ground.half_extent_m
    within = np.clip(xy, -ground.half_extent_m, ground.half_extent_m)
    size = (np.arange(count) % 4).astype(np.int32)
    sizes = np.array([0.12, 0.31, 0.55, 0.9])
    lift = np.array([0.3, -0.1, 0.12, 0.0])[np.arange(count) // 2 % 4] * sizes[size]
    return Rocks(rng.integers(0, len(shapes.library()), count).astype(np.int32), size,
                 np.column_stack([xy, ground.height_at(within) + lift]),
                 quat / np.linalg.norm(quat, axis=1, keepdims=True),
                 np.linspace(0.8, 1.2, count).astype(np.float32), sizes)


def stony_world(levels: tuple[HeightGrid, ...] | None = None, count: int = 14) -> World:
    """Return hills with rocks and craters."""
    levels = levels or hilly_levels()
    albedo = (1.0 + 0.1 * levels[0].heights_m).astype(np.float32)
    config = dataclasses.replace(WorldConfig(), seed=4)
    return World(levels, albedo, stones(levels[0], count), shapes.library(), config, 'a hash',
                 craters())


def waves(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    """Return an image, 0 to 1: waves of several lengths and a little noise."""
    rows, columns = np.indices(shape[:2])
    image = (0.5 + 0.2 * np.sin(0.31 * columns + 0.11 * rows) + 0.15 * np.sin(0.9 * rows)
             + 0.1 * np.cos(1.7 * columns - 0.6 * rows)
             + 0.05 * np.random.default_rng(seed).uniform(-1.0, 1.0, shape[:2]))
    return np.asarray(np.clip(image, 0.0, 1.0))


def stereo_pair() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return left and right image, uint8, and the true disparity of both: a slope and a block."""
    height, width = 71, 133
    rows, columns = np.indices((height, width + 60))
    texture = np.random.default_rng(2).uniform(0.0, 1.0, (height, width + 60))
    texture = 0.35 * texture + 0.65 * waves((height, width + 60))
    truths = []
    for first in (60, 42):
        truth = (3.3 + 0.16 * np.arange(height))[:, None] + np.zeros((height, width))
        truth[30:52, first:first + 31] = 18.0
        truth[:9] = 0.0
        truths.append(truth)

    def picture(shift: np.ndarray) -> np.ndarray:
        place = np.arange(width)[None] + shift + 5.0
        low = np.floor(place).astype(int)
        part = place - low
        row = rows[:, :width]
        return (1.0 - part) * texture[row, low] + part * texture[row, low + 1]

    left, right = picture(np.zeros((height, width))), picture(truths[1])
    for image in (left, right):
        image *= 220.0
        image[:9] = 4.0
    left[60:68, 100:120], right[60:68, 88:110] = 3.0, 3.0        # shadow
    left[12:22, 100:118], right[12:22, 95:113] = 255.0, 255.0    # saturated
    left[40:56, 10:26], right[40:56, 0:16] = 90.0, 90.0          # flat
    return (left.astype(np.uint8), right.astype(np.uint8), truths[0].astype(np.float32),
            truths[1].astype(np.float32))
