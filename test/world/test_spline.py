"""Interpolation between levels against SciPy's natural spline; the nest of levels by its rules."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from lunar_rover_sim.world import levels as nest
from lunar_rover_sim.world.config import LEVEL_RATIO, WorldConfig
from lunar_rover_sim.world.grid import HeightGrid

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


def test_a_finer_level_is_the_spline_of_its_parent():
    """It takes no more of the parent than it needs, and nobody sees where that ends."""
    rng = np.random.default_rng(2)
    heights = rng.normal(size=(61, 61)).astype(np.float32)
    parent = HeightGrid(heights, 2.0)
    found = nest.refine(parent, 65, 0.25)
    axis, fine = nest.axis_m(61, 2.0), nest.axis_m(65, 0.25)
    assert (axis[0], axis[-1]) == (-60.0, 60.0) and (fine[0], fine[-1]) == (-8.0, 8.0)
    np.testing.assert_allclose(found, natural(axis, axis, heights, fine, fine), atol=FORGOTTEN)
    np.testing.assert_allclose(found[::8, ::8], heights[26:35, 26:35], atol=FORGOTTEN)


@pytest.mark.parametrize('size_m,cell_m,extent_m,samples', [
    (51.2, 0.025, 1000.0, 2049), (12.8, 0.025, 1000.0, 257), (204.8, 0.025, 3000.0, 65),
    (8.0, 0.5, 100.0, 100), (16.0, 0.5, 8.0, 257), (16.0, 0.5, 8.1, 65)])
def test_levels_grow_until_they_cover_the_surroundings(size_m, cell_m, extent_m, samples):
    """By eight cells to one; at least twice as wide as the one within; corners meet."""
    config = WorldConfig.from_mapping({'size_m': size_m, 'cell_m': cell_m, 'surroundings': {
        'extent_m': extent_m, 'samples': samples}})
    levels = nest.plan(config)
    half = [0.5 * (n - 1) * cell for n, cell in levels]
    assert levels[0] == (round(size_m / cell_m) + 1, cell_m)
    assert half[-1] >= extent_m and all(h < extent_m for h in half[:-1])
    for (n, cell), (outer_n, outer_cell) in zip(levels, levels[1:]):
        assert outer_cell == cell * LEVEL_RATIO
        assert (outer_n - 1) % (2 * LEVEL_RATIO) == 0
        least = max(samples, 2 * (n - 1) // LEVEL_RATIO + 1)
        assert least <= outer_n < least + 2 * LEVEL_RATIO
        assert (outer_n - 1) * outer_cell >= 2.0 * (n - 1) * cell


@pytest.mark.parametrize('n', [9, 65, 241, 1025])
def test_detail_fades_out_towards_the_border(n):
    """Over 60 cells, or a quarter of a small level, without a kink, alike at both ends."""
    weight = nest.fade(n)
    band = min(60.0, (n - 1) / 4)
    edge = np.minimum(np.arange(n), n - 1 - np.arange(n)) / band
    expected = np.where(edge < 1.0, 3.0 * edge**2 - 2.0 * edge**3, 1.0)
    np.testing.assert_allclose(weight, expected, atol=1e-6)


def test_a_level_meets_its_parent_at_its_border_and_keeps_its_middle():
    rng = np.random.default_rng(3)
    parent = HeightGrid(rng.normal(size=(41, 41)).astype(np.float32), 2.0)
    heights = rng.normal(size=(129, 129)).astype(np.float32)
    fitted = heights.copy()
    nest.fit_border(fitted, 0.25, parent)
    axis = nest.axis_m(129, 0.25)
    coarse = parent.height_at(np.stack(np.meshgrid(axis, axis), axis=-1))
    weight = np.outer(nest.fade(129), nest.fade(129))
    np.testing.assert_allclose(fitted, coarse + weight * (heights - coarse), atol=1e-5)
    closed = heights.copy()
    nest.close_seam(closed, 0.25, parent)
    for edge in (0, -1):
        np.testing.assert_allclose(closed[edge], coarse[edge], atol=1e-6)
        np.testing.assert_allclose(closed[:, edge], coarse[:, edge], atol=1e-6)
    np.testing.assert_array_equal(closed[1:-1, 1:-1], heights[1:-1, 1:-1])
    shown = parent.heights_m.copy()
    nest.embed(shown, heights)
    inner = heights[::8, ::8]
    np.testing.assert_array_equal(shown[13:28, 13:28], inner[1:-1, 1:-1])
    shown[13:28, 13:28] = parent.heights_m[13:28, 13:28]
    np.testing.assert_array_equal(shown, parent.heights_m)
