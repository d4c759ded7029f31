"""The measures of an image by closed forms, and their sets by hand."""

import math
from types import SimpleNamespace

import cv2
from judge.evaluation.image_sets import HEIGHT, WIDTH
import numpy as np
import pytest
from scipy.stats import wasserstein_distance

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.images import write_png
from lunar_rover_sim.judge.evaluation.image_comparison import compare_images
from lunar_rover_sim.judge.evaluation.image_statistics import (check_sizes, GreyPair, ground_mask,
                                                               image_statistics, levels_of,
                                                               LOG_BINS, LOG_FLOOR, LOG_STEP,
                                                               MEASURES, SKY_STEP)


def measures(pair, truth_shows_sky=False):
    """Return the values by name, and the histogram of gradients."""
    found = image_statistics(pair, truth_shows_sky)
    return dict(zip(MEASURES, found.values)), found.log_gradients


def ramp(across, down, height=50, width=60, start=0.3):
    return (start + across * np.arange(width)[None, :] + down * np.arange(height)[:, None]
            ).astype(np.float32)


ALL_GROUND = np.full((50, 60), 5.0, np.float32)     # a true disparity everywhere


@pytest.mark.parametrize('across,down', [(0.003, 0.0), (0.0, -0.004), (0.003, -0.004),
                                         (-0.0011, 0.0022)])
def test_a_ramp_has_one_gradient(across, down):
    """By central differences it is that of the plane, in one bin of the histogram."""
    values, shares = measures(GreyPair('', ramp(across, down, start=0.45), None, ALL_GROUND), True)
    expected = math.log10(math.hypot(across, down))
    assert values['log gradient'] == pytest.approx(expected, abs=1e-4)
    assert shares.shape == (LOG_BINS,) and shares.sum() == pytest.approx(1.0)
    edges = LOG_FLOOR + LOG_STEP * np.arange(LOG_BINS + 1)
    inside = np.flatnonzero(shares > 0.01)
    assert edges[inside[0]] - 1e-3 <= expected <= edges[inside[-1] + 1] + 1e-3
    assert len(inside) <= 2 and edges[-1] == pytest.approx(0.0)


def test_gradients_next_to_the_sky_do_not_count():
    """Truth of 0 is sky: neither it, nor the horizon, nor a pixel beside it."""
    image = ramp(0.003, 0.0)
    image[:20] = 0.9                # an edge of half of full scale
    truth = ALL_GROUND.copy()
    truth[:20] = 0.0
    truth[30, 30] = np.nan          # unknown is not sky
    values, shares = measures(GreyPair('', image, None, truth), True)
    assert values['log gradient'] == pytest.approx(math.log10(0.003), abs=1e-4)
    assert np.count_nonzero(shares) <= 2
    # Without that truth the sky is found in the image itself: its horizon is an edge.
    values, shares = measures(GreyPair('', image, None, truth), False)
    assert shares[-15:].sum() > 0.0
    everything, none = measures(GreyPair('', image, None, np.zeros_like(image)), True)
    assert np.isnan([everything['log gradient'], everything['shadow share']]).all()
    assert not none.any()


def test_ground_begins_at_the_first_step_from_above():
    """A step of means of 3 x 3 px above the limit, down or across; all below it is ground."""
    image = np.full((40, 50), 0.2, np.float32)
    image[36:, :10] = 0.9           # bright ground: beside it the rest is dark enough for the sky
    image[12:, 10:20] = 0.2 + 3.2 * SKY_STEP        # each row of the mean takes a third of it
    image[30:, 40:] = 0.2 + 2.8 * SKY_STEP          # too little
    ground = ground_mask(image)
    assert not ground[:11].any() and ground[13:, 11:19].all()
    # The step across, at the sides of the bright part, is one as well.
    assert ground[13:, 9:21].all() and not ground[:34, :8].any() and not ground[:, 22:].any()


def test_washed_out_ground_is_no_sky() -> None:
    """Down-sun, the ground at the upper edge has no steps, but it is bright."""
    rows = np.linspace(0.95, 0.7, HEIGHT, dtype=np.float32)[:, None]
    image = np.repeat(rows, WIDTH, axis=1)
    image[80:, 40:60] = 0.1                         # a rock's shadow
    assert ground_mask(image).all()
    image[:20] = 0.03                               # above the horizon
    assert ground_mask(image).sum() == pytest.approx((HEIGHT - 20) * WIDTH, rel=0.02)
    # A shadow that reaches the horizon is not lost with the sky beside a step.
    image[20:60, 70:90] = 0.15
    assert ground_mask(image)[22:].all()


