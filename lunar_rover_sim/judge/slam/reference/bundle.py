"""Bundle adjustment of a window of keyframes.

The cost is Huber's loss of the reprojection errors: column and row in the left image, and the
column in the right image of a stereo pair. Poses are perturbed from the left, Exp(w) R x + t. The
solver takes Levenberg-Marquardt steps. The Schur complement eliminates the points (Triggs et al.,
Bundle adjustment: a modern synthesis, 2000, 6.1), which leaves a dense system of a few poses.

SciPy's sparse least squares was tried instead. With one camera its inexact steps leave four times
the error in three times the time; with exact steps it takes ten times as long.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.slam.euroc_reader import Camera

_HUBER_PX = 1.0
_MAX_STEPS = 15
_DONE = 1e-4             # the solver stops when the relative gain of a step is below this
_DAMPING = 1e-4          # of the first step, relative to the diagonal


@dataclasses.dataclass
class Problem:
    """Poses, points and observations.

    Attributes:
        T_camera_world: (m, 4, 4) poses.
        fixed: (m,) whether a pose is kept as it is.
        points_m: (n, 3) points, world frame.
        camera_of, point_of: (k,) indices of pose and point of each observation.
        seen_px: (k, 3) observations: u, v, and u in the right image, NaN if it is unknown.
    """

    T_camera_world: Array
    fixed: NDArray[np.bool_]
    points_m: Array
    camera_of: NDArray[np.int64]
    point_of: NDArray[np.int64]
    seen_px: Array

    def solve(self, camera: Camera) -> Array:
        """Improve poses and points in place; return the remaining (k, 3) errors [px]."""
        error = self._errors(camera, self.T_camera_world, self.points_m)
        size = self._size()
        damping, cost = _DAMPING, _huber(error)
        system = self._system(camera, error)
        for _ in range(_MAX_STEPS):
            poses, points = self._step(system, damping)
            tried = self._errors(camera, poses, points)
            gain = cost - _huber(tried)
            if not gain > 0.0:
                damping *= 10.0
                continue
            self.T_camera_world, self.points_m, error = poses, points, tried
            damping *= 0.2
            if gain < _DONE * cost:
                break
            cost -= gain
            system = self._system(camera, error)
        if not camera.baseline_m and np.count_nonzero(self.fixed) == 1:
            # One camera does not determine the scale. Keep that of the poses outside the window.
            self._grow(size / max(self._size(), 1e-12))
        return error

    def _offsets(self) -> Array:
        """Return (m, 3) vectors from the first fixed camera to every camera."""
        centres = -np.einsum('mji,mj->mi', self.T_camera_world[:, :3, :3],
                             self.T_camera_world[:, :3, 3])
        return np.asarray(centres - centres[np.argmax(self.fixed)])

    def _size(self) -> float:
        return float(np.linalg.norm(self._offsets()))

    def _grow(self, factor: float) -> None:
        """Scale poses and points about the first fixed camera; errors do not change."""
        offsets = self._offsets()
        pose = self.T_camera_world[np.argmax(self.fixed)]
        centre = -pose[:3, :3].T @ pose[:3, 3]
        self.T_camera_world[:, :3, 3] -= (factor - 1.0) * np.einsum(
            'mij,mj->mi', self.T_camera_world[:, :3, :3], offsets)
        self.points_m = centre + factor * (self.points_m - centre)

    def _errors(self, camera: Camera, poses: Array, points: Array) -> Array:
        return residuals(camera, poses[self.camera_of], points[self.point_of], self.seen_px)

    def _system(self, camera: Camera, error: Array) -> tuple[Array, ...]:
        """Return the blocks of the normal equations: U, V, W and both right sides."""
        m, n = len(self.fixed), len(self.points_m)
        by_pose, by_point = _derivatives(camera, self.T_camera_world[self.camera_of],
                                         self.points_m[self.point_of])
        weight = 1.0 / np.maximum(np.abs(error) / _HUBER_PX, 1.0)
        weight[~np.isfinite(self.seen_px)] = 0.0
        weighted_pose, weighted_point = by_pose * weight[..., None], by_point * weight[..., None]
        U, V, W = np.zeros((m, 6, 6)), np.zeros((n, 3, 3)), np.zeros((m, 6, n, 3))
        a, b = np.zeros((m, 6)), np.zeros((n, 3))
        np.add.at(U, self.camera_of, np.einsum('kri,krj->kij', weighted_pose, by_pose))
        np.add.at(V, self.point_of, np.einsum('kri,krj->kij', weighted_point, by_point))
        W[self.camera_of, :, self.point_of] = np.einsum('kri,krj->kij', weighted_pose, by_point)
        np.add.at(a, self.camera_of, -np.einsum('kri,kr->ki', weighted_pose, error))
        np.add.at(b, self.point_of, -np.einsum('kri,kr->ki', weighted_point, error))
        free = ~self.fixed
        return U[free], V, W[free], a[free], b

    def _step(self, system: tuple[Array, ...], damping: float) -> tuple[Array, Array]:
        """Return poses and points after a step with this damping."""
        U, V, W, a, b = system
        count = len(U)
        grown = np.eye(3) * damping * np.einsum('nii->ni', V)[:, None] + 1e-9 * np.eye(3)
        inverse = np.linalg.inv(V + grown)
        eliminated = np.einsum('minj,njl->minl', W, inverse).reshape(6 * count, -1)
        S = -eliminated @ W.reshape(6 * count, -1).T
        for k in range(count):
            S[6 * k:6 * k + 6, 6 * k:6 * k + 6] += U[k] + damping * np.diag(np.diag(U[k]))
        S += 1e-9 * np.eye(6 * count)
        step = np.linalg.solve(S, a.ravel() - eliminated @ b.ravel())
        back = b - np.einsum('minj,mi->nj', W, step.reshape(-1, 6))
        poses = self.T_camera_world.copy()
        turn = Rotation.from_rotvec(step.reshape(-1, 6)[:, :3]).as_matrix()
        poses[~self.fixed, :3, :3] = turn @ poses[~self.fixed, :3, :3]
        poses[~self.fixed, :3, 3] += step.reshape(-1, 6)[:, 3:]
        return poses, self.points_m + np.einsum('nij,nj->ni', inverse, back)


def residuals(camera: Camera, T_camera_world: Array, points_m: Array, seen_px: Array) -> Array:
    """Return (k, 3) errors [px] of left u, v and right u; 0 where right u is unknown."""
    p = np.einsum('kij,kj->ki', T_camera_world[:, :3, :3], points_m) + T_camera_world[:, :3, 3]
    z = np.maximum(p[:, 2], 1e-3)
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    predicted = np.stack([fx * p[:, 0] / z + cx, fy * p[:, 1] / z + cy,
                          fx * (p[:, 0] - camera.baseline_m) / z + cx], axis=1)
    return np.nan_to_num(predicted - seen_px, nan=0.0)


def _huber(error: Array) -> float:
    size = np.abs(error)
    return float(np.where(size < _HUBER_PX, 0.5 * size**2,
                          _HUBER_PX * (size - 0.5 * _HUBER_PX)).sum())


def _derivatives(camera: Camera, T_camera_world: Array, points_m: Array) -> tuple[Array, Array]:
    """Return the derivatives of the residuals by (w, t), (k, 3, 6), and by point, (k, 3, 3)."""
    R = T_camera_world[:, :3, :3]
    turned = np.einsum('kij,kj->ki', R, points_m)
    x, y, z = (turned + T_camera_world[:, :3, 3]).T
    fx, fy = camera.focal_px
    zero, iz = np.zeros_like(z), 1.0 / np.maximum(z, 1e-3)
    at_camera = np.stack([
        np.stack([fx * iz, zero, -fx * x * iz**2], axis=-1),
        np.stack([zero, fy * iz, -fy * y * iz**2], axis=-1),
        np.stack([fx * iz, zero, -fx * (x - camera.baseline_m) * iz**2], axis=-1)], axis=1)
    cross = np.zeros((len(z), 3, 3))   # -[R x]_x, the derivative of Exp(w) R x by w
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = turned[:, 2], -turned[:, 1], turned[:, 0]
    cross -= cross.transpose(0, 2, 1)
    return np.concatenate([at_camera @ cross, at_camera], axis=2), at_camera @ R
