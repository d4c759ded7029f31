"""The motion between two stereo pairs, with its covariance.

Descriptors are matched, or corners tracked from a predicted place; P3P with RANSAC finds what
agrees, and Gauss-Newton steps over the reprojection errors the motion. Each error is weighted by
its covariance, to which the point adds its own: sigma^2 I + J P J^T (Hartley and Zisserman, 2nd
ed., 2004, 5.2).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.frames import Array, inverse, se3
from lunar_rover_sim.judge.slam.euroc_reader import Camera, Image
from lunar_rover_sim.judge.slam.graph.places import Keyframe
from lunar_rover_sim.judge.slam.reference.geometry import locate, project, track

MIN_INLIERS = 20
_RATIO = 0.85               # of the distances to the best and the second descriptor
_FEW = 10                   # inliers of a prediction
_STEPS = 6
_SIGMA_PX = 0.35            # of a corner, and of a disparity
_GATE = 3.0                 # an error beyond this many deviations is no inlier
# Errors of neighbouring corners hang together: the information of n of them is that of n / this.
_TOGETHER = 2.5
_FLOOR_M, _FLOOR_RAD = 2e-4, 1e-4      # standard deviations that no motion is below


class Motion(NamedTuple):
    """A motion between the left cameras of two pairs.

    Attributes:
        T_a_b: (4, 4).
        covariance: (6, 6) of the turn [rad] and the shift [m] in b: T_a_b Exp(turn, shift).
        inliers: Number of points that agree.
        flow_px: Median way of them in the image.
    """

    T_a_b: Array
    covariance: Array
    inliers: int
    flow_px: float


def tracked_motion(camera: Camera, a: Keyframe, image_b: Image, T_b_a: Array) -> Motion | None:
    """Return the motion from corners of a, tracked into the left image of b from a prediction.

    The image of a is first warped as the prediction sees the plane of its ground, since near
    ground looks stretched after a step.
    """
    h, w = image_b.shape
    n = _plane(a.points_m)
    H = camera.matrix @ (T_b_a[:3, :3] + np.outer(T_b_a[:3, 3], n)) @ np.linalg.inv(camera.matrix)
    # What a does not show is taken from b: black there would spoil the match of brightness.
    flat = np.asarray(cv2.warpPerspective(a.left, H, (w, h), dst=image_b.copy(),
                                          borderMode=cv2.BORDER_TRANSPARENT), np.uint8)
    guess = project(camera, T_b_a, a.points_m)
    there = np.column_stack([a.px[:, :2], np.ones(len(a))]) @ H.T
    ahead = (a.points_m @ T_b_a[2, :3] + T_b_a[2, 3] > 0.1) & (there[:, 2] > 1e-3)
    there = there[:, :2] / np.where(ahead, there[:, 2], 1.0)[:, None]
    inside = ahead & ((guess > 0.0) & (guess < (w, h)) & (there > 0.0) & (there < (w, h))
                      ).all(axis=1)
    index = np.flatnonzero(inside)
    if len(index) < MIN_INLIERS:
        return None
    px, found = track(flat, image_b, there[index], guess[index])
    index, px = index[found], px[found]
    return _motion(camera, a, index, np.column_stack([px, np.full(len(px), np.nan)]), MIN_INLIERS)


def matched_motion(camera: Camera, a: Keyframe, b: Keyframe) -> Motion | None:
    """Return the motion from the descriptors of two pairs, from wherever they were taken.

    A few matches suffice for a prediction; tracking from there must then find many corners.
    """
    i, j = _matches(a.descriptors, b.descriptors)
    coarse = _motion(camera, a, i, b.px[j], _FEW)
    if coarse is None:
        return None
    fine = tracked_motion(camera, a, b.left, inverse(coarse.T_a_b))
    # Once more from there: the first prediction may have been some pixels off.
    return fine and tracked_motion(camera, a, b.left, inverse(fine.T_a_b))


def _plane(points: Array) -> Array:
    """Return n (3,) of the plane n . p = 1 that is near most points."""
    weight = np.ones(len(points))
    n: Array = np.zeros(3)
    for _ in range(6):
        A = points * weight[:, None]
        n = np.asarray(np.linalg.lstsq(A, weight, rcond=None)[0], float)
        weight = 1.0 / (1.0 + (np.abs(points @ n - 1.0) / 0.03)**2)
    return n


def _matches(a: NDArray[np.uint8],
             b: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return indices of descriptors that are each other's best, clearly so."""
    none = np.zeros(0, np.int64)
    if min(len(a), len(b)) < _FEW:
        return none, none
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    af, bf = a.astype(np.float32), b.astype(np.float32)
    back = {m.queryIdx: m.trainIdx for m in matcher.match(bf, af)}
    pairs = [(best.queryIdx, best.trainIdx) for best, second in matcher.knnMatch(af, bf, k=2)
             if best.distance < _RATIO * second.distance and back[best.trainIdx] == best.queryIdx]
    found = np.array(pairs, np.int64).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _motion(camera: Camera, a: Keyframe, index: NDArray[np.int64], seen_px: Array,
            least: int) -> Motion | None:
    """Return the motion from points of a and what b sees of them: u, v and right u or NaN."""
    if len(index) < least:
        return None
    points = a.points_m[index]
    T, good = locate(camera, points, seen_px[:, :2], least)
    if T is None:
        return None
    points, seen_px, flow = points[good], seen_px[good], a.px[index[good], :2]
    refined = _refine(camera, T, points, seen_px, least)
    if refined is None:
        return None
    T, information, used = refined
    R = T[:3, :3]
    # Exp(w, v) T_b_a is T_a_b Exp(-w, -v): the same covariance, in b.
    covariance = np.asarray(_TOGETHER * np.linalg.inv(information) + np.diag(
        [_FLOOR_RAD**2] * 3 + [_FLOOR_M**2] * 3), float)
    T_a_b = se3(R.T, -R.T @ T[:3, 3])
    return Motion(T_a_b, covariance, used, float(np.median(
        np.linalg.norm(seen_px[:, :2] - flow, axis=1))))


