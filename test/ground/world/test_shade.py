"""Maps: shading of known planes, domes of rocks, horizons, and the curves of the sheet."""

import numpy as np
import pytest
import worlds

from lunar_rover_sim.ground.world import map_sheet, rockfield, shade
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.craters import density_per_m2
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks

CELL = 0.1


def ramp(east, north, n=41):
    axis = (np.arange(n) - (n - 1) / 2) * CELL
    return (east * axis + north * axis[:, None]).astype(np.float32)


@pytest.mark.parametrize('elevation_deg', [10.0, 20.0, 25.0])
def test_level_ground_is_shaded_by_lommel_and_seeliger(elevation_deg):
    """mu0 / (mu0 + mu) seen from above, over that of a slope that is tilted by twice the sun."""
    mu0, white = np.sin(np.radians([elevation_deg, 3.0 * elevation_deg]))
    expected = mu0 / (mu0 + 1.0) / (white / (white + 1.0))
    found = shade.shaded(ramp(0.0, 0.0), CELL, 30.0, elevation_deg)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.parametrize('azimuth_deg', [0.0, 90.0, 200.0])
def test_the_slope_towards_the_sun_is_white_and_the_one_away_is_dark(azimuth_deg):
    c, s = np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))
    facing = -np.tan(np.radians(2.0 * 12.0))
    assert shade.shaded(ramp(facing * c, facing * s), CELL, azimuth_deg,
                        12.0)[20, 20] == pytest.approx(1.0, abs=1e-4)
    assert np.all(shade.shaded(ramp(-facing * c, -facing * s), CELL, azimuth_deg, 12.0) == 0.0)


@pytest.mark.parametrize('east,north', [(0.3, 0.0), (0.0, -0.4), (0.3, 0.4)])
def test_slopes_of_a_plane(east, north):
    found = shade.slope_deg(ramp(east, north), CELL)
    np.testing.assert_allclose(found, np.degrees(np.arctan(np.hypot(east, north))), rtol=1e-4)
    # Over a baseline: the mean square of both axes, halved.
    rms = shade.rms_slope_deg(HeightGrid(ramp(east, north), CELL), 0.5)
    assert rms == pytest.approx(np.degrees(np.arctan(np.sqrt((east**2 + north**2) / 2.0))),
                                rel=1e-4)


def flat_world(position, diameter):
    """Return level ground of 4 m with rocks of the given diameters."""
    count = len(diameter)
    rocks = Rocks(np.zeros(count, np.int32), np.arange(count, dtype=np.int32),
                  np.reshape(np.asarray(position, float), (count, 3)),
                  np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), np.ones(count, np.float32),
                  np.asarray(diameter, float))
    grid = HeightGrid(ramp(0.0, 0.0), CELL)
    return World((grid,), np.ones_like(grid.heights_m), rocks, (), None, '')


@pytest.mark.parametrize('stride', [1, 2])
def test_rocks_are_domes_on_the_map(stride):
    """A half ellipsoid 0.38 of the diameter high over the middle of the rock; three at borders."""
    places = [(0.3, -0.4, 0.05), (-1.95, 0.5, 0.0), (0.7, 1.9, 0.0), (1.2, -2.0, 0.1),
              (-1.0, -1.0, 0.0)]
    sizes = [1.2, 0.9, 0.8, 0.7, 0.06]
    heights = shade.with_rocks(flat_world(places, sizes), stride)
    axis = (np.arange(len(heights)) - (len(heights) - 1) / 2) * CELL * stride
    expected = np.zeros_like(heights)
    for (x, y, z), diameter in list(zip(places, sizes))[:4]:
        rho = np.hypot(axis - x, (axis - y)[:, None]) / (0.5 * diameter)
        dome = z + 0.38 * diameter * np.sqrt(np.clip(1.0 - rho**2, 0.0, None))
        expected = np.where(rho < 1.0, np.maximum(expected, dome), expected)
    # The fifth is smaller than a cell: it is not drawn.
    np.testing.assert_allclose(heights, expected, atol=1e-5)


def test_a_rock_below_the_ground_does_not_lower_it():
    assert np.all(shade.with_rocks(flat_world([(0.0, 0.0, -1.0)], [0.8])) == 0.0)


def test_the_horizon_of_a_ridge():
    """A ridge 1 m high 1.5 m east: 0.7 m above the eye at 0.3 m; a plain to the west."""
    heights = ramp(0.0, 0.0)
    heights[:, 35] = 1.0
    grid = HeightGrid(heights, CELL)
    world = World((grid,), np.ones_like(heights), flat_world([], []).rocks, (), None, '')
    east, west = shade.horizon_deg(world, [0.0, 180.0], height_m=0.3)
    assert east == pytest.approx(np.degrees(np.arctan(0.7 / 1.5)), abs=0.3)
    # The ground 2 m away, where it ends, 0.3 m below the eye.
    assert west == pytest.approx(-np.degrees(np.arctan(0.3 / 2.0)), abs=0.3)