@pytest.mark.parametrize('dark,shares', [(0.2, 0.3), (0.25, 0.0)])
def test_shadow_is_below_a_twentieth_of_the_bright_signal(dark, shares):
    """Levels are roots: a level of 0.2 against 1 is 4 % of the signal, 0.25 is 6 %."""
    image = np.full((50, 60), 1.0, np.float32)
    image[:, :18] = dark
    values, _ = measures(GreyPair('', image, None, ALL_GROUND), True)
    assert values['shadow share'] == pytest.approx(shares)


def scene(seed=3, height=96, width=160, shift=9):
    """Return a pair of a texture with one disparity."""
    rng = np.random.default_rng(seed)
    wide = cv2.GaussianBlur(rng.uniform(0.0, 1.0, (height, width + shift)), (0, 0), 1.2)
    wide = np.clip(0.5 + 1.6 * (wide - 0.5), 0.0, 1.0).astype(np.float32)
    return wide[:, :width], wide[:, shift:]


def test_matches_are_counted_on_their_rows_within_the_search():
    """A shift of 9 px is found; one of 40 px is beyond a fifth of the width; 4 rows are too far.

    A right image that lies to the other side by more than 1.5 px is no pair either.
    """
    left, right = scene()
    found = measures(GreyPair('', left, right))[0]
    assert found['ORB keypoints'] > 60
    assert found['ORB matches'] > 0.6 * found['ORB keypoints']
    for rows, columns in ((4, 0), (0, -31), (0, 12)):
        bad = np.roll(right, (rows, columns), (0, 1))
        assert measures(GreyPair('', left, bad))[0]['ORB matches'] < 0.1 * found['ORB matches']
    far = np.roll(right, -20, axis=1)       # 29 px of 160: within a fifth
    assert measures(GreyPair('', left, far))[0]['ORB matches'] > 0.3 * found['ORB matches']
    empty = np.full_like(left, 0.5)
    assert measures(GreyPair('', left, empty))[0]['ORB matches'] == 0.0
    assert measures(GreyPair('', empty, left))[0]['ORB keypoints'] == 0.0
    assert np.isnan(measures(GreyPair('', left))[0]['ORB matches'])


def test_white_is_white():
    """Full scale is not black: patches of it on black have corners, and their pair matches."""
    left, right = ((image > 0.5).astype(np.float32) for image in scene())
    found = measures(GreyPair('', left, right))[0]
    assert found['ORB keypoints'] > 60 and found['ORB matches'] > 30
    half = measures(GreyPair('', 0.5 * left))[0]
    assert half['ORB keypoints'] == pytest.approx(found['ORB keypoints'], rel=0.3)


def test_density_and_error_of_matching():
    """All ground that both see is matched; truth that is off by 2 px makes all of it bad."""
    left, right = scene()
    truth = np.full_like(left, 9.0)
    values, _ = measures(GreyPair('', left, right, truth), True)
    assert values['SGM density'] > 0.85 and values['SGM bad-1'] < 0.02
    truth[:, 80:] = 11.0
    assert measures(GreyPair('', left, right, truth), True)[0]['SGM bad-1'] == pytest.approx(
        0.5, abs=0.06)
    # Where the ground is not known nothing is compared; where all is sky there is none to match.
    truth[:, 80:] = np.nan
    assert measures(GreyPair('', left, right, truth), True)[0]['SGM bad-1'] < 0.02
    assert measures(GreyPair('', left, right, 0.0 * left), True)[0]['SGM density'] == 0.0
    assert np.isnan(measures(GreyPair('', left, right))[0]['SGM bad-1'])
    # Sky over half of the image: the density is that of the other half.
    truth = np.full_like(left, 9.0)
    truth[:48] = 0.0
    assert measures(GreyPair('', left, right, truth), True)[0]['SGM density'] > 0.85


def test_levels_of_all_kinds_of_pixels():
    """The root of the signal; the mean of three channels, transparency left out."""
    assert levels_of(np.array([[0, 51, 255]], np.uint8), False) == pytest.approx(
        np.array([[0.0, 0.2, 1.0]]))
    assert levels_of(np.array([[0, 16384, 65535]], np.uint16), True) == pytest.approx(
        np.array([[0.0, 0.5, 1.0]]), abs=1e-5)
    colour = np.array([[[30, 60, 90, 255], [255, 255, 255, 0]]], np.uint8)
    for channels in (3, 4):
        assert levels_of(colour[..., :channels], False) == pytest.approx(
            np.array([[60.0 / 255.0, 1.0]]))
    raw = np.array([[0, 16, 1036, 4096, 5000]], np.uint16)
    assert levels_of(raw, False, 16.0, 4096.0) == pytest.approx(
        np.array([[0.0, 0.0, 0.25, 1.0, 1.0]]))
    assert levels_of(raw, True, 16.0, 4096.0)[0, 2] == pytest.approx(0.5)


