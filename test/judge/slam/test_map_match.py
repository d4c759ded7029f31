"""The likelihood of places on a map, and how well wrong ones fit."""

from judge.slam import relief_walk
import numpy as np
import pytest

from lunar_rover_sim.judge.slam.graph.map_match import Cells, chance, Likelihood, match, Relief


def cells(length_m=50.0):
    """Return the heights of a strip two cells wide of the ground of seed 0, from the origin on."""
    x, y = np.meshgrid(np.arange(1.0, length_m, 2.0), [-1.0, 1.0])
    xy = np.column_stack([x.ravel(), y.ravel()])
    return Cells(xy, relief_walk.height_at(0, xy), np.full(len(xy), 0.03), xy[:, 0], 0,
                 0.5 * length_m)


@pytest.mark.parametrize(('middle_m', 'reach_m'),
                         [((3.3, -4.1), 20.0), ((130.0, -140.0), 60.0)])
def test_the_grid_has_the_likelihood_of_each_of_its_places(middle_m, reach_m):
    """It ends where the map does."""
    orbital = relief_walk.orbital(0)
    likelihood = Likelihood(orbital, cells())
    shifts, square = likelihood.on_grid(np.array(middle_m), reach_m)
    single, _ = likelihood.at(shifts.reshape(-1, 2))
    np.testing.assert_allclose(square.ravel(), single, rtol=1e-6)
    assert np.abs(shifts - middle_m).max() <= reach_m
    first, last = orbital.first_m[0], -orbital.first_m[0]
    reached = shifts.reshape(-1, 2)[:, None] + cells().xy_m
    assert reached.min() >= first and reached.max() <= last
    most = np.minimum(np.add(middle_m, reach_m), last - cells().xy_m.max(axis=0))
    assert (shifts.max(axis=(0, 1)) >= most - 0.5 * orbital.pixel_m).all()


def test_beyond_the_map_there_is_no_match():
    assert match(relief_walk.orbital(0), cells(), np.array([400.0, 0.0]), 20.0) is None


@pytest.mark.parametrize(('seed', 'length_m', 'low', 'high'), [
    (0, 50.0, 0.0, 1e-3), (0, 12.0, 0.02, 1.0), (7, 50.0, 0.05, 1.0), (8, 50.0, 0.05, 1.0)])
def test_a_wrong_place_fits_as_well_where_little_was_seen_or_the_map_is_another(
        seed, length_m, low, high):
    orbital, middle = relief_walk.orbital(seed), np.array([15.0, -10.0])
    found = match(orbital, cells(length_m), middle, 50.0)
    assert low <= chance(orbital, cells(length_m), middle, 50.0, found) <= high
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
