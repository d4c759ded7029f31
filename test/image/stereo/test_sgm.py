"""Matching: planes of known disparity, what is invalid, and what is refused."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from lunar_rover_sim.base.errors import ConfigError, StereoError
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.camera.distortion import undistort
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.stereo.config import SgmConfig
from lunar_rover_sim.image.stereo.depth import (depth_from_disparity, disparity_from_depth,
                                                DisparityMap)
from lunar_rover_sim.image.stereo.sgm import refined, SgmMatcher, unexplained
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.run.scenario import Scenario


def textured_pair(disparity_px, height=240, width=400, sky=60, seed=0):
    """Return a pair whose rows are shifted by (height,) disparities; black above `sky`."""
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.random((height, width + 300)).astype(np.float32), (0, 0), 1.3)
    texture = (texture - texture.min()) / np.ptp(texture) * 230 + 20
    columns = np.arange(width, dtype=float)
    left, right = (np.zeros((height, width), np.uint8) for _ in range(2))
    for row in range(sky, height):
        # Left column u and right column u - d show the same point.
        left[row] = np.interp(columns, np.arange(texture.shape[1]), texture[row])
        right[row] = np.interp(columns + disparity_px[row], np.arange(texture.shape[1]),
                               texture[row])
    return left, right


def plane(mode, **settings):
    """Return the signed errors [px] on ground that comes nearer row by row; NaN: none."""
    truth = np.maximum(np.arange(240) - 60, 0) * 0.25 + 3.0
    left, right = textured_pair(truth)
    disparity = SgmMatcher(SgmConfig(mode=mode, num_disparities=64, **settings)).match(left, right)
    inside = np.zeros(left.shape, bool)
    inside[70:-8, 80:-10] = True
    return np.where(disparity.valid, disparity.disparity_px - truth[:, None], np.nan)[inside]


@pytest.mark.parametrize('mode', ['sgbm', 'hh', 'hh4', '3way'])
def test_no_mode_is_biased(mode):
    error_px = plane(mode)
    assert np.mean(np.isfinite(error_px)) > 0.95
    assert abs(np.nanmedian(error_px)) < 0.03
    assert np.nanmedian(np.abs(error_px)) < 0.06
    assert np.mean(np.abs(error_px[np.isfinite(error_px)]) > 1.0) < 0.01


@pytest.mark.parametrize('mode', ['sgbm', '3way'])
def test_without_refinement_modes_that_look_down_more_than_up_are(mode):
    assert np.nanmedian(plane(mode, refinement=False)) < -0.05


DISTORTION = (-0.25, 0.08, 0.001, -0.001, 0.0)


def test_pairs_of_distorting_cameras_are_rectified_first():
    """As without distortion; matched as they come, half of the pixels are wrong by a pixel."""
    rig = StereoRig(load_rover(), CameraConfig(width=400, height=240, distortion=DISTORTION))
    truth = np.maximum(np.arange(240) - 60, 0) * 0.25 + 3.0
    centre = rig.K[:2, 2]
    raw = np.stack(np.meshgrid(np.arange(400), np.arange(240)), axis=-1)
    shown = (undistort((raw - centre) / rig.focal_px, DISTORTION) * rig.focal_px + centre).astype(
        np.float32)
    left, right = (cv2.remap(image, shown, None, cv2.INTER_CUBIC)
                   for image in textured_pair(truth))
    inside = np.s_[80:-20, 110:-20]
    wrong = []
    for cameras in (rig, None):
        found = SgmMatcher(SgmConfig(num_disparities=64), cameras).match(left, right)
        error_px = np.where(found.valid, found.disparity_px - truth[:, None], np.nan)[inside]
        wrong.append(np.nanmean(np.abs(error_px) > 1.0))
        if cameras is rig:
            assert np.mean(np.isfinite(error_px)) > 0.9
            assert abs(np.nanmedian(error_px)) < 0.05
    assert wrong[0] < 0.02 and wrong[1] > 0.3
    with pytest.raises(StereoError, match=r'shape \(120, 400\) is not valid; valid is that of'):
        SgmMatcher(SgmConfig(num_disparities=64), rig).match(left[:120], right[:120])


def test_what_no_pixel_has_seen_has_no_disparity():
    """With a pincushion's distortion corners of the rectified image lie outside the raw one."""
    rig = StereoRig(load_rover(), CameraConfig(width=400, height=240,
                                               distortion=(0.25, 0.0, 0.0, 0.0, 0.0)))
    matcher = SgmMatcher(SgmConfig(num_disparities=64), rig)
    left, right = textured_pair(np.full(240, 10.0), sky=0)
    assert not matcher.rectified(left)[:8, -8:].any() and matcher.rectified(left)[120, 200]
    valid = matcher.match(left, right).valid
    assert not valid[:8, -8:].any() and valid[120, 200]


