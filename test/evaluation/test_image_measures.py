"""What the measures of an image say of planted shadow, sky, shifts and spectra."""

from __future__ import annotations

from evaluation.image_sets import HEIGHT, SHIFT_PX, texture, WIDTH
import numpy as np
import pytest

from lunar_rover_sim.evaluation.image_statistics import (GreyPair, ground_mask, image_statistics,
                                                         MEASURES, spectrum_slope)


def test_shadow_and_sky() -> None:
    """The planted share of shadow is found; sky counts for nothing."""
    image = np.full((HEIGHT, WIDTH), 0.6, np.float32)
    image[:30] = 0.02                       # sky
    image[90:, :WIDTH // 2] = 0.05          # a third of the ground, half of the width
    assert ground_mask(image).sum() == pytest.approx(90 * WIDTH, rel=0.02)
    glare = image + np.linspace(0.2, 0.0, WIDTH, dtype=np.float32)[None, :]
    assert ground_mask(glare).sum() == pytest.approx(90 * WIDTH, rel=0.02)
    values = dict(zip(MEASURES, image_statistics(GreyPair('', image)).values))
    assert values['shadow share'] == pytest.approx(1.0 / 6.0, abs=0.01)
    assert np.isnan(values['ORB matches']) and np.isnan(values['SGM density'])


def test_bad_1_against_truth() -> None:
    """Right truth gives none, truth that is off by 3 px gives all."""
    wide = texture(3).astype(np.float32)
    for truth, bad in ((SHIFT_PX, 0.0), (SHIFT_PX + 3, 1.0)):
        pair = GreyPair('', wide[:, :WIDTH], wide[:, SHIFT_PX:],
                        np.full((HEIGHT, WIDTH), truth, np.float32))
        values = dict(zip(MEASURES, image_statistics(pair).values))
        assert values['SGM bad-1'] == pytest.approx(bad, abs=0.02)


def test_scaling_down_keeps_truth() -> None:
    """Half the width, half the disparity; the sky keeps its zero."""
    truth = np.full((HEIGHT, WIDTH), 8.0, np.float32)
    truth[:20] = 0.0
    image = texture(1)[:, :WIDTH].astype(np.float32)
    half = GreyPair('', image, image, truth).narrowed(WIDTH // 2)
    assert half.left.shape == (HEIGHT // 2, WIDTH // 2) and half.truth_px is not None
    assert set(np.unique(half.truth_px)) == {0.0, 4.0}
    assert GreyPair('', image).narrowed(2 * WIDTH).left is image


def test_spectrum_of_a_flat_image() -> None:
    """Has no slope; neither have a few rows."""
    ground = np.ones((HEIGHT, WIDTH), bool)
    assert np.isnan(spectrum_slope(np.full((HEIGHT, WIDTH), 0.5, np.float32), ground))
    assert np.isnan(spectrum_slope(np.zeros((8, WIDTH), np.float32), ground[:8]))


def test_the_smallest_image_with_a_spectrum() -> None:
    """32 rows and columns have a slope, 31 of either have none; rows with sky do not count."""
    image = texture(5, height=40, width=40).astype(np.float32)
    for height, width, known in ((32, 32, True), (31, 32, False), (32, 31, False)):
        part = image[:height, :width]
        assert np.isfinite(spectrum_slope(part, np.ones(part.shape, bool))) == known
    ground = np.ones((40, 32), bool)
    ground[:8, 5] = False
    assert spectrum_slope(image[:, :32], ground) == pytest.approx(
        spectrum_slope(image[8:, :32], ground[8:]))
    ground[8, 5] = False
    assert np.isnan(spectrum_slope(image[:, :32], ground))
