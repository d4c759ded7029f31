"""Geometry of one, two and a pair of views (Hartley and Zisserman, 2nd ed., 2004), and corners.

Corners are tracked from image to image, and matched in the right image.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array, inverse, se3
from lunar_rover_sim.judge.slam.euroc_reader import Camera, Image

_RANSAC_PX = 2.0
_CONFIDENCE = 0.999
_START_ANGLE_RAD = np.radians(1.5)   # least median parallax to start with a single camera
_START_FLOW = 0.04                   # least median image motion, in focal lengths
_SAME_RAD = np.radians(3.0)          # rotations that differ by less are the same motion
_START_SHARE = 0.6                   # least share of the tracks that agree with a motion


def project(camera: Camera, T_camera_world: Array, points_m: Array) -> Array:
    """Return (n, 2) pixels of (n, 3) points; those of points behind the camera mean nothing."""
    p = points_m @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    return p[:, :2] / np.maximum(p[:, 2:], 1e-3) * camera.focal_px + camera.centre_px


def from_disparity(camera: Camera, px: Array, disparity_px: Array) -> Array:
    """Return (n, 3) points [m] in the left camera."""
    z = camera.focal_px[0] * camera.baseline_m / disparity_px
    return np.column_stack([(px - camera.centre_px) / camera.focal_px * z[:, None], z])


def locate(camera: Camera, points_m: Array, px: Array,
           least: int) -> tuple[Array | None, NDArray[np.bool_]]:
    """Return T_camera_world of a view of known points, and which points agree (P3P, RANSAC).

    The pose is None if fewer than `least` points, or less than a third, agree.
    """
    none = np.zeros(len(px), bool)
    least = max(least, len(px) // 3)
    cv2.setRNGSeed(0)
    ok, _, _, inliers = cv2.solvePnPRansac(
        points_m, px, camera.matrix, None, iterationsCount=300, reprojectionError=_RANSAC_PX,
        confidence=_CONFIDENCE, flags=cv2.SOLVEPNP_AP3P)
    if not ok or inliers is None or len(inliers) < least:
        return None, none
    good = inliers.ravel()
    # Not from the pose of solvePnPRansac: it is EPnP's, which single points at a great distance
    # send metres away.
    _, rotation, shift = cv2.solvePnP(points_m[good], px[good], camera.matrix, None,
                                      flags=cv2.SOLVEPNP_SQPNP)
    rotation, shift = cv2.solvePnPRefineLM(points_m[good], px[good], camera.matrix, None,
                                           rotation, shift)
    T = se3(cv2.Rodrigues(rotation)[0], np.ravel(shift))
    # The refinement may have moved points across the threshold.
    agree = np.linalg.norm(project(camera, T, points_m) - px, axis=1) < _RANSAC_PX
    return (T, agree) if agree.sum() >= least else (None, none)


def triangulate(camera: Camera, T_a: Array, T_b: Array, px_a: Array, px_b: Array) -> Array:
    """Return (n, 3) points from two views, T_camera_world each (linear, H&Z 12.2)."""
    K = camera.matrix
    x = cv2.triangulatePoints(K @ T_a[:3], K @ T_b[:3], px_a.T.copy(), px_b.T.copy())
    return np.asarray((x[:3] / np.where(np.abs(x[3]) > 1e-12, x[3], 1e-12)).T, dtype=np.float64)


def angles_rad(T_a: Array, T_b: Array, points_m: Array) -> Array:
    """Return (n,) angles [rad] between the rays from two views to their points."""
    rays = [points_m - inverse(T)[:3, 3] for T in (T_a, T_b)]
    cosine = np.sum(rays[0] * rays[1], axis=1) / np.maximum(
        np.linalg.norm(rays[0], axis=1) * np.linalg.norm(rays[1], axis=1), 1e-12)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)), dtype=np.float64)


def two_views(camera: Camera, px_a: Array,
              px_b: Array) -> tuple[Array, Array, NDArray[np.bool_]] | None:
    """Return T_b_a, points in a with median depth 1, and which agree; None without parallax.

    Two motions explain two views of a plane about equally well (H&Z 13.3). The wrong one turns
    by tens of degrees, so the motion with the smaller rotation is returned.
    """
    if np.median(np.linalg.norm(px_b - px_a, axis=1)) < _START_FLOW * camera.focal_px[0]:
        return None
    found = []
    for T in _motions(camera, px_a, px_b):
        points = triangulate(camera, np.eye(4), T, px_a, px_b)
        good = np.ones(len(px_a), bool)
        for view, px in ((np.eye(4), px_a), (T, px_b)):
            good &= (points @ view[2, :3] + view[2, 3] > 0.0)
            good &= np.linalg.norm(project(camera, view, points) - px, axis=1) < _RANSAC_PX
        if good.mean() >= _START_SHARE:
            found.append((T, points, good))
    most = max((good.sum() for _, _, good in found), default=0)
    likely = [f for f in found if f[2].sum() > 0.8 * most]
    if not likely:
        return None
    turns = [np.linalg.norm(cv2.Rodrigues(T[:3, :3])[0]) for T, _, _ in likely]
    T, points, good = likely[0 if turns[0] < min(turns) + _SAME_RAD else int(np.argmin(turns))]
    angles = angles_rad(np.eye(4), T, points[good])
    if np.median(angles) < _START_ANGLE_RAD:
        return None
    good[np.flatnonzero(good)[angles < 0.3 * _START_ANGLE_RAD]] = False
    depth = float(np.median(points[good, 2]))
    T[:3, 3] /= depth
    return T, points / depth, good


def _motions(camera: Camera, px_a: Array, px_b: Array) -> list[Array]:
    """Return candidates of T_b_a, up to scale, from essential matrix and homography."""
    cv2.setRNGSeed(0)
    motions = []
    E, mask = cv2.findEssentialMat(px_a, px_b, camera.matrix, method=cv2.RANSAC,
                                   prob=_CONFIDENCE, threshold=1.0)
    if E is not None and E.shape == (3, 3):
        _, R, t, _ = cv2.recoverPose(E, px_a, px_b, camera.matrix, mask=mask)
        motions.append(se3(R, np.ravel(t)))
    H, _ = cv2.findHomography(px_a, px_b, cv2.RANSAC, _RANSAC_PX)
    if H is not None:
        _, turns, shifts, _ = cv2.decomposeHomographyMat(H, camera.matrix)
        motions += [se3(R, np.ravel(t) / np.linalg.norm(t)) for R, t in zip(turns, shifts)
                    if np.linalg.norm(t) > 1e-9]
    return motions


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
