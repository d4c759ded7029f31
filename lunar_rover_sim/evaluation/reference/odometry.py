"""Visual odometry: corners are tracked, frames located, keyframes adjusted in a window.

A stereo pair gives the depth of new points at once. A single camera starts once the essential
matrix of two frames leaves enough parallax; the median depth of the first points is its unit.
"""

from __future__ import annotations

from collections.abc import Iterable
import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lunar_rover_sim.errors import EvaluationError
from lunar_rover_sim.evaluation.reference.bundle import Problem, residuals
from lunar_rover_sim.evaluation.reference.features import detect, StereoMatcher, track
from lunar_rover_sim.evaluation.reference.geometry import (
    angles_rad, from_disparity, locate, project, triangulate, two_views)
from lunar_rover_sim.evaluation.estimator_input import Camera, Frame, Image
from lunar_rover_sim.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.frames import Array, inverse

_CORNERS = 400
_WINDOW = 8              # keyframes that are adjusted together
_FIXED = 2               # of those, the oldest, that stay
_KEYFRAME_FLOW_PX = 25.0
_KEYFRAME_FRAMES = 8
_MIN_KNOWN = 120         # tracks with a point, below which a keyframe is due
_MIN_INLIERS = 15
_GIVE_UP_FRAMES = 10
_MIN_ANGLE_RAD = np.radians(1.0)
_MAX_ERROR_PX = 2.5
_MIN_DISPARITY_PX = 1.5


@dataclasses.dataclass
class _Keyframe:
    T_camera_world: Array
    seen: dict[int, Array]   # (3,) u, v and right u or NaN, by track


