"""Sub-pixel refinement of a disparity map: one step of least squares on the brightness itself.

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

import cv2
import numpy as np
from numpy.typing import NDArray

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
