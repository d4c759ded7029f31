"""A tile of measured heights in a level: its own heights within, and no step at its edge."""

from types import SimpleNamespace

import numpy as np
import pytest

from lunar_rover_sim.world import tile
from lunar_rover_sim.world.craters import Craters
from lunar_rover_sim.world.levels import axis_m


def laid(height, n=129, cell_m=0.5, pixel_m=1.0, half_m=12.0):
    """Return level ground with a tile of (x, y) heights in its middle, and where it is covered."""
    axis = axis_m(n, cell_m)
    centres = np.arange(-half_m, half_m + 0.5 * pixel_m, pixel_m)
    heights = height(centres[None, :], centres[:, None]).astype(np.float32)
    ground = np.zeros((n, n), np.float32)
    tile.lay(ground, cell_m, tile.Tile(heights, centres, centres, pixel_m), half_m)
    return axis, ground, np.abs(axis) <= half_m + 1e-9


@pytest.mark.parametrize('pixel_m', [0.5, 1.0, 3.0])
def test_a_tile_that_lies_higher_lifts_all_of_the_level(pixel_m):
    _, ground, _ = laid(lambda x, y: 3.0 + 0.0 * x * y, pixel_m=pixel_m)
    np.testing.assert_allclose(ground, 3.0, atol=1e-3)


@pytest.mark.parametrize('pixel_m', [1.0, 3.0])
@pytest.mark.parametrize('along', ['x', 'y'])
def test_a_slope_goes_on_beyond_the_tile_without_a_step_and_settles(along, pixel_m):
    """Over half of the tile's size; its highest pixels lie at 2.4 m."""
    axis, ground, inside = laid(lambda x, y: 0.2 * (x if along == 'x' else y) + 0.0 * x * y,
                                pixel_m=pixel_m)
    ground = ground if along == 'x' else ground.T
    np.testing.assert_allclose(ground[np.ix_(inside, inside)],
                               np.tile(0.2 * axis[inside], (inside.sum(), 1)), atol=1e-3)
    row = ground[len(axis) // 2]
    steps = np.diff(row)
    assert np.abs(steps).max() <= 0.2 * pixel_m
    assert 2.4 < row[-1] < 3.0 and abs(steps[-1]) < 0.01
    np.testing.assert_allclose(row[::-1], -row, atol=0.15)


def test_craters_that_a_model_would_show_are_left_out_in_and_around_its_area():
    """An area of 40 m by 20 m, off the origin, pixels of 2 m: those of 3 m reach 3.9 m."""
    source = SimpleNamespace(area_m=(-10.0, 30.0, -5.0, 15.0), pixel_m=2.0)
    places = [(0.0, 0.0), (29.0, 14.0), (33.8, 0.0), (34.0, 0.0), (-13.8, 0.0), (-14.0, 0.0),
              (0.0, 18.8), (0.0, 19.0), (0.0, -8.8), (0.0, -9.0), (32.5, 17.5), (33.0, 18.0)]
    kept = [False, False, False, True, False, True, False, True, False, True, False, True]
    for diameter, expected in ((3.0, kept), (2.0, [True] * len(places))):
        craters = Craters(np.array(places), np.full(len(places), diameter),
                          np.zeros(len(places)), np.arange(len(places), dtype=np.int32))
        found = tile.below_its_scale(craters, source).level
        assert found.tolist() == np.flatnonzero(expected).tolist()
