"""Semi-global matching of a rectified pair by OpenCV's StereoSGBM.

Method: Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information", IEEE
Trans. Pattern Analysis and Machine Intelligence 30(2), 2008.

Its matches are refined by one step of least squares on the brightness itself.
OpenCV's matcher fits a parabola to costs that it has aggregated along paths. Three of its four
modes aggregate downwards more than upwards, so that on ground, whose disparity grows from row to
row, their result lags behind: it is too small by 0.1 to 0.4 px. Brightness has no such direction.
Around each pixel, L(x) = R(x - d) is linearised about the smoothed disparity of every pixel of the
window, and its mean correction is solved for (Lucas & Kanade, "An Iterative Image Registration
Technique with an Application to Stereo Vision", IJCAI 1981). The gradient is the mean of those of
both images: the second-order term of the expansion cancels, as does noise of the one image that
would weigh its own gradient.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import brief, StereoError
from lunar_rover_sim.image.camera.distortion import distort
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.stereo.config import SgmConfig
from lunar_rover_sim.image.stereo.depth import DisparityMap
from lunar_rover_sim.image.stereo.sky import sky

_MODES = {'sgbm': cv2.STEREO_SGBM_MODE_SGBM, 'hh': cv2.STEREO_SGBM_MODE_HH,
          'hh4': cv2.STEREO_SGBM_MODE_HH4, '3way': cv2.STEREO_SGBM_MODE_SGBM_3WAY}


_SPECKLE_STEPS = 2          # of disparity, within a patch that is not a speckle
_MARGIN_OVERLAP_PX = 32     # of the left margin with the rest; paths begin there
_HALF_TURNS = 2             # of the refinement of what was matched at half the resolution


class SgmMatcher:
    """Matches pairs, which it rectifies where their cameras distort; not thread-safe."""

    def __init__(self, config: SgmConfig, rig: StereoRig | None = None) -> None:
        """Make the matcher.

        Args:
            rig: The cameras, for `DisparityMap.depth_m` and their distortion; None: pairs come
                rectified.
        """
        self.config = config
        self._raw = None if rig is None or not rig.D.any() else _raw_pixels(rig)
        self._geometry = (None, None) if rig is None else (rig.focal_px, rig.baseline_m)
        self._matcher = _sgbm(config, config.min_disparity, config.num_disparities,
                              config.block_size)
        # At half the resolution, of the left margin or of all.
        least = config.min_disparity // 2
        most = -(-(config.min_disparity + config.num_disparities) // 2)
        self._half_reach = least + 16 * -(-(most - least) // 16)
        self._half_matcher = _sgbm(config, least, self._half_reach - least,
                                   max(config.block_size - 2, 1))

    def __repr__(self) -> str:
        low = self.config.min_disparity
        return f'SgmMatcher({low} to {low + self.config.num_disparities} px)'

    def rectified(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return an image as it were without distortion; black where no pixel has seen it."""
        if self._raw is None:
            return image
        if image.shape[:2] != self._raw[0].shape:
            raise StereoError(f'image: shape {image.shape} is not valid; valid is that of the '
                              f'camera, {self._raw[0].shape}')
        return cv2.remap(image, *self._raw, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)

    def match(self, left: NDArray[Any], right: NDArray[Any]) -> DisparityMap:
        """Match two (h, w) or (h, w, 3) images, uint8 or uint16, as the cameras give them.

        The disparity is that of the rectified left image.

        Raises:
            StereoError: If they are others, their shapes differ or the search range exceeds the
                width.
        """
        config = self.config
        _check_image('left', left)
        _check_image('right', right)
        if left.shape != right.shape:
            raise StereoError(f'right: shape {right.shape} is not valid; valid is that of the '
                              f'left image, {left.shape}')
        if left.shape[1] <= config.num_disparities + config.min_disparity:
            raise StereoError(f'num_disparities: {config.num_disparities} is not valid; valid is '
                              f'less than the image width, {left.shape[1]}')
        left8, right8 = (self.rectified(_gray(image)) for image in (left, right))
        height, width = left8.shape
        invalid = float(config.min_disparity - 1)
        disparity = np.full((height, width), invalid, np.float32)
        top = self._first_row(left8, right8)
        if height - top > config.block_size:
            self._match_below(left8[top:], right8[top:], disparity[top:])
        if self._raw is not None:       # black beyond the raw image is no ground
            u, v = self._raw
            disparity[(u < 0.0) | (u > width - 1.0) | (v < 0.0) | (v > height - 1.0)] = invalid
        reach = config.min_disparity + config.num_disparities
        margin = config.block_size // 2
        # A match needs a right column within the image at the least disparity looked for.
        first = margin + max(config.min_disparity, 0)
        last = width - margin + min(config.min_disparity, 0)
        window = (first, margin, max(last - first, 0), height - 2 * margin)
        return DisparityMap(disparity, float(config.min_disparity), float(reach - 1), 1.0 / 16.0,
                            window, *self._geometry)

    def _match_below(self, left: NDArray[np.uint8], right: NDArray[np.uint8],
                     out: NDArray[np.float32]) -> None:
        """Write the disparity of the valid pixels of two (h, w) images into `out`."""
        config = self.config
        fixed = self._fixed_point(left, right)
        found = np.multiply(fixed, np.float32(1.0 / 16.0))
        valid = fixed >= 16 * config.min_disparity
        if config.refinement:
            for _ in range(_HALF_TURNS if config.half_resolution else 1):
                found = refined(found, valid, left, right)
        if config.unexplained_percent < 100:
            valid &= unexplained(found, left, right) < 0.01 * config.unexplained_percent
        if config.min_contrast > 0.0:
            valid &= _variance(left, config.block_size) >= config.min_contrast**2
        # The block around the match lies in the right image, and at the upper edge in the left.
        margin = config.block_size // 2
        there = np.subtract(np.arange(left.shape[1], dtype=np.float32), found)
        valid &= cv2.inRange(there, float(margin), left.shape[1] - 1.0 - margin) > 0
        valid[:margin] = False
        if config.find_sky:
            valid &= ~sky(left, found, valid)
        least, most = config.min_disparity, config.min_disparity + config.num_disparities - 1
        # What the refinement has moved out of the search range by more than a pixel is no match.
        valid &= cv2.inRange(found, least - 1.0, most + 1.0) > 0
        np.clip(found, least, most, out=found)
        np.copyto(out, found, where=valid)

    def _fixed_point(self, left: NDArray[np.uint8],
                     right: NDArray[np.uint8]) -> NDArray[np.int16]:
        """Return 16 times the disparity, by OpenCV.

        It matches only columns whose whole search range lies in the image. To the right of it,
        where disparities are negative, padding puts it there. The columns to the left of it are
        matched at half the resolution, if not all are. That takes an eighth of the time;
        `refined` makes up for what it costs in accuracy.
        """
        config = self.config
        if config.half_resolution:
            return self._at_half(left, right, left.shape[1])
        before = max(config.min_disparity + config.num_disparities, 0)
        after = max(-config.min_disparity, 0)
        fixed = self._matcher.compute(*(
            cv2.copyMakeBorder(image, 0, 0, 0, after, cv2.BORDER_REPLICATE)
            for image in (left, right)))[:, :left.shape[1]]
        if before:
            fixed[:, :before] = self._at_half(left, right, before)
        return np.asarray(fixed, np.int16)

    def _at_half(self, left: NDArray[np.uint8], right: NDArray[np.uint8],
                 width: int) -> NDArray[np.int16]:
        """Return 16 times the disparity of the left columns, (h, width)."""
        config = self.config
        height, pad = left.shape[0], 2 * max(self._half_reach, 0)
        strip = min(width + _MARGIN_OVERLAP_PX, left.shape[1])
        beyond = strip % 2 + 2 * max(-(config.min_disparity // 2), 0)
        half = ((pad + strip + beyond) // 2, (height + 1) // 2)
        fixed = self._half_matcher.compute(*(
            cv2.resize(cv2.copyMakeBorder(image[:, :strip], 0, height % 2, pad, beyond,
                                          cv2.BORDER_REPLICATE), half,
                       interpolation=cv2.INTER_AREA) for image in (left, right)))
        whole = np.repeat(np.repeat(fixed[:, pad // 2:], 2, axis=0), 2, axis=1)[:height, :width]
        found = whole >= 16 * (config.min_disparity // 2)
        return np.where(found, 2 * whole, 16 * (config.min_disparity - 1)).astype(np.int16)

    def _first_row(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> int:
        """Return the first row to match: a block above the first row that is not black."""
        level = self.config.dark_level
        if level == 0:
            return 0
        bright = np.maximum(left.max(axis=1), right.max(axis=1)) > level
        if not bright.any():
            return left.shape[0]
        return max(int(np.argmax(bright)) - self.config.block_size, 0)


def _sgbm(config: SgmConfig, least: int, count: int, block: int) -> Any:
    """Return OpenCV's matcher of so many disparities from `least` on, by blocks of a size."""
    area = block**2
    return cv2.StereoSGBM_create(  # type: ignore[attr-defined]
        minDisparity=least, numDisparities=count, blockSize=block,
        P1=config.p1 or 8 * area, P2=config.p2 or 32 * area,
        disp12MaxDiff=config.left_right_max_px, preFilterCap=config.pre_filter_cap,
        uniquenessRatio=config.uniqueness_percent, speckleWindowSize=config.speckle_window_px,
        speckleRange=_SPECKLE_STEPS, mode=_MODES[config.mode])


def _variance(image: NDArray[np.uint8], block: int) -> NDArray[np.float32]:
    """Return the variance within the block around each pixel."""
    mean = cv2.boxFilter(image, cv2.CV_32F, (block, block))
    square = cv2.sqrBoxFilter(image, cv2.CV_32F, (block, block))
    np.multiply(mean, mean, out=mean)
    return np.subtract(square, mean, out=square)


def _check_image(name: str, image: NDArray[Any]) -> None:
    """Raise StereoError, which names the image, unless it is one that can be matched."""
    is_array = isinstance(image, np.ndarray)
    if (is_array and image.dtype.kind == 'u' and image.dtype.itemsize <= 2 and image.ndim >= 2
            and image.shape[2:] in ((), (3,))):
        return
    what = f'{image.dtype} {image.shape}' if is_array else brief(image)
    raise StereoError(f'{name}: {what} is not valid; valid is uint8 or uint16, (h, w) or '
                      '(h, w, 3)')


def _raw_pixels(rig: StereoRig) -> tuple[F32, F32]:
    """Return the column and the row in the raw image of each pixel of the rectified one [px]."""
    places = distort(rig.rays()[..., :2], rig.D) * rig.focal_px + rig.K[:2, 2]
    return places[..., 0].astype(np.float32), places[..., 1].astype(np.float32)


def _gray(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return an image of any encoding as (h, w) grey of 8 bits."""
    if image.dtype.itemsize == 2:       # in any order of bytes
        image = (image >> 8).astype(np.uint8)
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return np.ascontiguousarray(image, dtype=np.uint8)


F32 = NDArray[np.float32]

# Chosen on rendered pairs of all scenarios, where they give the least error.
_SMOOTHED_PX = 7        # side of the window over which the disparity is averaged before
_SAME_SURFACE_PX = 1.0  # a pixel whose average differs by more lies at an edge and keeps its own
_HIGH_PASS_PX = 9       # side of the window whose mean brightness is taken off
_WINDOW_SIGMA = 1.0     # of the window of the fit, in pixels of half the resolution
_LARGEST_STEP_PX = 1.5  # beyond it the linearisation means nothing
_COMPARED_PX = 7        # side of the window within which detail is compared
_LEAST_GRADIENT = 1e-4  # square of the mean gradient added to all, against division by zero


def unexplained(disparity_px: F32, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> F32:
    """Return how much of the detail around a pixel is not that around its match.

    It is the mean square of their difference, over the sum of their own mean squares: 0 for equal
    detail, 1 for detail that has nothing in common.

    Args:
        disparity_px: (h, w) left column minus right column.
        left: (h, w) rectified image.
        right: (h, w) rectified image.

    Returns:
        (h, w), infinite where there is no detail at all.
    """
    height, width = disparity_px.shape
    columns = np.subtract(np.arange(width, dtype=np.float32), disparity_px)
    rows = np.repeat(np.arange(height, dtype=np.float32)[:, None], width, axis=1)
    detail = _high_pass(left)
    seen = cv2.remap(_high_pass(right), columns, rows, cv2.INTER_LINEAR,
                     borderMode=cv2.BORDER_REPLICATE)
    window = (_COMPARED_PX, _COMPARED_PX)
    apart, own, other = (cv2.sqrBoxFilter(image, cv2.CV_32F, window)
                         for image in (cv2.subtract(seen, detail), detail, seen))
    with np.errstate(divide='ignore', invalid='ignore'):
        share = np.divide(apart, cv2.add(own, other))
    return np.asarray(np.nan_to_num(share, copy=False, nan=np.inf), np.float32)


def refined(disparity_px: F32, valid: NDArray[np.bool_], left: NDArray[np.uint8],
            right: NDArray[np.uint8]) -> F32:
    """Return (h, w) float32 disparity, refined where it is valid; meaningless elsewhere [px].

    Args:
        disparity_px: (h, w) left column minus right column.
        valid: (h, w).
        left: (h, w) left image of the rectified pair.
        right: (h, w) right image of the rectified pair.
    """
    height, width = disparity_px.shape
    weight = valid.astype(np.float32)
    start = _smoothed(np.multiply(disparity_px, weight), weight)
    columns = np.subtract(np.arange(width, dtype=np.float32), start)
    rows = np.repeat(np.arange(height, dtype=np.float32)[:, None], width, axis=1)
    detail, other = _high_pass(left), _high_pass(right)
    seen, gradient = (cv2.remap(image, columns, rows, cv2.INTER_LINEAR,
                                borderMode=cv2.BORDER_REPLICATE)
                      for image in (other, _half_gradient(other)))
    gradient = cv2.multiply(cv2.add(gradient, _half_gradient(detail)), weight)
    # The fit is smooth: half the resolution is enough for it.
    half = ((width + 1) // 2, (height + 1) // 2)
    product, square = (
        cv2.GaussianBlur(cv2.resize(cv2.multiply(gradient, values), half,
                                    interpolation=cv2.INTER_AREA), (5, 5), _WINDOW_SIGMA)
        for values in (cv2.subtract(seen, detail), gradient))
    step = np.divide(product, np.add(square, np.float32(_LEAST_GRADIENT)))
    step = np.clip(step, -_LARGEST_STEP_PX, _LARGEST_STEP_PX)
    step = cv2.resize(step, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.add(start, step), np.float32)


def _smoothed(weighted_px: F32, weight: F32) -> F32:
    """Return the mean disparity of the valid pixels around each one, but not across an edge."""
    size = (_SMOOTHED_PX, _SMOOTHED_PX)
    count = cv2.boxFilter(weight, cv2.CV_32F, size, normalize=False)
    total = cv2.boxFilter(weighted_px, cv2.CV_32F, size, normalize=False)
    mean = cv2.divide(total, np.maximum(count, np.float32(1.0)))
    np.copyto(mean, weighted_px, where=cv2.absdiff(mean, weighted_px) > _SAME_SURFACE_PX)
    return np.asarray(mean, np.float32)


def _high_pass(image: NDArray[np.uint8]) -> F32:
    """Return an image less its mean in a window: both cameras need not be equally bright."""
    mean = cv2.blur(image, (_HIGH_PASS_PX, _HIGH_PASS_PX))
    return np.asarray(cv2.subtract(image, mean, dtype=cv2.CV_32F), np.float32)


def _half_gradient(image: F32) -> F32:
    """Return half the brightness gradient along the rows, by central differences."""
    return np.asarray(cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1, scale=0.25), np.float32)
