"""Pixels of elevation models: oblong ones, from either end, averaged, at the edge of the file."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
import worlds

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.parameters import merge
from lunar_rover_sim.ground.world import tile as terrain_tile
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.dem import open_dem
from lunar_rover_sim.ground.world.levels import axis_m
from lunar_rover_sim.ground.world.spline import Area
from lunar_rover_sim.ground.world.tile import Tile

MOON = '+proj=stere +lat_0=-90 +lon_0=0 +k=1 +x_0=0 +y_0=0 +R=1737400 +units=m +no_defs'
EAST, NORTH = 0.11, -0.07     # metres that the ground rises per metre
COLUMNS, ROWS = 40, 50
PIXEL_X, PIXEL_Y = 2.0, 3.0


def plane(south_up):
    """Return heights of a plane over the middle of the file, in the file's order of rows."""
    x = (np.arange(COLUMNS) + 0.5 - COLUMNS / 2) * PIXEL_X
    y = (np.arange(ROWS) + 0.5 - ROWS / 2) * PIXEL_Y
    heights = 500.0 + EAST * x + NORTH * (y if south_up else -y)[:, None]
    return heights.astype(np.float32)


def write(path, kind, south_up, heights=None):
    """Write the plane as GeoTIFF or as a folder; return its path."""
    heights = plane(south_up) if heights is None else heights
    if kind == 'folder':
        path.mkdir()
        np.save(path / 'dem.npy', heights)
        (path / 'dem.yaml').write_text(json.dumps(
            {'size': list(heights.shape[::-1]),
             'pixel_size': [PIXEL_X, PIXEL_Y if south_up else -PIXEL_Y]}))
        return path
    transform = rasterio.Affine(PIXEL_X, 0.0, 700.0, 0.0, PIXEL_Y if south_up else -PIXEL_Y, -90.0)
    path = path.with_suffix('.tif')
    with rasterio.open(path, 'w', driver='GTiff', width=heights.shape[1], height=heights.shape[0],
                       count=1, dtype=heights.dtype, crs=CRS.from_user_input(MOON),
                       transform=transform) as file:
        file.write(heights, 1)
    return path


def opened(path, **dem):
    return open_dem(WorldConfig.from_mapping(
        merge(worlds.SMALL, {'source': 'dem', 'path': str(path), 'dem': dem})))


KINDS = pytest.mark.parametrize('kind', ['folder', 'tiff'])
SENSES = pytest.mark.parametrize('south_up', [False, True])


@KINDS
@SENSES
@pytest.mark.parametrize('center', [(0.0, 0.0), (10.0, 21.0), (-7.5, 4.2)])
@pytest.mark.parametrize('cell_m', [0.5, 3.0, 6.5, 9.0])
def test_every_height_lies_where_its_pixel_is(tmp_path, kind, south_up, center, cell_m):
    """Means of whole pixels of a plane are its heights at their centres, however they are cut."""
    raster = opened(write(tmp_path / 'plane', kind, south_up), center=list(center))
    tile = raster.tile((-20.0, 20.0, -20.0, 20.0), cell_m)
    expected = (500.0 + EAST * (tile.x_m + center[0])
                + NORTH * (tile.y_m + center[1])[:, None])
    np.testing.assert_allclose(tile.heights_m + raster.reference_m, expected, atol=2e-3)
    # Averaged over as many pixels as the cell spans, by the larger side of a pixel.
    factor = max(int(cell_m / PIXEL_Y), 1)
    np.testing.assert_allclose(np.diff(tile.x_m), factor * PIXEL_X)
    np.testing.assert_allclose(np.diff(tile.y_m), factor * PIXEL_Y)
    assert tile.pixel_m == factor * PIXEL_Y
    # The window is covered with the pixels that a spline needs around it, and no farther.
    for axis, pixel in ((tile.x_m, PIXEL_X), (tile.y_m, PIXEL_Y)):
        assert axis[0] <= -20.0 + 0.5 * pixel * factor and axis[-1] >= 20.0 - 1.5 * pixel * factor
        assert np.abs(axis).max() <= 20.0 + (terrain_tile.PAD_PIXELS + 1.0) * pixel * factor
    raster.close()


