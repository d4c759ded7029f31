"""The likelihood of places on a map, and how well wrong ones fit."""

from judge.slam import relief_walk
import numpy as np
import pytest

from lunar_rover_sim.ground.world.orbital_map import bilinear
from lunar_rover_sim.judge.slam.graph.map_match import chance, Likelihood, match
from lunar_rover_sim.judge.slam.graph.photo import Photo
from lunar_rover_sim.judge.slam.graph.relief import Cells, Facets, Relief


def cells(length_m=50.0):
    """Return the heights of a strip two cells wide of the ground of seed 0, from the origin on."""
    x, y = np.meshgrid(np.arange(1.0, length_m, 2.0), [-1.0, 1.0])
    xy = np.column_stack([x.ravel(), y.ravel()])
    return Cells(xy, relief_walk.height_at(0, xy), np.full(len(xy), 0.03), xy[:, 0], 0,
                 0.5 * length_m)


def facets(length_m=50.0):
    """Return the slopes of a strip three metres wide of that ground."""
    x, y = np.meshgrid(np.arange(0.5, length_m, 1.0), [-1.0, 0.0, 1.0])
    xy = np.column_stack([x.ravel(), y.ravel()])
    rise = [relief_walk.height_at(0, xy + step) - relief_walk.height_at(0, xy - step)
            for step in np.diag([0.5, 0.5])]
    return Facets(xy, np.column_stack(rise), np.zeros(len(xy)))


@pytest.mark.parametrize('has_photo', [False, True])
@pytest.mark.parametrize(('middle_m', 'reach_m'),
                         [((3.3, -4.1), 20.0), ((130.0, -140.0), 60.0)])
def test_the_grid_has_the_likelihood_of_each_of_its_places(middle_m, reach_m, has_photo):
    """It ends where the map does."""
    orbital = relief_walk.orbital(0)
    photo = Photo.of(relief_walk.with_photo(orbital, 0)) if has_photo else None
    likelihood = Likelihood(orbital, cells(), photo, facets() if has_photo else None)
    shifts, square = likelihood.on_grid(np.array(middle_m), reach_m)
    single, _ = likelihood.at(shifts.reshape(-1, 2))
    np.testing.assert_allclose(square.ravel(), single, rtol=1e-6)
    assert np.abs(shifts - middle_m).max() <= reach_m
    first, last = orbital.first_m[0], -orbital.first_m[0]
    reached = shifts.reshape(-1, 2)[:, None] + cells().xy_m
    assert reached.min() >= first and reached.max() <= last
    most = np.minimum(np.add(middle_m, reach_m), last - cells().xy_m.max(axis=0))
    # The photo may end up to half of a pixel of its own beside the heights.
    assert (shifts.max(axis=(0, 1)) >= most - orbital.pixel_m).all()


def test_a_photo_tells_the_place_of_a_short_way():
    """Heights alone leave other places; on a photo of other ground a wrong place fits as well."""
    orbital, middle = relief_walk.orbital(0), np.array([15.0, -10.0])
    photo, wrong = (Photo.of(relief_walk.with_photo(orbital, seed)) for seed in (0, 7))
    blind, told, misled = (Likelihood(orbital, cells(20.0), *more)
                           for more in ((), (photo, facets(20.0)), (wrong, facets(20.0))))
    found = match(told, middle, 50.0)
    assert found.fits and np.linalg.norm(found.shift_m[:2]) < 0.5
    assert found.others < 0.01 < 0.1 < match(blind, middle, 50.0).others
    assert chance(told, middle, 50.0, found) < 0.01 < 0.05 < chance(
        misled, middle, 50.0, match(misled, middle, 50.0))


def test_slopes_are_as_bright_as_they_are_on_the_photo():
    photo, some = Photo.of(relief_walk.with_photo(relief_walk.orbital(0), 0)), facets()
    value, covariance = photo.expected(some)
    there = bilinear(photo.values, photo.first_m, photo.pixel_m, some.xy_m)
    off = there - value - np.mean(there - value)
    assert np.corrcoef(there, value)[0, 1] > 0.9
    assert np.std(off) < np.sqrt(np.diag(covariance).max())


def test_a_map_without_a_photo_has_none():
    assert Photo.of(relief_walk.orbital(0)) is None


def test_beyond_the_map_there_is_no_match():
    assert match(Likelihood(relief_walk.orbital(0), cells()), np.array([400.0, 0.0]), 20.0) is None


@pytest.mark.parametrize(('seed', 'length_m', 'low', 'high'), [
    (0, 50.0, 0.0, 1e-3), (0, 12.0, 0.02, 1.0), (7, 50.0, 0.05, 1.0), (8, 50.0, 0.05, 1.0)])
def test_a_wrong_place_fits_as_well_where_little_was_seen_or_the_map_is_another(
        seed, length_m, low, high):
    likelihood = Likelihood(relief_walk.orbital(seed), cells(length_m))
    middle = np.array([15.0, -10.0])
    found = match(likelihood, middle, 50.0)
    assert low <= chance(likelihood, middle, 50.0, found) <= high
    assert (seed, length_m) != (0, 50.0) or np.linalg.norm(found.shift_m[:2]) < 1.0


def test_the_spread_of_a_slope_is_no_error():
    """Points of a plane say the height of their mean place; those of a rough ground do not."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(0.0, 2.0, (60, 2)), np.zeros(60)])
    sigma = []
    for rough_m in (0.0, 0.1):
        relief = Relief(80.0)
        z = 0.3 * points[:, 0] - 0.2 * points[:, 1] + rough_m * rng.standard_normal(60)
        relief.add(0, np.eye(4), np.column_stack([points[:, :2], z]), np.eye(4))
        sigma.append(relief.cells({0: np.eye(4)}, 2.0).sigma_m[0])
    assert sigma[0] < 0.04 < 0.1 < sigma[1]
