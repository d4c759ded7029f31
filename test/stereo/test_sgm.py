"""Matching: planes of known disparity, what is invalid, and what is refused."""

import cv2
import numpy as np
import pytest

from lunar_rover_sim.errors import ConfigError, StereoError
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.stereo.config import SgmConfig
from lunar_rover_sim.stereo.depth import depth_from_disparity, disparity_from_depth, DisparityMap
from lunar_rover_sim.stereo.error import disparity_errors_px, stereo_errors, StereoErrors
from lunar_rover_sim.stereo.sgm import SgmMatcher


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


@pytest.mark.parametrize('mode', ['sgbm', 'hh', 'hh4', '3way'])
def test_slanted_plane(mode):
    truth = np.maximum(np.arange(240) - 60, 0) * 0.25 + 3.0
    left, right = textured_pair(truth)
    disparity = SgmMatcher(SgmConfig(mode=mode, num_disparities=64)).match(left, right)
    inside = np.zeros(left.shape, bool)
    inside[70:-8, 80:-10] = True
    valid = disparity.valid & inside
    assert valid.sum() > 0.95 * inside.sum()
    error = np.abs(disparity.disparity_px - truth[:, None])[valid]
    assert np.median(error) < 0.25          # sub-pixel, with the usual locking to whole pixels
    assert np.mean(error > 1.0) < 0.01


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


def test_description_of_the_map():
    left, right = textured_pair(np.full(240, 10.0))
    disparity = SgmMatcher(SgmConfig(num_disparities=64, block_size=7)).match(left, right)
    assert disparity.min_disparity_px == 0.0 and disparity.max_disparity_px == 63.0
    assert disparity.delta_d_px == 1.0 / 16.0
    x, y, width, height = disparity.valid_window
    assert x >= 63 and x + width <= 400 and y + height <= 240 and width > 0 and height > 0


def test_sixteen_bits_and_colour():
    truth = np.full(240, 12.0)
    left, right = textured_pair(truth)
    matcher = SgmMatcher(SgmConfig(num_disparities=64))
    gray = matcher.match(left, right).disparity_px
    wide = matcher.match(left.astype(np.uint16) << 8, right.astype(np.uint16) << 8).disparity_px
    colour = matcher.match(*(np.repeat(i[..., None], 3, axis=2) for i in (left, right)))
    assert np.array_equal(gray, wide)
    assert np.array_equal(gray, colour.disparity_px)


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
    matcher = SgmMatcher.from_scenario(scenario)
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


def test_errors_are_signed_and_infinity_is_no_finite_depth():
    """A disparity of 0 is a match, but one without finite depth."""
    d = DisparityMap(np.array([[-1.0, 0.0, 5.0, 7.5]], np.float32), 0.0, 63.0, 0.0625,
                     (0, 0, 4, 1))
    truth = np.array([[3.0, 3.0, 6.0, 7.0]], np.float32)
    assert d.valid.tolist() == [[False, True, True, True]]
    assert d.has_finite_depth.tolist() == [[False, False, True, True]]
    np.testing.assert_array_equal(disparity_errors_px(d, truth, d.has_finite_depth), [-1.0, 0.5])


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


@pytest.mark.parametrize('values,message', [
    ({'num_disparities': 100}, 'num_disparities: 100 is not valid; valid is a multiple of 16'),
    ({'block_size': 4}, 'block_size: 4 is not valid; valid is an odd number'),
    ({'mode': 'sgm'}, "mode: 'sgm' is not valid"),
    ({'p1': 300, 'p2': 200}, 'p2: 200 is not valid'),
])
def test_refusals(values, message):
    with pytest.raises(ConfigError, match=message):
        SgmConfig(**values)


def test_shapes_are_checked():
    matcher = SgmMatcher(SgmConfig(num_disparities=64))
    with pytest.raises(StereoError, match='right: shape'):
        matcher.match(np.zeros((10, 200), np.uint8), np.zeros((10, 201), np.uint8))
    with pytest.raises(StereoError, match='less than the image width'):
        matcher.match(np.zeros((10, 50), np.uint8), np.zeros((10, 50), np.uint8))