@KINDS
@SENSES
def test_the_area_of_a_file_in_the_world(tmp_path, kind, south_up):
    """80 m x 150 m, whose middle lies 10 m west and 21 m south of the world's origin."""
    raster = opened(write(tmp_path / 'plane', kind, south_up), center=[10.0, 21.0])
    assert raster.area_m == pytest.approx((-50.0, 30.0, -96.0, 54.0))
    assert raster.pixel_m == PIXEL_Y
    assert raster.report['pixel_m'] == [PIXEL_X, PIXEL_Y]
    # The height at the origin is that of the middle pixel of the window or its neighbour's.
    assert raster.reference_m == pytest.approx(500.0 + 10.0 * EAST + 21.0 * NORTH, abs=0.2)
    raster.close()


@KINDS
@SENSES
@pytest.mark.parametrize('east,north,side,beyond', [
    (35.0, 0.0, 'east', 1.4), (-35.0, 0.0, 'west', 1.4), (0.0, 70.0, 'north', 1.4),
    (0.0, -71.0, 'south', 2.4)])
def test_a_window_beyond_the_file_is_measured(tmp_path, kind, south_up, east, north, side, beyond):
    """12.8 m about a place 5 m before an edge at 40 m, or 75 m: 6.4 m - 5 m beyond."""
    path = write(tmp_path / 'plane', kind, south_up)
    with pytest.raises(WorldError, match=f'reaches {beyond} m beyond the {side} edge of the file '
                                         r'\(80 x 150 m\)'):
        opened(path, center=[east, north])


@KINDS
@SENSES
def test_a_window_may_touch_the_edge(tmp_path, kind, south_up):
    raster = opened(write(tmp_path / 'plane', kind, south_up), center=[33.6, -68.6])
    assert raster.area_m == pytest.approx((-73.6, 6.4, -6.4, 143.6))
    raster.close()


@KINDS
def test_a_given_pixel_size_replaces_that_of_the_file(tmp_path, kind):
    raster = opened(write(tmp_path / 'plane', kind, False), pixel_m=1.5)
    assert (raster.pixel_x_m, raster.pixel_y_m) == (1.5, 1.5)
    assert raster.area_m == pytest.approx((-30.0, 30.0, -37.5, 37.5))
    tile = raster.tile((-10.0, 10.0, -10.0, 10.0), 0.5)
    # The plane is as high over as many pixels: steeper in x, and in y twice as steep.
    slope_x = np.diff(tile.heights_m, axis=1) / np.diff(tile.x_m)
    slope_y = np.diff(tile.heights_m, axis=0) / np.diff(tile.y_m)[:, None]
    np.testing.assert_allclose(slope_x, EAST * PIXEL_X / 1.5, atol=1e-3)
    np.testing.assert_allclose(slope_y, NORTH * PIXEL_Y / 1.5, atol=1e-3)
    raster.close()


@KINDS
@SENSES
def test_a_center_by_column_and_row(tmp_path, kind, south_up):
    raster = opened(write(tmp_path / 'plane', kind, south_up), center_mode='pixel',
                    center=[25.0, 20.0])
    x, y = (25.0 - COLUMNS / 2) * PIXEL_X, (20.0 - ROWS / 2) * PIXEL_Y * (1 if south_up else -1)
    tile = raster.tile((-12.0, 12.0, -12.0, 12.0), 0.5)
    expected = 500.0 + EAST * (tile.x_m + x) + NORTH * (tile.y_m + y)[:, None]
    np.testing.assert_allclose(tile.heights_m + raster.reference_m, expected, atol=2e-3)
    raster.close()


@KINDS
def test_gaps_are_left_out_of_means_and_filled_between_their_neighbours(tmp_path, kind):
    heights = plane(False)
    heights[10:12, 10:12] = np.nan     # far from the ground, near the edge of the window
    raster = opened(write(tmp_path / 'plane', kind, False, heights))
    tile = raster.tile((-38.0, 38.0, -38.0, 38.0), 0.5)
    expected = 500.0 + EAST * tile.x_m + NORTH * tile.y_m[:, None]
    np.testing.assert_allclose(tile.heights_m + raster.reference_m, expected, atol=0.02)
    coarse = raster.tile((-38.0, 38.0, -38.0, 38.0), 9.0)
    expected = 500.0 + EAST * coarse.x_m + NORTH * coarse.y_m[:, None]
    # A mean over a part of three by three pixels lies off its centre by a pixel at most.
    np.testing.assert_allclose(coarse.heights_m + raster.reference_m, expected, atol=0.3)
    raster.close()


