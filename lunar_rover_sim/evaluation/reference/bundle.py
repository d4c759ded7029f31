"""Bundle adjustment of a window of keyframes.

Reprojection errors in the left image and, where there is one, of the column in the right image,
under Huber's loss; poses are corrected from the left, Exp(w) R x + t (Triggs et al., Bundle
adjustment: a modern synthesis, 2000).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from lunar_rover_sim.evaluation.estimator_input import Camera
from lunar_rover_sim.frames import Array

_HUBER_PX = 1.0
_MAX_STEPS = 12


@dataclasses.dataclass
class Problem:
    """Poses and points, and who sees what.

    T_camera_world: (m, 4, 4); fixed: (m,) poses that stay; points_m: (n, 3), world;
    camera_of, point_of: (k,) indices; seen_px: (k, 3) u, v and u in the right image or NaN
    """

    T_camera_world: Array
    fixed: NDArray[np.bool_]
    points_m: Array
    camera_of: NDArray[np.int64]
    point_of: NDArray[np.int64]
    seen_px: Array

    def solve(self, camera: Camera) -> Array:
        """Improve poses and points in place; return the (k,) errors that are left [px]."""
        free = np.flatnonzero(~self.fixed)
        slot = np.full(len(self.fixed), -1)
        slot[free] = np.arange(len(free))
        pattern = _Pattern(self, slot)

        def unpack(x: Array) -> tuple[Array, Array]:
            poses = self.T_camera_world.copy()
            step = x[:6 * len(free)].reshape(-1, 6)
            poses[free, :3, :3] = (Rotation.from_rotvec(step[:, :3]).as_matrix()
                                   @ poses[free, :3, :3])
            poses[free, :3, 3] += step[:, 3:]
            return poses, x[6 * len(free):].reshape(-1, 3)

        def error(x: Array) -> Array:
            poses, points = unpack(x)
            return np.asarray(residuals(camera, poses[self.camera_of], points[self.point_of],
                                        self.seen_px)[pattern.used], dtype=np.float64)

        def jacobian(x: Array) -> csr_matrix:
            poses, points = unpack(x)
            return pattern.jacobian(camera, poses, points)

        start = np.concatenate([np.zeros(6 * len(free)), self.points_m.ravel()])
        result = least_squares(error, start, jacobian, loss='huber', f_scale=_HUBER_PX,
                               x_scale='jac', max_nfev=_MAX_STEPS, ftol=1e-4, xtol=1e-6)
        self.T_camera_world, self.points_m = unpack(result.x)
        left = residuals(camera, self.T_camera_world[self.camera_of],
                         self.points_m[self.point_of], self.seen_px)
        return np.asarray(np.linalg.norm(left, axis=1), dtype=np.float64)


class _Pattern:
    """Where the derivatives go in the sparse Jacobian."""

    def __init__(self, problem: Problem, slot: NDArray[np.int64]) -> None:
        self._problem = problem
        self.used = np.isfinite(problem.seen_px)
        k, frees = len(problem.seen_px), int((slot >= 0).sum())
        column = np.empty((k, 9), np.int64)
        column[:, :6] = 6 * slot[problem.camera_of][:, None] + np.arange(6)
        column[:, 6:] = 6 * frees + 3 * problem.point_of[:, None] + np.arange(3)
        row = np.full((k, 3), -1)
        row[self.used] = np.arange(self.used.sum())
        keep = np.repeat(self.used[:, :, None], 9, axis=2)
        keep[:, :, :6] &= (slot[problem.camera_of] >= 0)[:, None, None]
        self._keep = keep
        self._rows = np.broadcast_to(row[:, :, None], keep.shape)[keep]
        self._columns = np.broadcast_to(column[:, None, :], keep.shape)[keep]
        self._shape = (int(self.used.sum()), 6 * frees + 3 * len(problem.points_m))

    def jacobian(self, camera: Camera, poses: Array, points: Array) -> csr_matrix:
        problem = self._problem
        R = poses[problem.camera_of, :3, :3]
        turned = np.einsum('kij,kj->ki', R, points[problem.point_of])
        x, y, z = (turned + poses[problem.camera_of, :3, 3]).T
        fx, fy = camera.focal_px
        zero, iz = np.zeros_like(z), 1.0 / np.maximum(z, 1e-3)
        by_point = np.stack([
            np.stack([fx * iz, zero, -fx * x * iz**2], axis=-1),
            np.stack([zero, fy * iz, -fy * y * iz**2], axis=-1),
            np.stack([fx * iz, zero, -fx * (x - camera.baseline_m) * iz**2], axis=-1)], axis=1)
        cross = np.zeros((len(z), 3, 3))   # -[R x]_x: of Exp(w) R x by w
        cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = turned[:, 2], -turned[:, 1], turned[:, 0]
        cross -= cross.transpose(0, 2, 1)
        blocks = np.concatenate([by_point @ cross, by_point, by_point @ R], axis=2)
        return csr_matrix((blocks[self._keep], (self._rows, self._columns)), self._shape)


def residuals(camera: Camera, T_camera_world: Array, points_m: Array, seen_px: Array) -> Array:
    """Return (k, 3) errors [px] of left u, v and right u; 0 where there is no right one."""
    p = np.einsum('kij,kj->ki', T_camera_world[:, :3, :3], points_m) + T_camera_world[:, :3, 3]
    z = np.maximum(p[:, 2], 1e-3)
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    predicted = np.stack([fx * p[:, 0] / z + cx, fy * p[:, 1] / z + cy,
                          fx * (p[:, 0] - camera.baseline_m) / z + cx], axis=1)
    return np.nan_to_num(predicted - seen_px, nan=0.0)
