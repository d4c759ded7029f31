"""Heights between samples, and where samples are missing."""

import numpy as np
import pytest
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import spsolve

from lunar_rover_sim.ground.world import levels as nest
from lunar_rover_sim.ground.world import spline
from lunar_rover_sim.ground.world.fill import harmonic_fill, plate_fill
from lunar_rover_sim.ground.world.spline import Area

# Eight samples beyond the ends stand for all: a spline forgets by sqrt(3) - 2 a sample.
FORGOTTEN = 4.0 * (2.0 - 3.0**0.5)**8


def natural(y, x, values, y_at, x_at):
    """Return the bicubic natural spline at a grid, positions beyond the ends at the ends."""
    rows = CubicSpline(y, values, axis=0, bc_type='natural')(np.clip(y_at, y[0], y[-1]))
    return CubicSpline(x, rows, axis=1, bc_type='natural')(np.clip(x_at, x[0], x[-1]))


@pytest.mark.parametrize('rows,columns', [(12, 31), (40, 17), (9, 10)])
def test_the_surface_is_the_natural_spline(rows, columns):
    """In all intervals, at samples, at both ends and beyond them; of any origin and step."""
    rng = np.random.default_rng(rows)
    y, x = -3.0 + 0.5 * np.arange(rows), 7.0 + 1.7 * np.arange(columns)
    values = rng.normal(size=(rows, columns))
    y_at = np.sort(np.concatenate([y, rng.uniform(y[0] - 1.0, y[-1] + 1.0, 90)]))
    x_at = np.concatenate([x, rng.uniform(x[0] - 3.0, x[-1] + 3.0, 80), [x[-1] - 1e-9]])
    found = nest.spline(y, x, values, y_at, x_at)
    assert found.shape == (len(y_at), len(x_at)) and found.dtype == np.float32
    np.testing.assert_allclose(found, natural(y, x, values, y_at, x_at), atol=FORGOTTEN)


def test_few_samples_are_interpolated_all_the_same():
    """Of two samples a straight line, of three a bend whose ends are straight."""
    at = np.linspace(-0.5, 2.5, 13)
    for n in (2, 3):
        axis = np.arange(float(n))
        values = np.outer(axis**2 + 1.0, 1.0 - axis)
        found = nest.spline(axis, axis, values, at, at)
        np.testing.assert_allclose(found, natural(axis, axis, values, at, at) if n > 2 else
                                   np.outer(1.0 + np.clip(at, 0, 1), 1.0 - np.clip(at, 0, 1)),
                                   atol=FORGOTTEN)


def test_a_finer_lattice_is_the_spline_of_a_coarse_area():
    rng = np.random.default_rng(2)
    values = rng.normal(size=(70, 81))
    coarse = Area(values, (-30, -12), 2.0)
    found = spline.refined(coarse, (-30, 70), (57, 49), 8)
    y, x = -12.0 + np.arange(70), -30.0 + np.arange(81)
    expected = natural(y, x, values, (70.0 + np.arange(57)) / 8.0, (-30.0 + np.arange(49)) / 8.0)
    # The filter is cut after 16 samples.
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize('ratio', [2, 8])
def test_the_spline_of_a_place_is_the_same_in_all_areas(ratio):
    rng = np.random.default_rng(3)
    values = rng.normal(size=(120, 130)).astype(np.float32)
    wide = Area(values, (-70, -60), 0.2)
    for first, shape in (((-40, -33), (60, 51)), ((-7, 0), (9, 17)), ((3, -30), (1, 1))):
        begin, size = spline.needed(first, shape, ratio)
        whole = spline.refined(wide, (-45, -40), (100, 120), ratio)
        part = spline.refined(wide.part(begin, size), first, shape, ratio)
        row, column = first[1] + 40, first[0] + 45
        np.testing.assert_array_equal(part, whole[row:row + shape[0], column:column + shape[1]])
    with pytest.raises(ValueError, match='is not within'):
        spline.refined(wide, (0, 0), (1000, 1000), ratio)


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
