"""Why pixels have no disparity: thresholds of light and texture, met from both sides."""

import numpy as np
import pytest

from lunar_rover_sim.stereo.error import stereo_errors
from lunar_rover_sim.stereo.sgm import DisparityMap

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


def test_a_chequer_has_the_texture_of_half_its_step():
    """Values of 100 and 110: a deviation of 5 / 255 = 0.0196 within any even block."""
    chequer = np.where((np.arange(HEIGHT)[:, None] + np.arange(WIDTH)) % 2, 100, 110)
    image = chequer.astype(np.uint8)
    for level, flat in ((0.0190, False), (0.0200, True)):
        errors = judged(image, texture_level=level, block_px=7)
        assert (errors.flat > 0.9 * errors.ground) == flat
        assert (errors.flat == 0) != flat


def test_a_third_of_full_scale_pixels_saturates_a_block():
    """Columns at full scale, one in two or one in four; the rest is lit and textured."""
    columns = np.arange(WIDTH)
    for every, saturated in ((2, True), (4, False)):
        image = np.tile(np.where(columns % every == 0, 255, 90), (HEIGHT, 1)).astype(np.uint8)
        errors = judged(image, block_px=8)
        assert (errors.saturated > 0.9 * errors.ground) == saturated


def test_ground_is_what_can_be_matched():
    """In the range of the search, at least a quarter pixel, and seen in the other image."""
    truth = np.zeros((HEIGHT, WIDTH), np.float32)
    truth[1], truth[2], truth[3], truth[4] = 0.2, 0.25, 63.0, 63.5
    errors = judged(even(128), truth=truth)
    # Row 2: from column 1 on, row 3: none of the 60 columns reaches 63 px back.
    assert errors.ground == WIDTH - 1
    truth[3] = 50.0
    assert judged(even(128), truth=truth).ground == WIDTH - 1 + 10


def test_hidden_pixels_are_those_with_something_nearer_in_the_other_image():
    right = np.full((HEIGHT, WIDTH), TRUTH, np.float32)
    right[:, 20:30] = TRUTH + 1.5     # nearer by more than a pixel; seen from the left at +8
    errors = judged(even(128), right=right)
    assert errors.occluded == HEIGHT * 10
    right[:, 20:30] = TRUTH + 0.5
    assert judged(even(128), right=right).occluded == 0


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
