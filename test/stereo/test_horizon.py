"""The edge of the sky: no row of ground is lost below it, and bad blocks are left out."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from lunar_rover_sim.stereo.config import SgmConfig
from lunar_rover_sim.stereo.sgm import SgmMatcher


def pair(sky, disparity=12, height=160, width=320, seed=0, contrast=230.0):
    """Return a pair shifted by whole pixels, black above `sky` rows."""
    texture = gaussian_filter(np.random.default_rng(seed).random((height, width + disparity)), 1.2)
    texture = (texture - texture.min()) / np.ptp(texture) * contrast + 20.0
    texture[:sky] = 0.0
    texture = texture.astype(np.uint8)
    return texture[:, :width], texture[:, disparity:]


def matched_rows(disparity, value=12.0):
    """Return in which rows nearly all of the window has the right disparity."""
    right = np.abs(disparity.disparity_px[:, 90:-20] - value) < 0.5
    return right.mean(axis=1) > 0.9


@pytest.mark.parametrize('sky', [0, 20, 61, 100])
@pytest.mark.parametrize('block_size', [5, 9, 13])
def test_the_ground_is_matched_from_the_first_whole_block_below_the_sky(sky, block_size):
    disparity = SgmMatcher(SgmConfig(num_disparities=64, block_size=block_size)).match(*pair(sky))
    rows = matched_rows(disparity)
    # Rows whose block lies wholly on the ground; two more for the filter before matching.
    first = sky + block_size // 2 + 2
    assert rows[first:-block_size // 2 - 2].all()
    # What lies above the horizon by more than a block has no disparity.
    assert not disparity.valid[:max(sky - block_size, 0)].any()


def test_a_single_bright_row_at_the_bottom_is_too_little_to_match():
    left, right = pair(155)
    disparity = SgmMatcher(SgmConfig(num_disparities=64, block_size=9)).match(left, right)
    assert disparity.disparity_px.shape == left.shape and not disparity.valid[:140].any()


@pytest.mark.parametrize('level,seen', [(30, True), (31, False)])
def test_what_is_not_brighter_than_the_dark_level_is_sky(level, seen):
    """Both images of one value, 31, with a texture of one step below: dark up to 31, not to 30."""
    rng = np.random.default_rng(1)
    texture = np.where(rng.random((80, 220)) < 0.5, 31, 21).astype(np.uint8)
    config = SgmConfig(num_disparities=64, dark_level=level, min_contrast=0.0)
    disparity = SgmMatcher(config).match(texture[:, :200], texture[:, 10:210])
    assert disparity.valid.any() == seen


@pytest.mark.parametrize('contrast,kept', [(60.0, True), (6.0, False)])
def test_ground_without_contrast_has_no_disparity(contrast, kept):
    """A texture whose deviation within a block lies well above, or below, the least contrast."""
    left, right = pair(0, contrast=contrast)
    deviation = np.std(left[20:, 90:])
    threshold = 3.0
    assert (deviation > 2.0 * threshold) == kept and (deviation < 0.7 * threshold) != kept
    config = SgmConfig(num_disparities=64, min_contrast=threshold, dark_level=0)
    valid = SgmMatcher(config).match(left, right).valid[20:-20, 90:-20]
    assert valid.mean() > 0.8 if kept else valid.mean() < 0.2


def test_the_window_holds_every_pixel_that_can_be_matched():
    """A block of 7: 3 px at each edge, and on the left the least disparity looked for."""
    left, right = pair(0)
    matcher = SgmMatcher(SgmConfig(num_disparities=64, block_size=7))
    assert matcher.match(left, right).valid_window == (3, 3, 320 - 6, 160 - 6)
    shifted = SgmMatcher(SgmConfig(num_disparities=64, block_size=7, min_disparity=4))
    disparity = shifted.match(left, right)
    assert disparity.valid_window == (7, 3, 320 - 7 - 3, 160 - 6)
    assert (disparity.min_disparity_px, disparity.max_disparity_px) == (4.0, 67.0)
    assert disparity.disparity_px.min() == 3.0
    inside = np.s_[3:160 - 3, 7:320 - 3]
    error = np.abs(disparity.disparity_px - 12.0)[inside][disparity.valid[inside]]
    assert error.max() < 0.75 and np.mean(error > 0.25) < 2e-3


def test_the_narrowest_image_for_a_range():
    """Wider than the range by one column is enough."""
    images = [np.zeros((40, 65), np.uint8)] * 2
    SgmMatcher(SgmConfig(num_disparities=64)).match(*images)
    # A block that is wider than the image matches nothing, in a window without width.
    wide = SgmMatcher(SgmConfig(num_disparities=16, block_size=31)).match(
        *[image[:, :17] for image in images])
    assert wide.valid_window == (15, 15, 0, 10)
    assert not wide.valid.any()


def glaring(lamp_px=(70, 160), ghost_px=(95, 200), seed=3):
    """Return a pair with noise, a sun with its halo and a ghost, alike in both, and what is sky.

    The skyline is crooked; the ground has a disparity of 12 px.
    """
    rng = np.random.default_rng(seed)
    left, right = (image.astype(float) for image in pair(0, height=240, contrast=90.0, seed=seed))
    v, u = np.mgrid[:240, :320]
    skyline = 110 + 6 * np.sin(u / 30.0) + 5 * (np.abs(u - 250) < 12)
    sky = v < skyline
    distance = np.hypot(v - lamp_px[0], u - lamp_px[1])
    veil = 60.0 + 400.0 * np.exp(-distance / 16.0)
    ghost = 25.0 * (np.hypot(v - ghost_px[0], u - ghost_px[1]) < 22)
    images = []
    for image in (left, right):
        # The skyline is far away: it has no disparity.
        lit = np.where(sky, 0.0, 40.0 + image) + veil + ghost
        images.append(np.clip(lit + 0.8 * rng.standard_normal(lit.shape), 0, 255)
                      .astype(np.uint8))
    return (*images, sky)


def test_sky_sun_and_ghost_have_no_disparity_and_the_ground_keeps_its_own():
    """Blocks beside the skyline, the halo and the ghost have detail; without the search for the
    sky they are matched."""
    left, right, sky = glaring()
    maps = [SgmMatcher(SgmConfig(num_disparities=64, find_sky=find)).match(left, right)
            for find in (True, False)]
    found, before = (m.valid for m in maps)
    assert before[sky].mean() > 0.04 and found[sky].mean() < 0.005
    below = ~sky & (np.arange(240)[:, None] > 125)
    assert np.array_equal(found[below], before[below]) and found[below][::7].mean() > 0.5


def test_shadow_below_lit_ground_is_not_sky():
    """It is as even; what is matched at its edges stays."""
    left, right = pair(20)
    for image in (left, right):
        image[80:120, 100:] = 0
    maps = [SgmMatcher(SgmConfig(num_disparities=64, find_sky=find)).match(left, right)
            for find in (True, False)]
    assert np.array_equal(*(m.valid[30:] for m in maps))
