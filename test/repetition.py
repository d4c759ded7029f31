"""How well two images match: the measure by which relief that repeats is found."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Features = tuple[Any, Any]


def features(image: NDArray[np.uint8], where: NDArray[np.bool_] | None = None) -> Features:
    """Return key points and descriptors of ORB, in the part of the image that is true."""
    mask = None if where is None else where.astype(np.uint8)
    return cv2.ORB_create(1500).detectAndCompute(image, mask)  # type: ignore[attr-defined]


def inliers(a: Features, b: Features) -> int:
    """Return the number of matches of two images' features that one homography explains."""
    (points_a, found_a), (points_b, found_b) = a, b
    if len(points_a) < 4 or len(points_b) < 4:
        return 0
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, True).match(found_a, found_b)
    if len(matches) < 4:
        return 0
    cv2.setRNGSeed(0)
    mask = cv2.findHomography(
        np.array([points_a[m.queryIdx].pt for m in matches], np.float32),
        np.array([points_b[m.trainIdx].pt for m in matches], np.float32), cv2.RANSAC, 3.0)[1]
    return 0 if mask is None else int(mask.sum())
