"""Maps from orbit of a whole site: the ground on which its windows let a rover drive."""

import dataclasses

import numpy as np
import pytest

from lunar_rover_sim.autonomy.navigation.global_plan import GroundCosts
from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.ground.world import mapped_ground
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.mapped_ground import MappedGround
from lunar_rover_sim.ground.world.orbital_making import orbital_map
from lunar_rover_sim.ground.world.orbital_map import OrbitalConfig
from lunar_rover_sim.ground.world.site import Site

RECIPE = {'size_m': 25.6, 'cell_m': 0.1, 'site_km': 0.5, 'rocks': {'abundance': 0.05},
          'craters': {'max_diameter_m': 30.0},
          'surroundings': {'samples': 65, 'extent_m': 60.0}}
TRUE = OrbitalConfig(photo_pixel_m=0.0, smooth_m=0.0, height_stddev_m=0.0, bias_stddev_m=0.0,
                     tilt_stddev_deg=0.0, crater_place_m=0.0, crater_size=0.0)
FAR = (-179.2, 230.4)


@pytest.fixture(name='site', scope='module')
def _site(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path_factory.mktemp('cache')))
        patch.setattr(mapped_ground, '_CELLS', 128)     # several tiles
        yield Site(WorldConfig.from_mapping(RECIPE), 3)


def test_a_map_of_a_window_is_one_of_all_of_its_site(site):
    made = orbital_map(site.window((12.8, 0.0)), TRUE)
    assert made.bounds_m == pytest.approx((-243.2, -243.2, 243.2, 243.2), abs=2.0)
    assert np.isfinite(made.heights_m).all()
    for middle in ((0.0, 0.0), FAR):
        ground = site.window(middle).ground
        first, pixel = np.array(made.first_m), made.pixel_m
        cell = np.rint((np.array(middle) - first) / pixel).astype(int)
        for column, row in cell + np.array([(0, 0), (-4, 3), (5, 5), (3, -5)]):
            offsets = (np.arange(40) + 0.5) / 40 * pixel - 0.5 * pixel
            places = first + pixel * np.array([column, row]) + np.stack(
                np.meshgrid(offsets, offsets), axis=-1)
            # Without craters of less than 6.4 m, and soil at the feet of rocks.
            assert abs(made.heights_m[row, column] - ground.height_at(places).mean()) < 0.15


def test_its_craters_and_rocks_are_those_of_the_windows(site):
    ground, window = MappedGround.of(site, 2.0), site.window(FAR)
    mapped = ground.craters(4.0)
    there = window.craters.select((window.craters.diameter_m >= 4.0) & (
        np.abs(window.craters.position_m).max(axis=1) < ground.half_extent_m))
    assert len(there) > 5 and np.isin(there.key, mapped.key).all()
    rocks = ground.rocks(0.3, window.ground.box_m)
    large = window.rocks.select(window.rocks.diameter_m >= 0.3)
    keys, i, j = np.intersect1d(large.key, rocks.key, return_indices=True)
    assert len(keys) == len(large) > 3 and len(np.unique(rocks.key)) == len(rocks)
    np.testing.assert_array_equal(large.position_m[i, :2], rocks.position_m[j, :2])
    # The map is without craters of less than 6.4 m, in which some lie.
    assert np.median(np.abs(large.position_m[i, 2] - rocks.position_m[j, 2])) < 0.1


def test_a_photo_has_no_seams_between_tiles(site):
    made = orbital_map(site, dataclasses.replace(TRUE, photo_pixel_m=1.0, photo_noise=0.0))
    values = made.photo.astype(float)
    assert made.photo.min() > 0
    for seam in (128 * 0.8, 0.0, -128 * 0.8):
        line = round((seam - made.photo_first_m[0]) / 1.0)
        for way in (values, values.T):
            at = np.abs(np.diff(way[:, line - 1:line + 2], axis=1)).mean()
            usual = np.abs(np.diff(way[:, line - 20:line + 20], axis=1)).mean()
            assert at < 1.5 * usual


