"""Geometry of one, two and a pair of views (Hartley and Zisserman, 2nd ed., 2004)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array, inverse, se3
from lunar_rover_sim.judge.slam.euroc_reader import Camera

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
