"""Where a pair shows the sky, from its images alone: what has no detail up to their upper edge.

A block beside the skyline or the sun holds their edges, by which a matcher finds a disparity for
sky. What is sky is found as a person finds it: it is even but for noise, and reaches the upper
edge of the image. The disc of the sun and its blooming are full, and lie in it.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
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
    detail = _detail(image)
    noise = float(np.clip(np.median(detail[:_TOP_ROWS]), *_NOISE))
    even = detail < _OVER_NOISE * noise
    found = _grown(_from_above(even), image, noise)
    passed = found
    if _add_sun(found, image):
        far = disparity_px < _FAR_PX
        passed = found | even | ~valid | far
        found |= far
    # Shadow on the ground is as even, but lies below detail.
    found &= np.logical_and.accumulate(passed, axis=0)
    return np.asarray(cv2.dilate(found.view(np.uint8), np.ones((3, 3), np.uint8)) > 0)


def _detail(image: U8) -> F32:
    """Return the standard deviation of what varies over a few pixels."""
    grey = image.astype(np.float32)
    grey -= cv2.blur(grey, (_EVEN_PX, _EVEN_PX))
    return np.asarray(cv2.sqrt(cv2.blur(grey * grey, (_DETAIL_PX, _DETAIL_PX))), np.float32)


def _from_above(even: Mask) -> Mask:
    """Return the parts that reach the upper edge."""
    _, parts = cv2.connectedComponents(even.astype(np.uint8), connectivity=4)
    reaching = np.unique(parts[0][even[0]])
    return np.isin(parts, reaching[reaching > 0])


def _grown(found: Mask, image: U8, noise: float) -> Mask:
    """Return the sky with the pixels beside it that are as bright as it is."""
    grey, weight = image.astype(np.float32), found.astype(np.float32)
    window = (_AROUND_PX, _AROUND_PX)
    around = cv2.blur(grey * weight, window) / np.maximum(cv2.blur(weight, window), 1e-6)
    alike = np.abs(grey - around) < _ALIKE * noise
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    for _ in range(_GROWN):
        found |= (cv2.dilate(found.view(np.uint8), cross) > 0) & alike
    return found


def _add_sun(found: Mask, image: U8) -> bool:
    """Add full patches in the sky, and the steep edge of their halo; return if there are any."""
    count, parts, facts, _ = cv2.connectedComponentsWithStats((image >= _FULL).astype(np.uint8))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _HALO_PX + 1, 2 * _HALO_PX + 1))
    there = False
    for k in range(1, count):
        if facts[k, cv2.CC_STAT_AREA] < _SUN_PX:
            continue
        near = cv2.dilate((parts == k).astype(np.uint8), disc) > 0
        if found[near & (parts != k)].mean() > _BESIDE_SKY:
            # So is all above the sun.
            found |= np.logical_or.accumulate(near[::-1], axis=0)[::-1]
            there = True
    return there