class Odometry:
    """Tracks one sequence; `add` the frames, then take the `trajectory`."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._matcher = StereoMatcher()
        self._before: Image | None = None
        self._ids: Array = np.zeros(0, np.int64)
        self._px: Array = np.zeros((0, 2))
        self._next = 0
        self._points: dict[int, Array] = {}
        self._keyframes: list[_Keyframe] = []
        self._motion: Array = np.eye(4)        # camera now from camera before
        self._pose: Array = np.eye(4)
        self._since = 0
        self._missed = 0
        self._located: list[tuple[int, int, Array]] = []   # stamp, keyframe, pose in it
        self.lost_ns: int | None = None

    def add(self, frame: Frame) -> bool:
        """Take a frame; return whether it was located."""
        if self.lost_ns is not None:
            return False
        if self._before is not None:
            self._follow(frame.left)
        self._before = frame.left
        if not self._points:
            return self._start(frame)
        known = np.array([i in self._points for i in self._ids], bool)
        pose = None
        if known.sum() >= _MIN_INLIERS:
            points = np.array([self._points[i] for i in self._ids[known]])
            pose, good = locate(self._camera, points, self._px[known], _MIN_INLIERS)
        if pose is None:
            self._missed += 1
            if self._missed >= _GIVE_UP_FRAMES:
                self.lost_ns = frame.stamp_ns
            return False
        self._motion = pose @ inverse(self._pose) if not self._missed else np.eye(4)
        self._pose, self._missed = pose, 0
        keep = np.ones(len(self._ids), bool)
        keep[np.flatnonzero(known)[~good]] = False
        self._keep(keep)
        self._since += 1
        if self._due(int(good.sum())):
            self._make_keyframe(frame)
        self._note(frame.stamp_ns)
        return True

    def trajectory(self) -> Trajectory:
        """Return T_first_camera of all located frames, after all adjustments."""
        if not self._located:
            raise EvaluationError('nothing was tracked')
        poses = np.array([inverse(T @ self._keyframes[k].T_camera_world)
                          for _, k, T in self._located])
        return Trajectory(np.array([ns for ns, _, _ in self._located], np.int64), poses[:, :3, 3],
                          wxyz(Rotation.from_matrix(poses[:, :3, :3])), 'reference')

    def _note(self, stamp_ns: int) -> None:
        last = len(self._keyframes) - 1
        T = self._pose @ inverse(self._keyframes[last].T_camera_world)
        self._located.append((stamp_ns, last, T))

    def _keep(self, keep: NDArray[np.bool_]) -> None:
        self._ids, self._px = self._ids[keep], self._px[keep]

    def _follow(self, image: Image) -> None:
        """Track into the next image, starting where the last motion leads."""
        guess = self._px.copy()
        known = np.array([i in self._points for i in self._ids], bool)
        if known.any():
            points = np.array([self._points[i] for i in self._ids[known]])
            guess[known] += (project(self._camera, self._motion @ self._pose, points)
                             - project(self._camera, self._pose, points))
        assert self._before is not None
        there, found = track(self._before, image, self._px, guess)
        self._px = there
        self._keep(found)

    def _start(self, frame: Frame) -> bool:
        if self._camera.baseline_m:
            self._make_keyframe(frame)
            if len(self._points) < 2 * _MIN_INLIERS:
                self._points.clear()
                self._keyframes.clear()
                self._since = 0
                return False
            self._note(frame.stamp_ns)
            return True
        return self._start_mono(frame)

    def _start_mono(self, frame: Frame) -> bool:
        first = self._keyframes[0].seen if self._keyframes else {}
        both = np.array([i in first for i in self._ids], bool)
        if both.sum() < 4 * _MIN_INLIERS:
            self._keyframes = []
            self._refill(frame.left)
            self._keyframes.append(_Keyframe(np.eye(4), self._observations(None)))
            return False
        ids, px = self._ids[both], self._px[both]
        old = np.array([first[i][:2] for i in ids])
        views = two_views(self._camera, old, px)
        if views is None:
            return False
        T, points, good = views
        self._pose, self._motion = T, np.eye(4)
        self._points = dict(zip(ids[good].tolist(), points[good]))
        keep = np.ones(len(self._ids), bool)
        keep[np.flatnonzero(both)[~good]] = False
        self._keep(keep)
        self._make_keyframe(frame)
        self._located.append((frame.stamp_ns, 1,
                              self._pose @ inverse(self._keyframes[1].T_camera_world)))
        return True

    def _due(self, inliers: int) -> bool:
        seen = self._keyframes[-1].seen
        moved = [np.linalg.norm(p - seen[i][:2]) for i, p in zip(self._ids, self._px) if i in seen]
        return (inliers < _MIN_KNOWN or self._since >= _KEYFRAME_FRAMES or not moved
                or float(np.median(moved)) > _KEYFRAME_FLOW_PX)

    def _refill(self, image: Image) -> None:
        new = detect(image, self._px, _CORNERS - len(self._px))
        self._ids = np.concatenate([self._ids, self._next + np.arange(len(new))]).astype(np.int64)
        self._px = np.concatenate([self._px, new])
        self._next += len(new)

    def _observations(self, disparity: Array | None) -> dict[int, Array]:
        right = (np.full(len(self._px), np.nan) if disparity is None
                 else self._px[:, 0] - disparity)
        return dict(zip(self._ids.tolist(), np.column_stack([self._px, right])))

    def _make_keyframe(self, frame: Frame) -> None:
        self._since = 0
        self._refill(frame.left)
        disparity = None
        if frame.right is not None and self._camera.baseline_m:
            disparity = self._matcher.match(frame.left, frame.right, self._px)
        self._keyframes.append(_Keyframe(self._pose, self._observations(disparity)))
        self._new_points()
        if len(self._keyframes) > 1:
            self._adjust()
            self._new_points()

    def _new_points(self) -> None:
        """Give a point to every track that has none and whose depth can be told."""
        if self._camera.baseline_m:
            T_world_camera = inverse(self._pose)
            seen = self._keyframes[-1].seen
            new = [i for i in self._ids.tolist() if i not in self._points
                   and seen[i][0] - seen[i][2] > _MIN_DISPARITY_PX]
            px = np.array([seen[i] for i in new]).reshape(-1, 3)
            local = from_disparity(self._camera, px[:, :2], px[:, 0] - px[:, 2])
            world = local @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
            self._points.update(zip(new, world))
            return
        for keyframe in self._keyframes[-_WINDOW:-1]:
            shared = [k for k, i in enumerate(self._ids.tolist())
                      if i in keyframe.seen and i not in self._points]
            if not shared:
                continue
            old = np.array([keyframe.seen[int(self._ids[k])][:2] for k in shared])
            points = triangulate(self._camera, keyframe.T_camera_world, self._pose, old,
                                 self._px[shared])
            wide = angles_rad(keyframe.T_camera_world, self._pose, points) > _MIN_ANGLE_RAD
            fits = np.ones(len(points), bool)
            for T, px in ((keyframe.T_camera_world, old), (self._pose, self._px[shared])):
                depth = points @ T[2, :3] + T[2, 3]
                error = np.linalg.norm(project(self._camera, T, points) - px, axis=1)
                fits &= (depth > 0.0) & (error < _MAX_ERROR_PX)
            for k, point, good in zip(shared, points, wide & fits):
                if good:
                    self._points[int(self._ids[k])] = point

    def _adjust(self) -> None:
        """Adjust the last keyframes and what they see; drop what does not fit."""
        window = self._keyframes[-_WINDOW:]
        ids = [i for i in {i for k in window for i in k.seen} if i in self._points
               and sum(i in k.seen for k in window) > 1]
        if len(ids) < _MIN_INLIERS:
            return
        index = {i: n for n, i in enumerate(ids)}
        rows = [(c, index[i], px) for c, k in enumerate(window) for i, px in k.seen.items()
                if i in index]
        # What two views began with is mended as long as the first is in the window.
        fixed = np.arange(len(window)) < (1 if len(window) == len(self._keyframes) else _FIXED)
        problem = Problem(np.array([k.T_camera_world for k in window]), fixed,
                          np.array([self._points[i] for i in ids]),
                          np.array([r[0] for r in rows]), np.array([r[1] for r in rows]),
                          np.array([r[2] for r in rows]))
        problem.solve(self._camera)
        for keyframe, T in zip(window, problem.T_camera_world):
            keyframe.T_camera_world = T
        self._pose = window[-1].T_camera_world
        for i, point in zip(ids, problem.points_m):
            self._points[i] = point
        left = np.abs(residuals(self._camera, problem.T_camera_world[problem.camera_of],
                                problem.points_m[problem.point_of], problem.seen_px))
        for (c, n, px), error in zip(rows, left):
            if error[:2].max() > _MAX_ERROR_PX:
                self._points.pop(ids[n], None)
                del window[c].seen[ids[n]]
            elif error[2] > _MAX_ERROR_PX:
                px[2] = np.nan
        keep = np.array([i in window[-1].seen for i in self._ids.tolist()], bool)
        self._keep(keep)


def run(camera: Camera, frames: Iterable[Frame]) -> Trajectory:
    """Track all frames of a sequence; raise EvaluationError where none could be located."""
    odometry = Odometry(camera)
    for frame in frames:
        odometry.add(frame)
    return odometry.trajectory()
