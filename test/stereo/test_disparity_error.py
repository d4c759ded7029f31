"""Errors of a disparity map against the truth, and their causes."""

import numpy as np
import pytest

from lunar_rover_sim.stereo.depth import DisparityMap
from lunar_rover_sim.stereo.error import disparity_errors_px, stereo_errors, StereoErrors


def test_errors_are_signed_and_infinity_is_no_finite_depth():
    """A disparity of 0 is a match, but one without finite depth."""
    d = DisparityMap(np.array([[-1.0, 0.0, 5.0, 7.5]], np.float32), 0.0, 63.0, 0.0625,
                     (0, 0, 4, 1))
    truth = np.array([[3.0, 3.0, 6.0, 7.0]], np.float32)
    assert d.valid.tolist() == [[False, True, True, True]]
    assert d.has_finite_depth.tolist() == [[False, False, True, True]]
    np.testing.assert_array_equal(disparity_errors_px(d, truth, d.has_finite_depth), [-1.0, 0.5])


@pytest.mark.parametrize('shift', [-0.5, -0.11, 0.25, 7.0])
def test_the_median_error_has_its_sign(shift):
    """Half of the pixels scatter to either side; beyond 4 px the bins end."""
    truth = np.full((20, 100), 10.0, np.float32)
    scatter = np.random.default_rng(0).normal(0.0, 0.2, truth.shape)
    found = DisparityMap((truth + shift + scatter).astype(np.float32), 0.0, 63.0, 0.0625,
                         (0, 0, 100, 20))
    errors = stereo_errors(found, truth, None, np.full(truth.shape, 100, np.uint8))
    expected = min(shift, 4.0)
    assert (errors + errors).median_px == pytest.approx(expected, abs=0.03)
    assert errors.summary()['mean signed error [px]'] == pytest.approx(shift, abs=0.02)
    assert np.isnan(StereoErrors().median_px)


def test_errors_of_a_known_map():
    truth = np.full((20, 100), 10.0, np.float32)
    d = truth.copy()
    d[:5] += 1.5
    d[5:7] += 3.0
    d[7:10] = -1.0
    image = np.random.default_rng(0).integers(60, 255, truth.shape, dtype=np.uint8)
    image[7:10] = 0
    errors = stereo_errors(DisparityMap(d, 0.0, 63.0, 0.0625, (0, 0, 100, 20)), truth, truth,
                           image, block_px=1)
    summary = errors.summary()
    # The leftmost ten columns have no match in the other image.
    assert errors.ground == 20 * 90
    assert summary['density'] == pytest.approx(17 / 20)
    assert summary['bad-1'] == pytest.approx(7 / 17)
    assert summary['bad-2'] == pytest.approx(2 / 17)
    assert summary['end-point error [px]'] == pytest.approx((5 * 1.5 + 2 * 3.0) / 17)
    assert summary['invalid: in shadow'] == 1.0
    assert (errors + StereoErrors()) == errors
    # Ten of seventeen rows are right, the others too near; a bin is 1/64 px.
    assert summary['median signed error [px]'] == pytest.approx(0.0, abs=1 / 64)
    assert summary['mean signed error [px]'] == pytest.approx((5 * 1.5 + 2 * 3.0) / 17)
    assert (errors + errors).summary() == pytest.approx(summary, nan_ok=True)
    # Where the matcher does not look, at full scale, or without texture there is another cause.
    window = DisparityMap(d, 0.0, 63.0, 0.0625, (10, 8, 90, 12))
    image[8], image[9] = 255, 100
    causes = stereo_errors(window, truth, truth, image, block_px=1)
    assert (causes.margin, causes.saturated, causes.flat) == (90, 90, 90)
    assert causes.occluded == causes.shadowed == 0
    hidden = truth.copy()
    hidden[9, :45] = 20.0
    seen = stereo_errors(window, truth, hidden, image, block_px=1)
    assert (seen.occluded, seen.flat) == (45, 45)
    assert np.isnan(StereoErrors().summary()['density'])
