"""Corners, their tracks from image to image, and their matches in the right image."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.slam.euroc_reader import Image

BORDER_PX = 12
_LK = {'winSize': (15, 15), 'maxLevel': 3,
       'criteria': (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)}
_MAX_BACK_PX = 0.5      # a point tracked forth and back ends this close to its start
_MAX_ROW_PX = 0.6       # largest difference in row within a rectified pair
_DISPARITIES = 128      # search range [px]
_STEADY = 0.02          # a change of gain by less does no harm
_GRID = (6, 8)          # rows and columns of cells; corners are detected in each


def detect(image: Image, known_px: Array, wanted: int) -> Array:
    """Return (k, 2) new corners [px], spread over the image and away from the known ones."""
    mask = np.zeros(image.shape, np.uint8)
    mask[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = 255
    for x, y in known_px:
        cv2.circle(mask, (round(x), round(y)), 9, 0, -1)
    rows, columns = _GRID
    h, w = image.shape
    found = []
    for i, j in np.ndindex(rows, columns):
        top, left = i * h // rows, j * w // columns
        area = np.s_[top:(i + 1) * h // rows, left:(j + 1) * w // columns]
        corners = cv2.goodFeaturesToTrack(image[area], 2 + 2 * wanted // (rows * columns), 0.05,
                                          9.0, mask=mask[area], blockSize=5)
        if corners is not None and len(corners):
            found.append(corners.reshape(-1, 2) + (left, top))
    if not found:
        return np.zeros((0, 2))
    # The best corner of every cell comes first, then the second best: weak ones are left out.
    order = np.argsort(np.concatenate([np.arange(len(f)) for f in found]), kind='stable')
    return np.concatenate(found)[order][:wanted].astype(np.float64)


def track(before: Image, after: Image, px: Array,
          guess_px: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
    """Track (n, 2) points into the next image; return their places and which were found.

    The exposure may change from image to image, as automatic exposure does at the start.
    """
    if not len(px):
        return px, np.zeros(0, bool)
    before = _as_bright(before, after)
    there, found = _flow(before, after, px, px if guess_px is None else guess_px)
    back, found_back = _flow(after, before, there, px)
    h, w = after.shape
    home = np.linalg.norm(back - px, axis=1) < _MAX_BACK_PX
    inside = ((there > BORDER_PX) & (there < (w - BORDER_PX, h - BORDER_PX))).all(axis=1)
    return there, found & found_back & home & inside


def _as_bright(before: Image, after: Image) -> Image:
    """Return an image with the mean and the contrast of the next one, unless they are close."""
    (mean, spread), (next_mean, next_spread) = (
        (float(m[0, 0]), float(s[0, 0])) for m, s in map(cv2.meanStdDev, (before, after)))
    gain = next_spread / spread if spread > 0.0 else 1.0
    if abs(gain - 1.0) < _STEADY:
        return before
    grey = np.arange(256.0)
    return np.asarray(cv2.LUT(before, np.clip(np.rint(next_mean + gain * (grey - mean)), 0, 255)
                              .astype(np.uint8)), np.uint8)


def disparities(left: Image, right: Image, px: Array, shrink: int = 1) -> Array:
    """Return (n,) disparities [px] of points in the left image, NaN if no match was found.

    Args:
        shrink: The semi-global matching sees the images smaller by this factor, and takes its
            third power less time.

    Semi-global matching is followed by a sub-pixel step. A low camera sees the ground sheared
    between the images by 0.1 px per row and more. So the right image is first warped by the
    plane that fits most disparities.
    """
    most = _DISPARITIES // shrink
    h, w = left.shape
    small = [image if shrink == 1 else cv2.resize(image, (w // shrink, h // shrink),
                                                  interpolation=cv2.INTER_AREA)
             for image in (left, right)]
    padded = [cv2.copyMakeBorder(image, 0, 0, most, 0, cv2.BORDER_REPLICATE) for image in small]
    # 5 x 5 pixels with the smoothness that OpenCV recommends for them, and a left-right check.
    matcher = cv2.StereoSGBM.create(0, most, 5, 200, 800, 1, 31, 5, 100, 2)
    dense = matcher.compute(*padded)[:, most:].astype(np.float64) * (shrink / 16.0)
    u, v = np.minimum(np.rint(px / shrink), (w // shrink - 1, h // shrink - 1)).astype(int).T
    coarse = dense[v, u]
    found = np.full(len(px), np.nan)
    seen = np.flatnonzero(coarse > 0.0)
    if len(seen) < 8:
        return found
    at = np.column_stack([px[seen], np.ones(len(seen))])
    plane = _plane(at, coarse[seen])
    flat = np.asarray(cv2.warpAffine(
        right, np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]) - np.outer([1.0, 0.0], plane), (w, h),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP), np.uint8)
    # A point p of `flat` is the point p - plane . (p, 1) of the right image.
    guess = px[seen].copy()
    guess[:, 0] -= (coarse[seen] - at @ plane) / (1.0 - plane[0])
    there, good = _flow(left, flat, px[seen], guess, maxLevel=0)
    step = np.abs(there - guess)
    good &= (step[:, 0] < 1.5) & (step[:, 1] < _MAX_ROW_PX)
    value = px[seen, 0] - there[:, 0] + np.column_stack([there[:, 0], at[:, 1:]]) @ plane
    found[seen[good]] = value[good]
    return found


def _plane(at: Array, disparity: Array) -> Array:
    """Return the plane (3,) that fits most disparities, by reweighted least squares."""
    plane: Array = np.zeros(3)
    weight: Array = np.ones(len(at))
    for _ in range(8):
        root = np.sqrt(weight)
        plane = np.asarray(np.linalg.lstsq(at * root[:, None], disparity * root, rcond=None)[0],
                           dtype=np.float64)
        weight = 1.0 / (1.0 + np.abs(at @ plane - disparity))
    return plane


def _flow(before: Image, after: Image, start: Array, guess: Array,
          **options: Any) -> tuple[Array, NDArray[np.bool_]]:
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        before, after, start.astype(np.float32).reshape(-1, 1, 2),
        guess.astype(np.float32).reshape(-1, 1, 2), flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        **{**_LK, **options})
    return there.reshape(-1, 2).astype(np.float64), found.ravel() > 0
