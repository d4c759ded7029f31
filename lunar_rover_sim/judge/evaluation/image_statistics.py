"""Statistics of an image, or of a stereo pair, by which renderers, cameras and worlds differ.

All but the sky is judged: what is dark and reaches from the upper edge downwards without an edge,
or, where both sets have true depth, what has none.
Definitions are in `MEASURES`. The spectrum of natural scenes falls with about the second power of
frequency (Field, J. Optical Society of America A 4, 1987); blur makes it steeper, noise flatter.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.stereo.config import SgmConfig
from lunar_rover_sim.image.stereo.error import stereo_errors
from lunar_rover_sim.image.stereo.sgm import SgmMatcher

LEAST_PX = 32       # a side of an image
F32 = NDArray[np.float32]


class GreyPair(NamedTuple):
    """A rectified pair, or a single image: (h, w) grey from 0 to 1, the root of the signal.

    Attributes:
        right: None of a single camera.
        truth_px: True disparity of the left image, 0 for the sky, NaN where unknown; None without.
    """

    name: str
    left: F32
    right: F32 | None = None
    truth_px: F32 | None = None

    def narrowed(self, width: int) -> GreyPair:
        """Return the pair scaled down to a width [px]; a narrower one is returned as it is."""
        height_px, width_px = self.left.shape
        if width_px <= width:
            return self
        factor = width / width_px
        size = width, max(round(height_px * factor), 1)

        def scaled(image: F32 | None, method: int) -> F32 | None:
            return None if image is None else np.asarray(
                cv2.resize(image, size, interpolation=method), np.float32)

        left = scaled(self.left, cv2.INTER_AREA)
        assert left is not None
        # The mean over an edge of depth would be the disparity of nothing.
        truth = scaled(self.truth_px, cv2.INTER_NEAREST)
        return GreyPair(self.name, left, scaled(self.right, cv2.INTER_AREA),
                        None if truth is None else truth * np.float32(factor))


def check_sizes(pair: GreyPair, path: Path) -> None:
    """Raise EvaluationError for small images, and other sizes of the right image or the truth."""
    height, width = pair.left.shape
    if min(height, width) < LEAST_PX:
        raise EvaluationError(f'{path}: {width} x {height} px are not valid; valid is at least '
                              f'{LEAST_PX} x {LEAST_PX} px')
    for what, other in (('right image', pair.right), ('true depth', pair.truth_px)):
        if other is not None and other.shape != pair.left.shape:
            sizes = [' x '.join(map(str, image.shape[::-1])) for image in (other, pair.left)]
            raise EvaluationError(f'{path}: the {what} has {sizes[0]} px, the left image '
                                  f'{sizes[1]} px')


def levels_of(pixels: NDArray[Any], linear: bool, black: float = 0.0, full: float = 0.0) -> F32:
    """Return (h, w) or (h, w, 3) pixels as the root of the signal, 0 to 1.

    Args:
        linear: Whether the pixels are proportional to the signal; else they are its root already,
            which the curve of most 8-bit cameras comes near to.
        black: Level of no light.
        full: Level of full scale; by default that of the type.
    """
    grey = pixels[..., :3].mean(axis=-1) if pixels.ndim == 3 else pixels
    full = full or float(np.iinfo(pixels.dtype).max)
    levels = np.clip((grey.astype(np.float32) - black) / (full - black), 0.0, 1.0)
    return np.asarray(np.sqrt(levels) if linear else levels, np.float32)


MEASURES: dict[str, str] = {
    'log gradient': 'median of log10 of the gradient [full scale per px]',
    'spectrum slope': 'slope of log power over log frequency, averaged over all directions',
    'shadow share': 'pixels with less than 5 % of the signal of the bright ground (90th '
                    'percentile)',
    'ORB keypoints': 'keypoints of ORB, FAST threshold 20 of 255, at most 10,000',
    'ORB matches': 'keypoints of the left image with a mutual best match on the same row (1.5 px) '
                   'of the right one, within the search range',
    'SGM density': 'pixels with a disparity from semi-global matching',
    'SGM bad-1': 'matched pixels that are off by more than 1 px, where there is truth',
}

# Measures between 0 and 1, whose intervals stay there.
SHARES = frozenset({'shadow share', 'SGM density', 'SGM bad-1'})

SKY_STEP = 6.0 / 255.0      # between neighbours, of means of 3 x 3 px: noise and glare are below
SKY_SIGNAL = 0.25           # of the 99th percentile: glare of a near sun is below, lit ground over
LOG_FLOOR, LOG_STEP = -3.0, 0.05            # gradients below 1e-3 of full scale count as that
LOG_BINS = round(-LOG_FLOOR / LOG_STEP)
_SHADOW_LEVEL, _BRIGHT_PERCENTILE = 0.05, 90.0
_LOWEST_CYCLES, _HIGHEST_FREQUENCY, _RINGS = 4.0, 0.35, 24     # in the image; cycles per px
_FAST_THRESHOLD, _MOST_KEYPOINTS = 20, 10_000
_MATCH_ROWS_PX = 1.5
_SEARCH_SHARE = 0.2     # of the width: 128 of 640 px


@dataclasses.dataclass(frozen=True)
class ImageStatistics:
    """The measures of one image, NaN where they do not apply, and its histogram.

    Attributes:
        values: (len(MEASURES),) in their order.
        log_gradients: (LOG_BINS,) shares of the gradients in bins of log10, from LOG_FLOOR to 0.
    """

    values: Array
    log_gradients: Array


def image_statistics(pair: GreyPair, truth_shows_sky: bool = False) -> ImageStatistics:
    """Return the statistics of an image or pair.

    Args:
        truth_shows_sky: Whether true disparity 0 marks the sky; else `ground_mask` finds it.
    """
    ground = pair.truth_px != 0.0 if truth_shows_sky and pair.truth_px is not None \
        else ground_mask(pair.left)
    logs = _log_gradients(pair.left, ground)
    counts = np.histogram(logs, LOG_BINS, (LOG_FLOOR, 0.0))[0]
    nan = float('nan')
    keypoints, matches = _orb(pair)
    density, bad = _matching(pair, ground) if pair.right is not None else (nan, nan)
    return ImageStatistics(
        np.array([float(np.median(logs)) if len(logs) else nan,
                  spectrum_slope(pair.left, ground),
                  shadow_share(pair.left[ground].astype(float)**2),
                  keypoints, matches, density, bad]),
        counts / max(counts.sum(), 1))


def ground_mask(image: F32) -> NDArray[np.bool_]:
    """Return where an (h, w) image, the root of the signal, is not sky.

    Sky is dark and reaches from the upper edge down to the first step. Ground that fills the upper
    edge is no sky for want of steps: washed out by a sun behind the camera, it is bright.
    """
    mean = cv2.blur(image, (3, 3))
    step = np.zeros_like(image)
    step[1:] = np.abs(mean[1:] - mean[:-1])
    step[:, 1:] = np.maximum(step[:, 1:], np.abs(mean[:, 1:] - mean[:, :-1]))
    bright = mean >= np.sqrt(SKY_SIGNAL) * np.percentile(mean, 99.0)
    return np.logical_or.accumulate((step > SKY_STEP) | bright, axis=0)


def _log_gradients(image: F32, ground: NDArray[np.bool_]) -> Array:
    """Return log10 of the gradients between pixels that are all ground."""
    across = 0.5 * (image[1:-1, 2:] - image[1:-1, :-2])
    down = 0.5 * (image[2:, 1:-1] - image[:-2, 1:-1])
    inside = cv2.erode(ground.astype(np.uint8), np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0
    gradient = np.hypot(across[inside], down[inside]).astype(float)
    # The largest is 0.71; in bins the upper end is open.
    return np.log10(np.clip(gradient, 10.0**LOG_FLOOR, 1.0))


def spectrum_slope(image: F32, ground: NDArray[np.bool_]) -> float:
    """Return the slope of the radially averaged power spectrum; NaN of less than 32 rows.

    Only rows without sky are taken, the horizon would be the strongest edge; they are windowed
    (Hann). From 4 cycles per side to 0.35 cycles per pixel, in rings of equal ratio.
    """
    full = np.flatnonzero(ground.all(axis=1))
    first = int(full[0]) if len(full) else 0
    part = image[first:].astype(float)
    height, width = part.shape
    if height < 32 or width < 32 or part.std() == 0.0:
        return float('nan')
    window = np.outer(np.hanning(height), np.hanning(width))
    part = (part - np.average(part, weights=window)) * window
    power = np.abs(np.fft.rfft2(part))**2
    radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :])
    edges = np.geomspace(_LOWEST_CYCLES / min(height, width), _HIGHEST_FREQUENCY, _RINGS + 1)
    ring = np.digitize(radius.ravel(), edges) - 1
    inside = (ring >= 0) & (ring < _RINGS)
    count = np.bincount(ring[inside], minlength=_RINGS)
    total = np.bincount(ring[inside], power.ravel()[inside], _RINGS)
    centre = np.bincount(ring[inside], radius.ravel()[inside], _RINGS)
    used = total > 0.0
    if used.sum() < 3:
        return float('nan')
    return float(np.polyfit(np.log(centre[used] / count[used]),
                            np.log(total[used] / count[used]), 1)[0])


def shadow_share(signal: NDArray[np.floating]) -> float:
    """Return the share of ground (n,) in shadow by its signal; NaN of none."""
    if not len(signal):
        return float('nan')
    bright = float(np.percentile(signal, _BRIGHT_PERCENTILE))
    return float((signal < _SHADOW_LEVEL * bright).mean())


def _orb(pair: GreyPair) -> tuple[float, float]:
    """Return the number of keypoints, and of matches between left and right."""
    orb = cv2.ORB.create(nfeatures=_MOST_KEYPOINTS, fastThreshold=_FAST_THRESHOLD)
    points, described = orb.detectAndCompute(_eight_bits(pair.left), None)
    if pair.right is None:
        return float(len(points)), float('nan')
    others, described_others = orb.detectAndCompute(_eight_bits(pair.right), None)
    if not points or not others:
        return float(len(points)), 0.0
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(described, described_others)
    shifts = np.array([np.subtract(points[m.queryIdx].pt, others[m.trainIdx].pt)
                       for m in matches]).reshape(-1, 2)
    right = ((np.abs(shifts[:, 1]) <= _MATCH_ROWS_PX) & (shifts[:, 0] >= -_MATCH_ROWS_PX)
             & (shifts[:, 0] <= _SEARCH_SHARE * pair.left.shape[1]))
    return float(len(points)), float(right.sum())


def _matching(pair: GreyPair, ground: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the share of ground with a disparity, and of that the share off by 1 px."""
    nan = float('nan')
    width = pair.left.shape[1]
    search = max(16, round(_SEARCH_SHARE * width / 16) * 16)
    if pair.right is None or pair.right.shape != pair.left.shape or width <= search:
        return nan, nan
    left = _eight_bits(pair.left)
    disparity = SgmMatcher(SgmConfig(num_disparities=search)).match(left, _eight_bits(pair.right))
    density = float((disparity.valid & ground).sum() / max(ground.sum(), 1))
    if pair.truth_px is None:
        return density, nan
    truth = np.nan_to_num(pair.truth_px, nan=0.0).astype(np.float32)
    return density, stereo_errors(disparity, truth, None, left).summary()['bad-1']


def _eight_bits(image: F32) -> NDArray[np.uint8]:
    return np.rint(image * 255.0).astype(np.uint8)
