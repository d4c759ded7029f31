"""Heights of the untouched ground, kept per tile, are those of the ground."""

import numpy as np

from lunar_rover_sim.regolith.fine_ground import base_heights, FineGround, MOST_TILES
from lunar_rover_sim.regolith.overlay import TILE
from lunar_rover_sim.world.grid import HeightGrid


def test_kept_heights_are_those_of_the_ground():
    heights = np.random.default_rng(1).normal(0.0, 0.02, (41, 41)).astype(np.float32)
    grid = HeightGrid(heights, 0.025)
    fine = FineGround(grid)
    # Within a tile, across four, across the border of the ground; again after all were dropped.
    windows = [(3, 4, 10, 12), (-7, -9, 20, 15), (90, -20, 30, 30), (-300, 0, 4, 4)]
    for _ in range(2):
        for window in windows:
            np.testing.assert_array_equal(fine.heights(*window), base_heights(grid, *window))
        for k in range(MOST_TILES):
            fine.heights(k * TILE, 1000 * TILE, 1, 1)
    assert np.isnan(fine.heights(90, -20, 30, 30)).any()
