"""Filled gaps against the exact solutions of the same equations."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from lunar_rover_sim.world.fill import harmonic_fill, plate_fill


def laplacian(ny, nx):
    """Return the matrix of the Laplacian, through whose edges nothing flows."""
    def along(n):
        ones = np.ones(n)
        ones[[0, -1]] = 0.5
        return sparse.diags([np.ones(n - 1), -2.0 * ones, np.ones(n - 1)], [-1, 0, 1])
    return sparse.kronsum(along(nx), along(ny)).tocsr()


def solved(matrix, values, known):
    """Return the values with the unknown ones such that the matrix gives 0 there."""
    free = np.flatnonzero(~known)
    fixed = np.where(known, values, 0.0).ravel()
    result = fixed.copy()
    result[free] = spsolve(matrix[free][:, free].tocsc(), -(matrix @ fixed)[free])
    return result.reshape(values.shape)


def waves(ny, nx):
    y, x = np.mgrid[:ny, :nx]
    return (3.0 + 0.2 * x - 0.1 * y + np.sin(0.5 * x) * np.cos(0.4 * y)).astype(np.float32)


def with_holes(ny, nx):
    known = np.ones((ny, nx), bool)
    known[4:11, 6:12] = False
    known[ny - 5:, :4] = False
    known[15, 15] = False
    return known


@pytest.mark.parametrize('ny, nx', [(24, 24), (25, 24), (24, 27), (31, 23)])
def test_gaps_are_filled_as_a_membrane(ny, nx):
    values, known = waves(ny, nx), with_holes(ny, nx)
    exact = solved(laplacian(ny, nx), values, known)
    spoilt = np.where(known, values, np.float32(1e3))
    filled = harmonic_fill(spoilt, known)
    assert filled.dtype == np.float32 and np.array_equal(filled[known], values[known])
    # It is relaxed a few times on each grid: to a few hundredths of the range of 7.
    assert np.abs(filled - exact)[~known].max() < 0.3
    assert np.sqrt(np.mean((filled - exact)[~known]**2)) < 0.08


def test_most_of_a_grid_may_be_unknown():
    """One corner known: the value of that everywhere; two sides known: a ramp between them."""
    values = np.zeros((33, 40), np.float32)
    known = np.zeros((33, 40), bool)
    known[0, 0] = True
    values[0, 0] = 7.0
    assert harmonic_fill(values, known) == pytest.approx(7.0, abs=1e-4)
    known[:, 0] = known[:, -1] = True
    values[:, 0], values[:, -1] = 0.0, 39.0
    np.testing.assert_allclose(harmonic_fill(values, known),
                               np.tile(np.arange(40.0), (33, 1)), atol=2.0)


def test_nothing_and_everything_known():
    values = waves(9, 9)
    assert np.array_equal(harmonic_fill(values, np.ones((9, 9), bool)), values)
    assert not harmonic_fill(values, np.zeros((9, 9), bool)).any()
    assert np.array_equal(plate_fill(values, np.ones((9, 9), bool), 0.1), values)
    few = np.zeros((3, 4), bool)
    few[0, 0] = few[2, 3] = True
    filled = harmonic_fill(values[:3, :4], few)
    mean = 0.5 * (values[0, 0] + values[2, 3])
    assert filled[~few] == pytest.approx(mean) and filled[0, 0] == values[0, 0]


def test_the_plate_settles_as_its_equation_says():
    tension, values, known = 0.1, waves(26, 26), with_holes(26, 26)
    flat = laplacian(26, 26)
    exact = solved(flat @ flat - tension * flat, values, known)
    filled = plate_fill(np.where(known, values, np.float32(-50.0)), known, tension)
    assert np.array_equal(filled[known], values[known])
    assert np.abs(filled - exact)[~known].max() < 0.15
    # Smoother than a membrane, whose slope breaks at the border of a gap.
    assert np.abs(filled - exact)[~known].max() < np.abs(
        solved(flat, values, known) - exact)[~known].max()