def curves(figure, title):
    """Return the curves of the axes whose title begins with these words, by label."""
    axes = next(axes for axes in figure.axes if axes.get_title().startswith(title))
    return {line.get_label().split(' ')[0]: line.get_xydata() for line in axes.lines}


@pytest.fixture(scope='module')
def sheet():
    """Return a world and its sheet."""
    world = worlds.small()
    return world, map_sheet.sheet(world, azimuth_deg=250.0, elevation_deg=12.0)


def test_the_sheet_shows_numbers_above_diameters(sheet):
    """Each curve ends at the largest one, alone; at the smallest it is the density of all."""
    world, figure = sheet
    rocks = curves(figure, 'rocks')
    own, law = rocks['this'], rocks['k']
    area = (2.0 * world.ground.half_extent_m)**2
    assert len(own) == len(world.rocks)
    assert own[0, 0] == world.rocks.diameter_m.max() and own[0, 1] == pytest.approx(1.0 / area)
    assert own[-1, 0] == world.rocks.diameter_m.min()
    assert own[-1, 1] == pytest.approx(len(world.rocks) / area)
    np.testing.assert_allclose(law[:, 1], rockfield.number_per_m2(world.config.rocks, law[:, 0]))
    assert len(law) > 50 and law[0, 0] == pytest.approx(world.config.rocks.min_diameter_m)
    craters = curves(figure, 'craters')
    for level in world.levels:
        curve = craters['within'] if level is world.levels[-1] else None
        if curve is None:
            continue
        inside = np.abs(world.craters.position_m).max(axis=1) <= level.half_extent_m
        assert curve[0, 0] == pytest.approx(world.craters.diameter_m[inside].max())
        area = (2.0 * level.half_extent_m)**2
        shown = inside & (world.craters.diameter_m >= 8.0 * level.cell_m)
        assert curve[0, 1] == pytest.approx(1.0 / area)
        assert curve[-1, 1] == pytest.approx(np.count_nonzero(shown) / area)
    law = next(line for label, line in craters.items() if label != 'within')
    expected = [density_per_m2(world.config.craters, d) for d in law[:, 0]]
    np.testing.assert_allclose(law[:, 1], expected)
    sun = curves(figure, 'horizon')['sun']
    np.testing.assert_allclose(sun, [[-110.0, 12.0]])


@pytest.mark.parametrize(('samples', 'shown'), [(1025, 1025), (2051, 684)])
def test_maps_of_large_worlds_leave_samples_out(samples, shown):
    """At most 1,025 of them are drawn along a side, evenly spaced over the whole of it."""
    ramp = np.tile(np.linspace(0.0, 1.0, samples, dtype=np.float32), (samples, 1))
    grid = HeightGrid(ramp, 0.05)
    world = World((grid,), np.ones_like(ramp), flat_world([], []).rocks, (), WorldConfig(), '')
    figure = map_sheet.sheet(world, azimuth_deg=90.0, elevation_deg=10.0)
    height = next(axes for axes in figure.axes if axes.get_title() == 'height')
    values = height.images[0].get_array()
    step = (samples - 1) // (shown - 1)
    assert values.shape == (shown, shown)
    np.testing.assert_array_equal(values, ramp[::step, ::step])


@pytest.mark.parametrize('variation', [0.03, 0.08])
def test_patches_of_albedo_have_the_configured_rms(variation):
    """Patches alone, away from the border where they fade: three sizes whose squares add up."""
    world = worlds.world(albedo={'variation': variation, 'grain': 0.0, 'fresh_crater': 0.0},
                         craters={'density': 0.0}, rocks={'abundance': 0.0},
                         surroundings={'samples': 257})
    inner = world.albedo[200:-200, 200:-200]
    assert np.std(inner) == pytest.approx(variation, rel=0.08)
    # They are patches: alike over 2 dm, and hardly over 3.2 m.
    alike = [np.corrcoef(inner[:, lag:].ravel(), inner[:, :-lag].ravel())[0, 1]
             for lag in (8, 128)]
    assert alike[0] > 0.8 and alike[1] < 0.4


def test_grain_of_albedo_differs_from_cell_to_cell():
    world = worlds.small(albedo={'variation': 0.0, 'grain': 0.05, 'fresh_crater': 0.0})
    inner = world.albedo[100:-100, 100:-100]
    assert np.std(inner) == pytest.approx(0.05, rel=0.03)
    assert abs(np.corrcoef(inner[:, 1:].ravel(), inner[:, :-1].ravel())[0, 1]) < 0.02
