"""Bundle adjustment of a window of keyframes.

Reprojection errors in the left image and, where there is one, of the column in the right image,
under a soft L1 loss (Triggs et al., Bundle adjustment: a modern synthesis, 2000); poses are
corrected from the left, Exp(w) R x + t.
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

_SOFT_PX = 1.0
_MAX_STEPS = 15
_DONE = 1e-4             # relative gain of a step with which it ends


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
        """Improve poses and points in place; return the (k, 3) errors that are left [px]."""
        m, n = len(self.fixed), len(self.points_m)
        columns = np.concatenate([6 * self.camera_of[:, None] + np.arange(6),
                                  6 * m + 3 * self.point_of[:, None] + np.arange(3)], axis=1)
        columns = np.repeat(columns, 3, axis=0)
        starts = np.arange(0, columns.size + 1, 9)
        # What is fixed has no derivative, and what was not seen neither: they stay out.
        free = ~self.fixed[self.camera_of][:, None, None]
        seen = np.isfinite(self.seen_px)[..., None]

        def errors(step: Array) -> Array:
            poses, points = self._moved(step)
            return residuals(camera, poses[self.camera_of], points[self.point_of],
                             self.seen_px).ravel()

        def jacobian(step: Array) -> csr_matrix:
            poses, points = self._moved(step)
            by_pose, by_point = _derivatives(camera, poses[self.camera_of],
                                             points[self.point_of])
            values = np.concatenate([by_pose * (free & seen), by_point * seen], axis=2)
            return csr_matrix((values.ravel(), columns.ravel(), starts),
                              shape=(values.shape[0] * 3, 6 * m + 3 * n))

        found = least_squares(errors, np.zeros(6 * m + 3 * n), jacobian, loss='soft_l1',
                              f_scale=_SOFT_PX, x_scale='jac', ftol=_DONE, max_nfev=_MAX_STEPS)
        self.T_camera_world, self.points_m = self._moved(found.x)
        return errors(np.zeros_like(found.x)).reshape(-1, 3)

    def _moved(self, step: Array) -> tuple[Array, Array]:
        """Return poses and points after a step: (6 m,) turns and shifts, then (3 n,)."""
        of_poses = step[:6 * len(self.fixed)].reshape(-1, 6)
        poses = self.T_camera_world.copy()
        poses[:, :3, :3] = Rotation.from_rotvec(of_poses[:, :3]).as_matrix() @ poses[:, :3, :3]
        poses[:, :3, 3] += of_poses[:, 3:]
        return poses, self.points_m + step[of_poses.size:].reshape(-1, 3)


def residuals(camera: Camera, T_camera_world: Array, points_m: Array, seen_px: Array) -> Array:
    """Return (k, 3) errors [px] of left u, v and right u; 0 where there is no right one."""
    p = np.einsum('kij,kj->ki', T_camera_world[:, :3, :3], points_m) + T_camera_world[:, :3, 3]
    z = np.maximum(p[:, 2], 1e-3)
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    predicted = np.stack([fx * p[:, 0] / z + cx, fy * p[:, 1] / z + cy,
                          fx * (p[:, 0] - camera.baseline_m) / z + cx], axis=1)
    return np.nan_to_num(predicted - seen_px, nan=0.0)


def _derivatives(camera: Camera, T_camera_world: Array, points_m: Array) -> tuple[Array, Array]:
    """Return d residuals / d (w, t), (k, 3, 6), and by the point, (k, 3, 3)."""
    R = T_camera_world[:, :3, :3]
    turned = np.einsum('kij,kj->ki', R, points_m)
    x, y, z = (turned + T_camera_world[:, :3, 3]).T
    fx, fy = camera.focal_px
    zero, iz = np.zeros_like(z), 1.0 / np.maximum(z, 1e-3)
    at_camera = np.stack([
        np.stack([fx * iz, zero, -fx * x * iz**2], axis=-1),
        np.stack([zero, fy * iz, -fy * y * iz**2], axis=-1),
        np.stack([fx * iz, zero, -fx * (x - camera.baseline_m) * iz**2], axis=-1)], axis=1)
    cross = np.zeros((len(z), 3, 3))   # -[R x]_x: of Exp(w) R x by w
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = turned[:, 2], -turned[:, 1], turned[:, 0]
    cross -= cross.transpose(0, 2, 1)
    return np.concatenate([at_camera @ cross, at_camera], axis=2), at_camera @ R