def test_a_photo_of_a_part_is_that_part_of_the_whole(site):
    config = dataclasses.replace(TRUE, photo_pixel_m=1.0, photo_noise=0.0, sun_elevation_deg=8.0)
    whole, part = (orbital_map(site, config, photo_box=box) for box in
                   (None, (-100.5, 60.0, 20.0, 900.0)))
    np.testing.assert_array_equal(part.heights_m, whole.heights_m)
    first = np.rint(np.subtract(part.photo_first_m, whole.photo_first_m)).astype(int)
    rows, columns = part.photo.shape
    assert 160 <= columns <= 162 and 222 <= rows <= 224
    there = whole.photo[first[1]:first[1] + rows, first[0]:first[0] + columns].astype(int)
    # Beyond 40 m of a block, shadows are those of the coarse heights.
    assert there.shape == part.photo.shape and (abs(there - part.photo) <= 2).mean() > 0.99


def test_shadows_of_the_photo_are_those_on_the_ground(site):
    """Cells cost more where rays of our own to the sun hit the ground of a window."""
    sun, craters = (60.0, 3.0), MappedGround.of(site, 2.0).craters(8.0)
    inner = np.abs(craters.position_m).max(axis=1) < 200.0
    middle = site.middle(craters.position_m[np.flatnonzero(inner)[
        np.argmax(craters.diameter_m[inner])]])
    window = site.window(middle)
    to_sun, slope = np.array([np.cos(np.radians(sun[0])), np.sin(np.radians(sun[0]))]), np.tan(
        np.radians(sun[1]))
    seen, relief = (GroundCosts.of(orbital_map(
        site, OrbitalConfig(sun_azimuth_deg=azimuth, sun_elevation_deg=sun[1])), sun_deg=sun)
        for azimuth in (sun[0], sun[0] + 180.0))
    plain = GroundCosts.of(orbital_map(site, OrbitalConfig(photo_pixel_m=0.0)))
    low, cell = np.array(seen.low_m), seen.cell_m
    column, row = np.rint((np.array(middle) - low) / cell).astype(int)
    k = 5               # cells on each side, within the window
    offsets = (np.arange(4) + 0.5) / 4 * cell
    dark = np.empty((2 * k, 2 * k))
    for i in range(2 * k):
        for j in range(2 * k):
            corner = low + cell * np.array([column - k + j, row - k + i])
            places = corner + np.stack(np.meshgrid(offsets, offsets), -1).reshape(-1, 2)
            away = np.arange(0.2, 25.0, 0.1)
            ray = places[:, None] + away[:, None] * to_sun
            over = window.height_at(ray) - window.height_at(places)[:, None] - slope * away
            dark[i, j] = (over > 0.0).any(axis=1).mean()
    part = np.s_[row - k:row + k, column - k:column + k]
    by_photo, by_heights = (np.corrcoef((costs.cost - plain.cost)[part].ravel(),
                                        dark.ravel())[0, 1] for costs in (seen, relief))
    assert 0.02 < dark.mean() < 0.9
    assert by_photo > 0.6 and by_heights < by_photo - 0.3


def test_a_goal_anywhere_on_the_site_is_on_the_plan(site):
    costs = GroundCosts.of(orbital_map(site, OrbitalConfig(photo_pixel_m=0.0)))
    half = np.array(costs.cost.shape[::-1]) * costs.cell_m
    assert np.all(costs.low_m <= np.full(2, -240.0)) and np.all(costs.low_m + half >= 240.0)
    assert costs.known.all() and np.isfinite(costs.cost).mean() > 0.9


def test_a_map_that_would_not_be_held_is_refused(site):
    with pytest.raises(WorldError, match=r'photo_pixel_m: 0\.02 is not valid; valid is >= 0\.0405 '
                       r'\[m\], for 486\.4 m of ground'):
        orbital_map(site, dataclasses.replace(TRUE, photo_pixel_m=0.02))
