"""Where a pair shows the sky, from its images alone: what has no detail up to their upper edge.

A block beside the skyline or the sun holds their edges, by which a matcher finds a disparity for
sky. What is sky is found as a person finds it: it is even but for noise, and reaches the upper
edge of the image. The disc of the sun and its blooming are full, and lie in it.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]         # of masks: 0 or 255
Mask = NDArray[np.bool_]

# Chosen on rendered pairs of baseline and feature_sparse with the sun at 2, 6 and 10 deg.
_EVEN_PX, _DETAIL_PX = 9, 5     # sides of the windows of the local mean and of the detail about it
_OVER_NOISE = 1.6               # detail of the sky at most, over that of the upper rows
_NOISE = (0.5, 1.35)            # bounds of the latter [of 255]
_TOP_ROWS = 16
_AROUND_PX = 15                 # side of the window of the sky around what may belong to it
_GROWN = 8                      # pixels by which the even part is grown, at most
_ALIKE = 4.0                    # difference from the sky around, over its noise
_FULL = 250                     # [of 255]
_SUN_PX = 150                   # least area of the sun
_HALO_PX = 15                   # width of its edge
_BESIDE_SKY = 0.3               # share of sky around the sun
_FAR_PX = 0.2                  # disparity of what seems to be very far


def sky(image: U8, disparity_px: F32, valid: Mask) -> Mask:
    """Return (h, w) where the left image shows the sky, the sun and its ghosts in it included.

    Args:
        image: (h, w) left image of 8 bits.
        disparity_px: (h, w) what was matched. The sun and its ghosts are in one place in both
            images: in a picture with the sun, what seems to be very far is passed over.
        valid: (h, w) where it is.
    """
    variance = _variance_of_detail(image)
    noise = float(np.clip(np.sqrt(np.median(variance[:_TOP_ROWS])), *_NOISE))
    even = _between(variance, -1.0, (_OVER_NOISE * noise)**2)
    found = _from_above(even)
    # No sky lies below these rows, and most steps cost in proportion to them.
    _, top, _, height = cv2.boundingRect(found)
    rows = slice(top + height + _HALO_PX)
    _grow(found[rows], image[rows], noise)
    if _add_sun(found[rows], image[rows]):
        far = _between(disparity_px, -np.inf, _FAR_PX)      # down to the ground
        passed = found | even | np.where(valid, far, np.uint8(255))
        found |= far
    else:
        passed = found = found[rows]
    # Shadow on the ground is as even, but lies below detail.
    found = found & np.bitwise_and.accumulate(passed, axis=0)
    result = np.zeros(image.shape, bool)
    result[:len(found)] = cv2.dilate(found, np.ones((3, 3), np.uint8)) > 0
    return result


def _variance_of_detail(image: U8) -> F32:
    """Return the variance of what varies over a few pixels."""
    mean = cv2.boxFilter(image, cv2.CV_32F, (_EVEN_PX, _EVEN_PX))
    apart = cv2.subtract(image, mean, dtype=cv2.CV_32F)
    return np.asarray(cv2.sqrBoxFilter(apart, cv2.CV_32F, (_DETAIL_PX, _DETAIL_PX)), np.float32)


def _between(values: NDArray[Any], least: float, most: float) -> U8:
    return np.asarray(cv2.inRange(values, float(least), float(most)), np.uint8)


def _from_above(even: U8) -> U8:
    """Return the parts that reach the upper edge."""
    count, parts = cv2.connectedComponents(even, connectivity=4)
    reaching = np.zeros(count, np.uint8)
    reaching[parts[0]] = 255
    reaching[0] = 0
    return np.take(reaching, np.asarray(parts, np.int32))


def _grow(found: U8, image: U8, noise: float) -> None:
    """Add the pixels beside the sky that are as bright as it is."""
    bright, share = (cv2.boxFilter(values, cv2.CV_32F, (_AROUND_PX, _AROUND_PX))
                     for values in (image & found, found & 1))
    around = cv2.divide(bright, share)
    apart = cv2.subtract(image, around, dtype=cv2.CV_32F)   # NaN where none is found around
    alike = _between(apart, -_ALIKE * noise, _ALIKE * noise)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    for _ in range(_GROWN):
        cv2.bitwise_or(found, cv2.bitwise_and(cv2.dilate(found, cross), alike), found)


def _add_sun(found: U8, image: U8) -> bool:
    """Add full patches in the sky, and the steep edge of their halo; return if there are any."""
    full = _between(image, _FULL, 255)
    _, parts = cv2.connectedComponents(full)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _HALO_PX + 1, 2 * _HALO_PX + 1))
    there = False
    for k in np.flatnonzero(np.bincount(parts[full > 0]) >= _SUN_PX).tolist():
        patch = _between(parts, k, k)
        left, top, width, height = cv2.boundingRect(patch)
        first, bottom = max(top - _HALO_PX, 0), top + height + _HALO_PX
        columns = slice(max(left - _HALO_PX, 0), left + width + _HALO_PX)
        box = slice(first, bottom), columns
        near = cv2.dilate(patch[box], disc)
        if np.mean(found[box][near > patch[box]] > 0) > _BESIDE_SKY:
            # So is all above the sun.
            found[box] |= np.bitwise_or.accumulate(near[::-1], axis=0)[::-1]
            found[:first, columns] |= near.max(axis=0)
            there = True
    return there