@KINDS
def test_a_gap_changes_no_mean_of_level_ground(tmp_path, kind):
    heights = np.full((ROWS, COLUMNS), 500.0, np.float32)
    heights[10:12, 10:12] = np.nan
    raster = opened(write(tmp_path / 'level', kind, False, heights))
    for cell_m in (6.5, 9.0):
        tile = raster.tile((-38.0, 38.0, -38.0, 38.0), cell_m)
        np.testing.assert_allclose(tile.heights_m + raster.reference_m, 500.0, atol=1e-3)
    raster.close()


@KINDS
def test_an_absurd_height_is_a_gap(tmp_path, kind):
    heights = plane(False)
    heights[25, 20] = -1.2e5
    path = write(tmp_path / 'plane', kind, False, heights)
    with pytest.raises(WorldError, match=r'1 of \d+ pixels in the window have no data'):
        opened(path)
    heights[25, 20] = -0.9e5
    with pytest.raises(WorldError, match='in the window: -90000 m beside 500'):
        opened(write(tmp_path / 'deep', kind, False, heights))
    heights += 1.0e5 - heights.max() - 1.0      # a whole file of great heights is one
    heights[25, 20] = heights[25, 21]
    opened(write(tmp_path / 'high', kind, False, heights)).close()


@SENSES
def test_pixels_smaller_than_a_metre(tmp_path, south_up):
    """The sign of the pixel size says where south is, however small it is."""
    path = tmp_path / 'fine'
    path.mkdir()
    rows = (np.arange(100) - 49.5) * (0.4 if south_up else -0.4)
    np.save(path / 'dem.npy', np.tile(NORTH * rows[:, None], (1, 100)).astype(np.float32))
    (path / 'dem.yaml').write_text(json.dumps(
        {'size': [100, 100], 'pixel_size': [0.4, 0.4 if south_up else -0.4]}))
    raster = opened(path)
    tile = raster.tile((-8.0, 8.0, -8.0, 8.0), 0.4)
    rise = np.diff(tile.heights_m, axis=0) / np.diff(tile.y_m)[:, None]
    np.testing.assert_allclose(rise, NORTH, atol=1e-3)
    raster.close()


def laid(height, n=129, cell_m=0.5, pixel_m=1.0, half_m=12.0):
    """Return level ground with a tile of (x, y) heights in its middle, and where it is covered."""
    axis = axis_m(n, cell_m)
    centres = np.arange(-half_m, half_m + 0.5 * pixel_m, pixel_m)
    heights = height(centres[None, :], centres[:, None]).astype(np.float32)
    ground = np.zeros((n, n), np.float32)
    measured = Tile(heights, (0, 0), (-half_m / pixel_m,) * 2, (pixel_m, pixel_m))
    np.testing.assert_allclose(measured.x_m, centres)
    terrain_tile.lay(Area(ground, (-(n // 2), -(n // 2)), cell_m), measured)
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
    return Tile(heights, (5, -4), (x_low / pixel_m - 5.0, y_low / pixel_m + 4.0),
                (pixel_m, pixel_m))


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
    terrain_tile.lay(Area(ground, (-60, -60), 0.5), part)
    rows, columns = (np.isin(axis, at) for at in (part.y_m, part.x_m))
    np.testing.assert_allclose(ground[np.ix_(rows, columns)], part.heights_m, atol=1e-4)


def test_detail_changes_no_mean_over_a_pixel():
    """Added to a level, it is taken off again at the scale of the tile.

    What is off beyond the border of the tile is not known.
    """
    part, axis = uneven(), axis_m(121, 0.5)
    ground = np.random.default_rng(2).normal(size=(121, 121)).astype(np.float32)
    for _ in range(2):      # six samples to a pixel leave 2 % of what is off
        ground += terrain_tile.correction(Area(ground, (-60, -60), 0.5), part)
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
    assert not terrain_tile.correction(Area(ground, (-60, -60), 0.5), part).any()
    terrain_tile.lay(Area(ground, (-60, -60), 0.5), part)
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
        found = terrain_tile.below_its_scale(craters, source).level
        assert found.tolist() == np.flatnonzero(expected).tolist()
