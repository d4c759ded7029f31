"""Corners, their tracks from image to image, and their matches in the right image."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.evaluation.estimator_input import Image
from lunar_rover_sim.frames import Array

BORDER_PX = 12
_LK = {'winSize': (15, 15), 'maxLevel': 3,
       'criteria': (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)}
_LK_STEREO = {**_LK, 'maxLevel': 0}
_MAX_BACK_PX = 0.5      # forth and back must come home
_MAX_ROW_PX = 0.6       # a pair is rectified
_HALF_PX = 7            # half of a template
_SEARCH_PX = 48         # along a row, about the plane of the ground
_MIN_CORRELATION = 0.7
_GRID = (6, 8)          # cells in which corners are found, rows and columns


def detect(image: Image, known_px: Array, wanted: int) -> Array:
    """Return (k, 2) new corners [px], spread over the image and away from the known ones."""
    mask = np.zeros(image.shape, np.uint8)
    mask[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = 255
    for x, y in known_px:
        cv2.circle(mask, (round(x), round(y)), 9, 0, -1)
    rows, columns = _GRID
    h, w = image.shape
    found = []
    each = max(2, -(-wanted // (rows * columns)) * 2)
    for i in range(rows):
        for j in range(columns):
            top, left = i * h // rows, j * w // columns
            area = np.s_[top:(i + 1) * h // rows, left:(j + 1) * w // columns]
            corners = cv2.goodFeaturesToTrack(image[area], each, 0.05, 9.0, mask=mask[area],
                                              blockSize=5)
            if corners is not None and len(corners):
                found.append(corners.reshape(-1, 2) + (left, top))
    if not found:
        return np.zeros((0, 2))
    # Round after round, the best of every cell first, so that the weak ones are what is left out.
    order = np.argsort(np.concatenate([np.arange(len(f)) for f in found]), kind='stable')
    return np.concatenate(found)[order][:wanted].astype(np.float64)


def track(before: Image, after: Image, px: Array,
          guess_px: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
    """Follow (n, 2) points into the next image; return where they are, and which were found."""
    if not len(px):
        return px, np.zeros(0, bool)
    start = px.astype(np.float32)
    there, found = _flow(before, after, start, guess_px, _LK)
    back, found_back = _flow(after, before, there, start, _LK)
    h, w = after.shape
    home = np.linalg.norm(back - start, axis=1) < _MAX_BACK_PX
    inside = ((there > BORDER_PX) & (there < (w - BORDER_PX, h - BORDER_PX))).all(axis=1)
    return there.astype(np.float64), found & found_back & home & inside


class StereoMatcher:
    """Disparities of points, by correlation along the row and a sub-pixel step.

    The ground, seen from low, is sheared between the images by a tenth of a pixel a row and more;
    the right image is therefore first warped by the plane of disparities of the last pair.
    """

    def __init__(self) -> None:
        self._plane: Array | None = None   # disparity = plane . (u, v, 1)

    def match(self, left: Image, right: Image, px: Array) -> Array:
        """Return (n,) disparities [px] of points in the left image, NaN where there is none."""
        if self._plane is None:
            self._plane = np.array([0.0, 0.0, 64.0])
            for _ in range(2):
                self._fit(px, self._once(left, right, px, 2 * _SEARCH_PX))
        disparity = self._once(left, right, px, _SEARCH_PX)
        self._fit(px, disparity)
        return disparity

    def _once(self, left: Image, right: Image, px: Array, search_px: int) -> Array:
        a, b, c = self._plane if self._plane is not None else np.zeros(3)
        h, w = left.shape
        flat = np.asarray(cv2.warpAffine(
            right, np.array([[1.0 - a, -b, -c], [0.0, 1.0, 0.0]]), (w, h),
            flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP), np.uint8)
        coarse = np.full(len(px), np.nan)
        for k, (u, v) in enumerate(np.rint(px).astype(int)):
            if not (_HALF_PX <= u < w - _HALF_PX and _HALF_PX <= v < h - _HALF_PX):
                continue
            rows = slice(v - _HALF_PX, v + _HALF_PX + 1)
            first = max(0, u - search_px - _HALF_PX)
            strip = flat[rows, first:min(w, u + search_px + _HALF_PX + 1)]
            score = cv2.matchTemplate(strip, left[rows, u - _HALF_PX:u + _HALF_PX + 1],
                                      cv2.TM_CCOEFF_NORMED)[0]
            best = int(np.argmax(score))
            if score[best] >= _MIN_CORRELATION and 0 < best < len(score) - 1:
                coarse[k] = first + best + _HALF_PX - u
        disparity = np.full(len(px), np.nan)
        seen = np.flatnonzero(np.isfinite(coarse))
        if not len(seen):
            return disparity
        start = px[seen].astype(np.float32)
        guess = start + np.stack([coarse[seen], np.zeros(len(seen))], axis=1).astype(np.float32)
        there, found = _flow(left, flat, start, guess, _LK_STEREO)
        step = there - guess
        good = found & (np.abs(step[:, 0]) < 1.5) & (np.abs(step[:, 1]) < _MAX_ROW_PX)
        u = there[:, 0].astype(np.float64)
        value = px[seen, 0] - (u - (a * u + b * px[seen, 1] + c))
        disparity[seen[good & (value > 0.3)]] = value[good & (value > 0.3)]
        return disparity

    def _fit(self, px: Array, disparity: Array) -> None:
        """Fit the plane of most disparities, by reweighted least squares."""
        seen = np.isfinite(disparity)
        if seen.sum() < 20:
            return
        A, d = np.column_stack([px[seen], np.ones(seen.sum())]), disparity[seen]
        weight = np.ones(len(d))
        for _ in range(8):
            root = np.sqrt(weight)[:, None]
            plane = np.linalg.lstsq(A * root, d * root[:, 0], rcond=None)[0]
            weight = 1.0 / (1.0 + np.abs(A @ plane - d))
        self._plane = plane


def _flow(before: Image, after: Image, start: NDArray[np.float32],
          guess: Array | NDArray[np.float32] | None,
          options: dict) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    there: Any = None
    if guess is not None:
        options = {**options, 'flags': cv2.OPTFLOW_USE_INITIAL_FLOW}
        there = np.array(guess, np.float32).reshape(-1, 1, 2)
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, after, start.reshape(-1, 1, 2), there,
                                               **options)
    return np.asarray(there, np.float32).reshape(-1, 2), found.ravel() > 0