def _refine(camera: Camera, T: Array, points: Array,
            seen_px: Array, least: int) -> tuple[Array, Array, int] | None:
    """Return T_b_a, the information (6, 6) of Exp(w, v) T_b_a and the number of inliers."""
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    known = np.isfinite(seen_px)
    # Of a point: sigma of u, v and the disparity along the ray.
    spread = _point_covariances(camera, points)
    used = np.ones(len(points), bool)
    information = np.zeros((6, 6))
    for step in range(_STEPS):
        p = points @ T[:3, :3].T + T[:3, 3]
        x, y = p[:, 0], p[:, 1]
        iz = 1.0 / np.maximum(p[:, 2], 0.05)
        predicted = np.column_stack([fx * x * iz + cx, fy * y * iz + cy,
                                     fx * (x - camera.baseline_m) * iz + cx])
        error = np.where(known, seen_px - predicted, 0.0)
        zero = np.zeros(len(p))
        by_point = np.stack([np.stack([fx * iz, zero, -fx * x * iz**2], axis=-1),
                             np.stack([zero, fy * iz, -fy * y * iz**2], axis=-1),
                             np.stack([fx * iz, zero, -fx * (x - camera.baseline_m) * iz**2],
                                      axis=-1)], axis=1)
        turned = T[:3, :3] @ spread @ T[:3, :3].T
        S = by_point @ turned @ by_point.transpose(0, 2, 1) + _SIGMA_PX**2 * np.eye(3)
        # What is not seen has no weight.
        S[~known, :] = 0.0
        S[(~known)[:, None, :] & np.ones((1, 3, 1), bool)] = 0.0
        S[:, [0, 1, 2], [0, 1, 2]] += np.where(known, 0.0, 1.0)
        W = np.linalg.inv(S) * (known[:, :, None] & known[:, None, :])
        square = np.einsum('ni,nij,nj->n', error, W, error)
        if step >= 2:
            used = square < _GATE**2 * known.sum(axis=1)
        if used.sum() < least:
            return None
        weight = 1.0 / np.maximum(1.0, np.sqrt(square / known.sum(axis=1)))
        J = np.concatenate([by_point @ _minus_cross(p), by_point], axis=2)[used]
        WJ = (weight[:, None, None] * W)[used] @ J
        information = np.einsum('nri,nrj->ij', J, WJ)
        gradient = np.einsum('nri,nr->i', WJ, error[used])
        try:
            move = np.linalg.solve(information, gradient)
        except np.linalg.LinAlgError:
            return None
        turn = Rotation.from_rotvec(move[:3]).as_matrix()
        T = se3(turn @ T[:3, :3], turn @ T[:3, 3] + move[3:])
    if not np.isfinite(T).all() or np.linalg.cond(information) > 1e12:
        return None
    # The errors may be larger than assumed, never smaller.
    scale = max(1.0, float(np.mean(square[used] / known[used].sum(axis=1))))
    return T, information / scale, int(used.sum())


def _point_covariances(camera: Camera, points: Array) -> Array:
    """Return (n, 3, 3) covariances of points by errors of u, v and disparity."""
    x, y, z = points.T
    fx, fy = camera.focal_px
    per_disparity = -z**2 / (fx * camera.baseline_m)
    zero = np.zeros_like(z)
    J = np.stack([np.stack([z / fx, zero, x / z * per_disparity], axis=-1),
                  np.stack([zero, z / fy, y / z * per_disparity], axis=-1),
                  np.stack([zero, zero, per_disparity], axis=-1)], axis=1)
    # A tracked corner is where it is by definition: only its disparity is uncertain.
    return np.asarray(J @ (np.diag([0.0, 0.0, _SIGMA_PX**2])) @ J.transpose(0, 2, 1))


def _minus_cross(p: Array) -> Array:
    """Return -[p]_x (n, 3, 3), the derivative of Exp(w) p by w."""
    cross = np.zeros((len(p), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = p[:, 2], -p[:, 1], p[:, 0]
    return cross - cross.transpose(0, 2, 1)
