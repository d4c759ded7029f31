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


def uneven(x_low=-9.0, x_high=21.0, y_low=-15.0, y_high=6.0, pixel_m=3.0, seed=1):
    """Return a tile off the middle, wider than high, of random heights."""
    x = np.arange(x_low, x_high + 0.5 * pixel_m, pixel_m)
    y = np.arange(y_low, y_high + 0.5 * pixel_m, pixel_m)
    heights = np.random.default_rng(seed).normal(size=(len(y), len(x))).astype(np.float32)
    return tile.Tile(heights, x, y, pixel_m)


def means_over_pixels(heights, axis, part):
    """Return the means of heights over the pixels of a tile, by counting cells."""
    cell_m, found = axis[1] - axis[0], np.zeros(part.heights_m.shape)
    for j, y in enumerate(part.y_m):
        for i, x in enumerate(part.x_m):
            wy, wx = (np.clip(np.minimum(axis + cell_m / 2, at + part.pixel_m / 2)
                              - np.maximum(axis - cell_m / 2, at - part.pixel_m / 2), 0.0, None)
                      / part.pixel_m for at in (y, x))
            found[j, i] = wy @ heights @ wx
    return found


def test_heights_of_a_tile_are_those_of_its_spline():
    """Wherever it lies; samples of the level fall on its pixels."""
    part, axis = uneven(), axis_m(121, 0.5)
    ground = np.random.default_rng(2).normal(size=(121, 121)).astype(np.float32)
    # What is to be kept reaches beyond the tile: nothing is blended.
    tile.lay(ground, 0.5, part, 30.0)
    rows, columns = (np.isin(axis, at) for at in (part.y_m, part.x_m))
    np.testing.assert_allclose(ground[np.ix_(rows, columns)], part.heights_m, atol=1e-4)


def test_detail_changes_no_mean_over_a_pixel():
    """Added to a level, it is taken off again at the scale of the tile."""
    part, axis = uneven(), axis_m(121, 0.5)
    ground = np.random.default_rng(2).normal(size=(121, 121)).astype(np.float32)
    tile.restore(ground, 0.5, part, 30.0, rounds=12)
    inner = slice(1, -1), slice(1, -1)
    np.testing.assert_allclose(means_over_pixels(ground, axis, part)[inner],
                               part.heights_m[inner], atol=0.02)


@pytest.mark.parametrize('x_high,y_high', [(-8.0, 6.0), (21.0, -14.0)])
def test_less_than_two_pixels_are_no_terrain(x_high, y_high):
    """A single row or column of pixels says nothing of slopes; the level stays as it is."""
    part = uneven(x_high=x_high, y_high=y_high)
    assert 1 in part.heights_m.shape
    ground = np.random.default_rng(2).normal(size=(121, 121)).astype(np.float32)
    before = ground.copy()
    tile.restore(ground, 0.5, part, 30.0)
    tile.lay(ground, 0.5, part, 30.0)
    np.testing.assert_array_equal(ground, before)


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