def test_refinement_finds_a_shift_of_a_fraction_whatever_the_noise():
    """A plane at 20.3 px, with noise of a twentieth of the contrast."""
    left, right = textured_pair(np.full(240, 20.3), sky=0)
    rng = np.random.default_rng(3)
    left, right = (np.clip(image + rng.normal(0.0, 3.0, image.shape), 0, 255).astype(np.uint8)
                   for image in (left, right))
    start = np.full(left.shape, 19.9, np.float32)
    found = refined(start, np.ones(left.shape, bool), left, right)[10:-10, 40:-10]
    assert np.median(found) == pytest.approx(20.3, abs=0.03)
    assert np.std(found) < 0.1


def test_refinement_takes_nothing_from_across_an_edge():
    """A block at 30 px before a wall at 10 px: each side keeps its own disparity."""
    truth = np.full((120, 300), 10.0, np.float32)
    truth[40:80, 150:230] = 30.0
    rng = np.random.default_rng(5)
    near, far = (cv2.GaussianBlur(rng.uniform(0, 255, (120, 400)).astype(np.float32), (0, 0), 1.0)
                 for _ in range(2))
    left, right = far[:, :300].copy(), far[:, 10:310].copy()
    left[40:80, 150:230] = near[40:80, 150:230]
    right[40:80, 120:200] = near[40:80, 150:230]
    found = refined(truth, np.ones(truth.shape, bool), *(image.astype(np.uint8)
                                                         for image in (left, right)))
    assert np.abs(found - truth).max() < 2.0
    assert np.abs(found[48:72, 158:222] - 30.0).max() < 0.3


def test_the_left_margin_is_matched_as_far_as_the_right_camera_sees():
    """At 40 px of disparity the right image ends at column 40 of the left one."""
    left, right = textured_pair(np.full(240, 40.0))
    disparity = SgmMatcher(SgmConfig(num_disparities=64)).match(left, right)
    seen = disparity.valid[70:-8]
    assert seen[:, 46:64].mean() > 0.95
    assert np.abs(disparity.disparity_px[70:-8, 46:64][seen[:, 46:64]] - 40.0).max() < 0.5
    assert not (disparity.disparity_px[disparity.valid] > np.nonzero(disparity.valid)[1]).any()
    assert seen[:, :40].mean() < 0.05


@pytest.mark.parametrize('half', [True, False])
def test_points_beyond_infinity_are_matched_up_to_the_right_edge(half):
    """A negative disparity, as of toed-in cameras: the right image ends on the other side."""
    right, left = textured_pair(np.full(240, 6.0))
    disparity = SgmMatcher(SgmConfig(min_disparity=-16, num_disparities=64,
                                     half_resolution=half)).match(left, right)
    x, _, width, _ = disparity.valid_window
    assert (x, x + width) == (3, 400 - 3 - 16)
    seen = disparity.valid[70:-8]
    assert seen[:, 10:400 - 12].mean() > 0.95
    assert np.median(disparity.disparity_px[70:-8][seen]) == pytest.approx(-6.0, abs=0.02)


@pytest.mark.parametrize(('least', 'disparity_px', 'half'), [
    *((-16, d, half) for d in (-14.0, -5.0, 20.0) for half in (True, False)),
    (-7, -6.5, True), (0, 1.0, True), (0, 1.0, False), (5, 6.0, True), (8, 30.0, True),
    (8, 30.0, False)])
def test_the_left_margin_has_the_whole_range_of_disparities(least, disparity_px, half):
    """It is matched at half the resolution, with the bounds of the rest of the image."""
    left, right = textured_pair(np.full(240, disparity_px))
    config = SgmConfig(min_disparity=least, num_disparities=64, half_resolution=half)
    disparity = SgmMatcher(config).match(left, right)
    columns = slice(8 + max(int(disparity_px), 0), max(least + 64, 0))
    seen = disparity.valid[70:-8, columns]
    assert seen.size and seen.mean() > 0.9
    found = disparity.disparity_px[70:-8, columns][seen]
    assert np.median(np.abs(found - disparity_px)) < 0.3


