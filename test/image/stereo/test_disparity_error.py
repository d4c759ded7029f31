"""Errors of a disparity map against the truth, and their causes."""

import dataclasses

import numpy as np
import pytest

from lunar_rover_sim.image.stereo.depth import DisparityMap
from lunar_rover_sim.image.stereo.error import disparity_errors_px, stereo_errors, StereoErrors


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


HEIGHT, WIDTH, TRUTH = 20, 60, 8.0


def judged(image, disparity=None, truth=None, right=None, **thresholds):
    """Return the errors of a map without any disparity, or with the given ones."""
    nothing = np.full((HEIGHT, WIDTH), -1.0, np.float32)
    shown = DisparityMap(nothing if disparity is None else disparity, 0.0, 63.0, 0.0625,
                         (0, 0, WIDTH, HEIGHT))
    level = np.full((HEIGHT, WIDTH), TRUTH, np.float32)
    return stereo_errors(shown, level if truth is None else truth, right, image, **thresholds)


def even(value):
    return np.full((HEIGHT, WIDTH), value, np.uint8)


def test_blocks_darker_than_the_level_are_in_shadow():
    """8 % of 255 is 20.4."""
    for value, shadowed in ((20, True), (21, False)):
        errors = judged(even(value))
        assert (errors.shadowed == errors.ground) == shadowed
        assert (errors.flat == errors.ground) != shadowed


@pytest.mark.parametrize('texture_level,flat', [(0.0, False), (1e-6, True)])
def test_an_even_block_is_low_in_texture_at_any_level_but_zero(texture_level, flat):
    errors = judged(even(128), texture_level=texture_level)
    assert errors.flat == (errors.ground if flat else 0)


def test_errors_are_counted_above_one_and_two_pixels():
    disparity = np.full((HEIGHT, WIDTH), TRUTH, np.float32)
    disparity[0], disparity[1], disparity[2] = TRUTH + 1.0, TRUTH - 1.5, TRUTH + 2.5
    errors = judged(even(128), disparity)
    row = WIDTH - int(TRUTH)
    assert errors.matched == errors.ground == HEIGHT * row
    summary = errors.summary()
    assert summary['bad-1'] == pytest.approx(2.0 / HEIGHT)
    assert summary['bad-2'] == pytest.approx(1.0 / HEIGHT)
    assert summary['end-point error [px]'] == pytest.approx(5.0 / HEIGHT)
    assert summary['RMS error [px]'] == pytest.approx(np.sqrt((1.0 + 2.25 + 6.25) / HEIGHT))
    # Causes of what is not matched are shares of it, with a rest.
    causes = dict(zip(('margin', 'occluded', 'shadowed', 'saturated', 'flat'), (1, 2, 3, 4, 5)))
    shares = dataclasses.replace(errors, matched=errors.ground - 20, **causes).summary()
    assert [value for name, value in shares.items() if name.startswith('invalid')] \
        == pytest.approx([0.05, 0.1, 0.15, 0.2, 0.25, 0.25])
    # What is off by more than the bins reach is in the last one.
    far = judged(even(128), np.full_like(disparity, TRUTH + 4.5))
    assert len(far.signed_counts) == 512 and far.signed_counts[-1] == far.matched
