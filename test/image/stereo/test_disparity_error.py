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


@pytest.mark.parametrize('least,kind,block', [(-2.0, np.uint8, 7), (3.0, np.uint16, 5)])
def test_each_pixel_counts_for_the_first_cause_that_applies(least, kind, block):
    """Pixel by pixel, of maps and images that have all causes; some errors lie at a bound."""
    rng, (h, w) = np.random.default_rng(5), (40, 60)
    truth, right = np.ceil(rng.uniform(-2.0, 80.0, (2, h, w))) / 4.0
    found = (truth + rng.integers(-20, 21, (h, w)) / 8.0).astype(np.float32)
    found[rng.random((h, w)) < 0.6] = least - 1.0
    shown = DisparityMap(found, least, 15.0, 0.0625, (4, 3, w - 9, h - 5))
    level = np.repeat(np.repeat([[4, 22, 60, 120], [200, 245, 90, 12]], h // 2, 0), w // 4, 1)
    image = np.clip(level + rng.integers(-12, 13, (h, w)) * (np.arange(h)[:, None] % 20 < 10), 0,
                    255)
    image[rng.random((h, w)) < 0.35 * (level > 110)] = 255
    image = image.astype(kind) * (np.iinfo(kind).max // 255)
    if kind is np.uint16:
        image = np.stack([image, image // 2, image], axis=-1)
    light = image.reshape(h, w, -1).mean(axis=2) / np.iinfo(kind).max
    blocks = np.lib.stride_tricks.sliding_window_view(np.pad(light, block // 2, 'reflect'),
                                                      (block, block)).reshape(h, w, -1)
    count = dict.fromkeys((field.name for field in dataclasses.fields(StereoErrors)), 0)
    signed = []
    for v, u in np.ndindex(h, w):
        true = truth[v, u]
        if not max(least, 0.25) <= true <= min(15.0, u):
            continue
        dark = blocks[v, u].mean() < 0.08
        count['ground'] += 1
        count['lit'] += not dark
        if found[v, u] >= least:
            signed.append(found[v, u] - true)
            count['lit_matched'] += not dark
        elif not (4 <= u < w - 5 and 3 <= v < h - 2):
            count['margin'] += 1
        elif right[v, round(u - true)] > true + 1.0:
            count['occluded'] += 1
        elif dark:
            count['shadowed'] += 1
        elif (blocks[v, u] >= 1.0).mean() > 1.0 / 3.0:
            count['saturated'] += 1
        elif blocks[v, u].std() < 0.012:
            count['flat'] += 1
    error = np.abs(signed)
    count |= {'matched': len(error), 'bad1': (error > 1.0).sum(), 'bad2': (error > 2.0).sum(),
              'error_sum_px': error.sum(), 'error_squared_px': (error ** 2).sum(),
              'signed_sum_px': np.sum(signed),
              'signed_counts': tuple(np.histogram(signed, 512, (-4.0, 4.0))[0])}
    errors = stereo_errors(shown, truth.astype(np.float32), right.astype(np.float32), image,
                           block_px=block)
    assert errors == StereoErrors(**count)
    assert min(count['bad2'], *(count[name] for name in (
        'margin', 'occluded', 'shadowed', 'flat'))) > 5 and (count['saturated'] > 5
                                                             or image.ndim == 3)
    double = errors + errors
    assert double == StereoErrors(**{name: tuple(2 * np.array(value)) if isinstance(value, tuple)
                                     else 2 * value for name, value in count.items()})
    assert double.median_px == errors.median_px \
        == pytest.approx(np.median(signed), abs=1.0 / 64.0)
