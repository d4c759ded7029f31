"""Visual odometry: corners are tracked, frames located, a window of keyframes adjusted.

A stereo pair gives the depth of new points at once. A single camera starts as soon as two frames
have enough parallax; its unit of length is the median depth of the first points.

The cost of the adjustment is Huber's loss of the reprojection errors: column and row in the left
image, and the column in the right image of a stereo pair. Poses are perturbed from the left,
Exp(w) R x + t. The solver takes Levenberg-Marquardt steps. The Schur complement eliminates the
points (Triggs et al., Bundle adjustment: a modern synthesis, 2000, 6.1), which leaves a dense
system of a few poses.

SciPy's sparse least squares was tried instead. With one camera its inexact steps leave four times
the error in three times the time; with exact steps it takes ten times as long.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.judge.slam.euroc_reader import Camera, Frame, Image
from lunar_rover_sim.judge.slam.reference.geometry import (angles_rad, detect, disparities,
                                                           from_disparity, locate, project, track,
                                                           triangulate, two_views)

_CORNERS = 400
_WINDOW = 8              # keyframes adjusted together
_FIXED = 2               # oldest keyframes of the window, which are kept as they are
_KEYFRAME_FLOW_PX = 25.0
_KEYFRAME_FRAMES = 8
_MIN_KNOWN = 120         # a keyframe is due if fewer tracks have a point
_MIN_INLIERS = 15
_GIVE_UP_FRAMES = 10
_MIN_ANGLE_RAD = np.radians(1.0)
_MAX_ERROR_PX = 2.5
_MIN_DISPARITY_PX = 1.5


@dataclasses.dataclass
class _Keyframe:
    T_camera_world: Array
    seen: dict[int, Array]   # (3,) u, v and right u or NaN, by track


class VisualOdometry:
    """Tracks one sequence: `add` the frames, then call `trajectory`.

    Args:
        camera: Of images without distortion; its baseline says whether they are pairs.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._before: Image | None = None
        self._ids: NDArray[np.int64] = np.zeros(0, np.int64)
        self._px: Array = np.zeros((0, 2))
        self._next = 0
        self._points: dict[int, Array] = {}
        self._keyframes: list[_Keyframe] = []
        self._motion: Array = np.eye(4)        # camera now from camera before
        self._pose: Array = np.eye(4)
        self._since = 0                        # frames since the last keyframe
        self._missed = 0
        self._located: list[tuple[int, int, Array]] = []   # stamp, keyframe, pose in it
        self.lost_ns: int | None = None

    def __repr__(self) -> str:
        lost = '' if self.lost_ns is None else f', lost at {1e-9 * self.lost_ns:.2f} s'
        return f'VisualOdometry({len(self._located)} frames located{lost})'

    @classmethod
    def of_rig(cls, rig: StereoRig) -> VisualOdometry:
        """Return the odometry of the pairs that a rig takes, as `Renderer.rig` says it."""
        return cls(Camera((rig.focal_px, rig.focal_px), (rig.K[0, 2], rig.K[1, 2]),
                          rig.baseline_m))

    def add(self, stamp_ns: int, left: Image, right: Image | None = None) -> bool:
        """Take a frame, a (h, w) uint8 image or a pair of them; return whether it was located."""
        frame = Frame(stamp_ns, left, right)
        if self.lost_ns is not None:
            return False
        if self._before is not None:
            self._follow(self._before, frame.left)
        self._before = frame.left
        if not self._points:
            started = self._start(frame) if self._camera.baseline_m else self._start_mono(frame)
            if started:
                self._note(frame.stamp_ns)
            return started
        known, points = self._known()
        pose = None
        if len(points) >= _MIN_INLIERS:
            pose, good = locate(self._camera, points, self._px[known], _MIN_INLIERS)
        if pose is None:
            self._missed += 1
            if self._missed >= _GIVE_UP_FRAMES:
                self.lost_ns = frame.stamp_ns
            return False
        self._motion = pose @ inverse(self._pose) if not self._missed else np.eye(4)
        self._pose, self._missed = pose, 0
        self._drop(known[~good])
        self._since += 1
        if self._due(int(good.sum())):
            self._make_keyframe(frame)
        self._note(frame.stamp_ns)
        return True

    @property
    def T_map_camera(self) -> Array:
        """(4, 4) pose of the left camera at the last located frame, as known at that time."""
        return inverse(self._pose)

    def trajectory(self) -> Trajectory:
        """Return T_first_camera of all located frames, after all adjustments."""
        if not self._located:
            raise SlamError('nothing was tracked')
        poses = np.array([inverse(T @ self._keyframes[k].T_camera_world)
                          for _, k, T in self._located])
        return Trajectory(np.array([ns for ns, _, _ in self._located], np.int64), poses[:, :3, 3],
                          wxyz(Rotation.from_matrix(poses[:, :3, :3])), 'reference')

    def _note(self, stamp_ns: int) -> None:
        T = self._pose @ inverse(self._keyframes[-1].T_camera_world)
        self._located.append((stamp_ns, len(self._keyframes) - 1, T))

    def _known(self) -> tuple[NDArray[np.int64], Array]:
        """Return the indices of the tracks that have a point, and these points."""
        index = [k for k, i in enumerate(self._ids.tolist()) if i in self._points]
        points = [self._points[int(self._ids[k])] for k in index]
        return np.array(index, np.int64), np.array(points).reshape(-1, 3)

    def _drop(self, which: NDArray) -> None:
        self._ids, self._px = np.delete(self._ids, which), np.delete(self._px, which, axis=0)

    def _follow(self, before: Image, image: Image) -> None:
        """Track into the next image, starting at the places that the last motion predicts."""
        guess = self._px.copy()
        known, points = self._known()
        guess[known] += (project(self._camera, self._motion @ self._pose, points)
                         - project(self._camera, self._pose, points))
        self._px, found = track(before, image, self._px, guess)
        self._drop(np.flatnonzero(~found))

    def _start(self, frame: Frame) -> bool:
        self._make_keyframe(frame)
        if len(self._points) < 2 * _MIN_INLIERS:
            self._points.clear()
            self._keyframes.clear()
        return bool(self._points)

    def _start_mono(self, frame: Frame) -> bool:
        first = self._keyframes[0].seen if self._keyframes else {}
        both = np.array([k for k, i in enumerate(self._ids.tolist()) if i in first], np.int64)
        if len(both) < 4 * _MIN_INLIERS:
            self._refill(frame.left)
            self._keyframes = [_Keyframe(np.eye(4), self._observations(None))]
            return False
        ids = self._ids[both]
        views = two_views(self._camera, np.array([first[i][:2] for i in ids]), self._px[both])
        if views is None:
            return False
        self._pose, points, good = views
        self._points = dict(zip(ids[good].tolist(), points[good]))
        self._drop(both[~good])
        self._make_keyframe(frame)
        return True

    def _due(self, inliers: int) -> bool:
        seen = self._keyframes[-1].seen
        moved = [np.linalg.norm(p - seen[i][:2]) for i, p in zip(self._ids, self._px) if i in seen]
        return (inliers < _MIN_KNOWN or self._since >= _KEYFRAME_FRAMES or not moved
                or float(np.median(moved)) > _KEYFRAME_FLOW_PX)

    def _refill(self, image: Image) -> None:
        new = detect(image, self._px, _CORNERS - len(self._px))
        self._ids = np.concatenate([self._ids, self._next + np.arange(len(new))])
        self._px = np.concatenate([self._px, new])
        self._next += len(new)

    def _observations(self, disparity: Array | None) -> dict[int, Array]:
        right = self._px[:, 0] - (np.nan if disparity is None else disparity)
        return dict(zip(self._ids.tolist(), np.column_stack([self._px, right])))

    def _make_keyframe(self, frame: Frame) -> None:
        self._since = 0
        self._refill(frame.left)
        disparity = None
        if frame.right is not None and self._camera.baseline_m:
            disparity = disparities(frame.left, frame.right, self._px)
        self._keyframes.append(_Keyframe(self._pose, self._observations(disparity)))
        add_points = self._measure if self._camera.baseline_m else self._triangulate
        add_points()
        if len(self._keyframes) > 1:
            self._adjust()
            add_points()

    def _measure(self) -> None:
        """Give a point to every track that has none, by its disparity."""
        new = {i: px for i, px in self._keyframes[-1].seen.items()
               if i not in self._points and px[0] - px[2] > _MIN_DISPARITY_PX}
        px = np.array(list(new.values())).reshape(-1, 3)
        T = inverse(self._pose)
        points = from_disparity(self._camera, px[:, :2], px[:, 0] - px[:, 2])
        self._points.update(zip(new, points @ T[:3, :3].T + T[:3, 3]))

    def _triangulate(self) -> None:
        """Give a point to every track that has none and enough parallax."""
        for keyframe in self._keyframes[-_WINDOW:-1]:
            shared = [k for k, i in enumerate(self._ids.tolist())
                      if i in keyframe.seen and i not in self._points]
            if not shared:
                continue
            ids = self._ids[shared].tolist()
            views = ((keyframe.T_camera_world, np.array([keyframe.seen[i][:2] for i in ids])),
                     (self._pose, self._px[shared]))
            (T_a, px_a), (T_b, px_b) = views
            points = triangulate(self._camera, T_a, T_b, px_a, px_b)
            good = angles_rad(T_a, T_b, points) > _MIN_ANGLE_RAD
            for T, px in views:
                error = np.linalg.norm(project(self._camera, T, points) - px, axis=1)
                good &= (points @ T[2, :3] + T[2, 3] > 0.0) & (error < _MAX_ERROR_PX)
            self._points.update((i, p) for i, p, g in zip(ids, points, good) if g)

    def _adjust(self) -> None:
        """Adjust the last keyframes and their points; drop observations that do not fit."""
        window = self._keyframes[-_WINDOW:]
        often = {i for i in {i for k in window for i in k.seen} & self._points.keys()
                 if sum(i in k.seen for k in window) > 1}
        if len(often) < _MIN_INLIERS:
            return
        index = {i: n for n, i in enumerate(sorted(often))}
        rows = [(c, i, px) for c, k in enumerate(window) for i, px in k.seen.items() if i in often]
        # The start from two views is still adjusted while the first keyframe is in the window.
        fixed = np.arange(len(window)) < (1 if len(window) == len(self._keyframes) else _FIXED)
        problem = Problem(np.array([k.T_camera_world for k in window]), fixed,
                          np.array([self._points[i] for i in index]),
                          np.array([c for c, _, _ in rows]),
                          np.array([index[i] for _, i, _ in rows]),
                          np.array([px for _, _, px in rows]))
        left = np.abs(problem.solve(self._camera))
        for keyframe, T in zip(window, problem.T_camera_world):
            keyframe.T_camera_world = T
        self._pose = window[-1].T_camera_world
        self._points.update(zip(index, problem.points_m))
        for (c, i, px), error in zip(rows, left):
            if error[:2].max() > _MAX_ERROR_PX:
                self._points.pop(i, None)
                del window[c].seen[i]
            elif error[2] > _MAX_ERROR_PX:
                px[2] = np.nan
        self._drop(np.flatnonzero([i not in window[-1].seen for i in self._ids.tolist()]))


_HUBER_PX = 1.0
_MAX_STEPS = 15
_DONE = 1e-4             # the solver stops when the relative gain of a step is below this
_DAMPING = 1e-4          # of the first step, relative to the diagonal


@dataclasses.dataclass
class Problem:
    """Bundle adjustment: poses, points and observations.

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