@pytest.mark.parametrize('least', [-16, 0, 6, 20])
def test_what_has_no_match_is_invalid_in_the_left_margin_too(least):
    """Two images of different ground: what is taken for a match by chance is as rare there."""
    left = textured_pair(np.zeros(240), seed=1)[0]
    right = textured_pair(np.zeros(240), seed=2)[0]
    disparity = SgmMatcher(SgmConfig(min_disparity=least, num_disparities=64)).match(left, right)
    margin, rest = (disparity.valid[70:-8, columns].mean()
                    for columns in (slice(0, least + 64), slice(least + 64, None)))
    assert 0.0 < rest < 0.4 and margin < 1.2 * rest
    assert np.all(disparity.disparity_px[disparity.valid] >= least)


def test_sky_is_not_matched():
    truth = np.full(240, 10.0)
    left, right = textured_pair(truth)
    disparity = SgmMatcher(SgmConfig(num_disparities=64)).match(left, right)
    assert not disparity.valid[:50].any()
    assert np.all(disparity.disparity_px[~disparity.valid] == disparity.min_disparity_px - 1.0)
    black = np.zeros_like(left)
    assert not SgmMatcher(SgmConfig(num_disparities=64)).match(black, black).valid.any()


def test_leaving_the_sky_out_changes_nothing_below():
    truth = np.maximum(np.arange(240) - 60, 0) * 0.2 + 5.0
    left, right = textured_pair(truth)
    a = SgmMatcher(SgmConfig(num_disparities=64)).match(left, right)
    b = SgmMatcher(SgmConfig(num_disparities=64, dark_level=0)).match(left, right)
    below = np.s_[80:, 80:]
    both = a.valid[below] & b.valid[below]
    assert both.mean() > 0.9
    assert np.mean(a.valid[below] != b.valid[below]) < 0.02
    difference = np.abs(a.disparity_px - b.disparity_px)[below][both]
    assert np.mean(difference > 0.5) < 0.005


def test_depth_and_disparity_are_inverse():
    depth = np.array([[0.4, 2.0, 50.0]], np.float32)
    d = disparity_from_depth(depth, 457.0, 0.1)
    back = depth_from_disparity(DisparityMap(d, 0.0, 127.0, 0.0625, (0, 0, 3, 1)), 457.0, 0.1)
    np.testing.assert_allclose(back, depth, rtol=1e-6)
    special = DisparityMap(np.array([[-1.0, 0.0]], np.float32), 0.0, 127.0, 0.0625, (0, 0, 2, 1))
    depth = depth_from_disparity(special, 457.0, 0.1)
    assert np.isnan(depth[0, 0]) and np.isinf(depth[0, 1])
    assert disparity_from_depth([[np.inf]], 457.0, 0.1)[0, 0] == 0.0


def test_a_matcher_of_a_scenario_knows_the_depth():
    """Focal length and baseline are those of the scenario's cameras."""
    scenario = Scenario.load('baseline', ['render_node.camera.width=400',
                                          'render_node.sgm.num_disparities=64',
                                          'rover.stereo.baseline_m=0.12'])
    matcher = scenario.matcher()
    left, right = textured_pair(np.full(240, 20.0))
    disparity = matcher.match(left, right)
    focal_px = 200.0 / np.tan(np.radians(0.5 * scenario.render_node.camera.horizontal_fov_deg))
    seen = disparity.valid
    assert matcher.config == scenario.render_node.sgm and seen.mean() > 0.3
    np.testing.assert_allclose(disparity.depth_m[seen] * disparity.disparity_px[seen],
                               0.12 * focal_px, rtol=1e-5)
    assert np.all(np.isnan(disparity.depth_m[~seen]))
    with pytest.raises(ConfigError, match='focal length and baseline of the pair are not known'):
        SgmMatcher(scenario.render_node.sgm).match(left, right).depth_m


def test_shapes_are_checked():
    matcher = SgmMatcher(SgmConfig(num_disparities=64))
    with pytest.raises(StereoError, match='right: shape'):
        matcher.match(np.zeros((10, 200), np.uint8), np.zeros((10, 201), np.uint8))
    with pytest.raises(StereoError, match='less than the image width'):
        matcher.match(np.zeros((10, 50), np.uint8), np.zeros((10, 50), np.uint8))


@pytest.mark.parametrize('image, said', [
    (np.zeros((80, 200)), r'float64 \(80, 200\)'), (np.zeros((80, 200), np.int32), 'int32 .*'),
    (np.zeros((80, 200), np.uint32), 'uint32 .*'), (np.zeros((80, 200, 4), np.uint8), 'uint8 .*'),
    (np.zeros(200, np.uint8), 'uint8 .*'), (None, 'None'), ('left.png', "'left.png'")])