@pytest.mark.parametrize('width', [30, 59, 60, 90])
def test_scaling_down_keeps_means_and_shape(width):
    image = ramp(0.004, 0.002)
    truth = np.full((50, 60), 12.0, np.float32)
    truth[:, 30:] = np.nan
    found = GreyPair('a', image, image + 0.1, truth).narrowed(width)
    height = round(50 * min(width, 60) / 60)
    for part in (found.left, found.right, found.truth_px):
        assert part.shape == (height, min(width, 60)) and part.dtype == np.float32
    assert found.left.mean() == pytest.approx(image.mean(), abs=1e-3)
    assert found.right.mean() == pytest.approx(image.mean() + 0.1, abs=1e-3)
    known = found.truth_px[np.isfinite(found.truth_px)]
    assert set(known) == {np.float32(12.0 * min(width, 60) / 60.0)}
    assert found.name == 'a' and len(known) == pytest.approx(0.5 * found.left.size, rel=0.05)
    assert GreyPair('', image[:1]).narrowed(10).left.shape == (1, 10)
    assert GreyPair('', image).narrowed(30).right is None


def test_images_of_other_sizes_are_named(tmp_path):
    left = np.zeros((40, 60), np.float32)
    check_sizes(GreyPair('', left, left, left), tmp_path)
    with pytest.raises(EvaluationError, match='right image has 50 x 40 px, the left image 60'):
        check_sizes(GreyPair('', left, left[:, :50]), tmp_path)
    with pytest.raises(EvaluationError, match='the true depth has 60 x 30 px'):
        check_sizes(GreyPair('', left, None, left[:30]), tmp_path)
    for small in (left[:1, :1], left[:31], left[:, :31]):
        with pytest.raises(EvaluationError, match='px are not valid; valid is at least 32 x 32'):
            check_sizes(GreyPair('', small), tmp_path)


@pytest.fixture(scope='module')
def sets(tmp_path_factory):
    """Return two folders of single images, the second one smoother and narrower."""
    folder = tmp_path_factory.mktemp('sets')
    rng = np.random.default_rng(6)
    for name, sigma, width in (('a', 0.8, 96), ('b', 2.0, 80)):
        (folder / name).mkdir()
        for k in range(5):
            image = cv2.GaussianBlur(rng.uniform(0.0, 1.0, (64, width)), (0, 0), sigma)
            image = np.clip(0.5 + 2.0 * (image - 0.5), 0.0, 1.0)
            write_png(folder / name / f'{k}.png', np.rint(255.0 * image).astype(np.uint8))
    return SimpleNamespace(a=folder / 'a', b=folder / 'b')


def test_two_sets_are_compared_at_the_narrower_width(sets):
    told = []
    result = compare_images(sets.a, sets.b, frames=4, progress=lambda: told.append(1))
    assert result.width_px == 80 and len(told) == 8
    assert result.first.values.shape == (4, len(MEASURES)) and result.first.images.total == 5
    for row, one, other in zip(result.rows, result.first.values.T, result.second.values.T):
        if row.first.n:
            assert row.first.value == pytest.approx(np.nanmean(one))
            assert row.second.value == pytest.approx(np.nanmean(other))
            assert row.difference.value == pytest.approx(np.nanmean(other) - np.nanmean(one))
    centres = LOG_FLOOR + LOG_STEP * (np.arange(LOG_BINS) + 0.5)
    means = [part.log_gradients.mean(axis=0) for part in (result.first, result.second)]
    distance = wasserstein_distance(centres, centres, *means)
    assert result.distance.value == pytest.approx(distance)
    assert 0.0 <= result.distance.low < distance < result.distance.high
    # Two blocks of two images on either side: 2 of 6 ways to lay them are as far apart.
    assert 0.0 < result.chance <= distance * (1.0 + 1e-9)
    assert result.distance.p == pytest.approx(1.0 / 3.0, abs=0.05)
    assert compare_images(sets.a, sets.b, width_px=64, frames=1).width_px == 64
    assert compare_images(sets.a, sets.b, width_px=500, frames=1).width_px == 80