def test_what_is_no_image_is_refused(image, said):
    """Images in 0..1 were matched as black ones: 0 % valid without a word."""
    matcher = SgmMatcher(SgmConfig(num_disparities=64))
    good = np.zeros((80, 200), np.uint8)
    for name, pair in (('left', (image, good)), ('right', (good, image))):
        with pytest.raises(StereoError, match=rf'^{name}: {said} is not valid; valid is uint8 or '
                           r'uint16, \(h, w\) or \(h, w, 3\)$'):
            matcher.match(*pair)


@pytest.mark.parametrize('dtype', ['uint8', '<u2', '>u2'])
@pytest.mark.parametrize('channels', [(), (3,)])
def test_images_of_all_encodings_match_alike(dtype, channels):
    """8 and 16 bits, grey and colour."""
    left, right = textured_pair(np.full(120, 10.0), height=120, width=200, sky=0)
    matcher = SgmMatcher(SgmConfig(num_disparities=32))
    expected = matcher.match(left, right)
    scale = 1 if dtype == 'uint8' else 256
    pair = [(image.reshape(120, 200, *(1,) * len(channels)) * np.ones(channels)
             * scale).astype(dtype) for image in (left, right)]
    np.testing.assert_array_equal(matcher.match(*pair).disparity_px, expected.disparity_px)


@pytest.mark.parametrize('block', [5, 7, 9])
def test_matches_keep_half_a_block_from_the_edges(block):
    """The block around a match lies in both images, at the upper edge and on the sides."""
    left, right = textured_pair(np.full(120, 10.0), height=120, width=200, sky=0)
    found = SgmMatcher(SgmConfig(num_disparities=32, block_size=block, speckle_window_px=0)).match(
        left, right)
    margin = block // 2
    assert not found.valid[:margin].any() and found.valid[margin, 60:-60].mean() > 0.8
    matched = (np.arange(200) - found.disparity_px)[found.valid]
    # Disparities are cut to the range by less than a pixel after that was looked at.
    assert matched.min() >= margin - 1.0 and matched.max() <= 199 - margin
    assert found.valid_window == (margin, margin, 200 - 2 * margin, 120 - 2 * margin)


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


@pytest.mark.parametrize('contrast,kept', [(60.0, True), (12.0, False)])
def test_ground_without_contrast_has_no_disparity(contrast, kept):
    """A texture whose deviation within a block lies well above, or below, the least contrast."""
    left, right = pair(0, contrast=contrast)
    deviation = np.std(left[20:, 90:])
    threshold = 3.0
    assert (deviation > 2.0 * threshold) == kept and (deviation < 0.7 * threshold) != kept
    config = SgmConfig(num_disparities=64, min_contrast=threshold, dark_level=0)
    valid = SgmMatcher(config).match(left, right).valid[20:-20, 90:-20]
    assert valid.mean() > 0.8 if kept else valid.mean() < 0.2


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


def test_nothing_but_sky_with_the_sun_and_nothing_of_it():
    """The search ends at the last row, or with the first."""
    left, right, _ = glaring()
    upper = SgmMatcher(SgmConfig(num_disparities=64)).match(left[:90], right[:90])
    assert upper.valid.mean() < 0.005
    maps = [SgmMatcher(SgmConfig(num_disparities=64, find_sky=find)).match(left[130:], right[130:])
            for find in (True, False)]
    assert np.array_equal(*(m.valid for m in maps))


def test_detail_that_is_all_alike_is_explained_and_other_detail_is_not():
    """0 for equal detail, whatever the brightness; 1 for independent detail; else the share."""
    rng = np.random.default_rng(2)
    one, other = rng.integers(60, 120, (2, 60, 80)).astype(np.uint8)
    still = np.zeros(one.shape, np.float32)
    np.testing.assert_allclose(unexplained(still, one, one + np.uint8(40)), 0.0, atol=1e-6)
    assert np.median(unexplained(still, one, other)) == pytest.approx(1.0, abs=0.05)
    assert np.median(unexplained(still + 5.0, one, np.roll(one, -5, axis=1))[:, 12:]) < 1e-6
    # Half of the contrast is left: (1 - 1 / 2)^2 / (1 + 1 / 4).
    half = (60 + (one.astype(int) - 60) // 2).astype(np.uint8)
    assert np.median(unexplained(still, one, half)) == pytest.approx(0.2, abs=0.01)
    even = np.full_like(one, 90)
    assert np.isinf(unexplained(still, even, even)).all()
