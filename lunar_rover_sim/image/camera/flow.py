"""Optical flow and scene flow of rigid bodies, from depth and from how the bodies have moved.

Both lead from an image to another one of the same camera: pixel p shows the point X [m] in optical
axes then, and the other image shows that point at p + flow, where it is X + scene flow in its own
optical axes. For a body that moves by M = T_other_body T_body_camera these are M X - X and its
projection (Menze and Geiger, Object scene flow for autonomous vehicles, CVPR 2015).
"""

from __future__ import annotations

from collections.abc import Iterable
import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array, inverse

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class Moved:
    """A rigid body in an image, and where it was or will be when the other image was taken.

    Attributes:
        mask: (h, w) where it is seen.
        T_world_body, T_world_body_other: (4, 4).
    """

    mask: Mask
    T_world_body: Array
    T_world_body_other: Array


class FlowModel:
    """Flow between two images of a pinhole camera.

    K: (3, 3) intrinsics [px]; depth_m: (h, w) depth along the optical axis, +inf for the sky
    T_world_camera, T_world_camera_other: (4, 4) poses of the optical frame
    bodies: those that move in the world; all else stands still
    """

    def __init__(self, K: Array, depth_m: F32, T_world_camera: Array,
                 T_world_camera_other: Array, bodies: Iterable[Moved] = ()) -> None:
        self._K, self._depth = K, np.asarray(depth_m, np.float32)
        height, width = self._depth.shape
        self._u = np.arange(width, dtype=np.float32)[None]
        self._v = np.arange(height, dtype=np.float32)[:, None]
        T_other_world = inverse(T_world_camera_other)
        self._motion = T_other_world @ T_world_camera
        self._bodies = [(np.nonzero(body.mask), T_other_world @ body.T_world_body_other
                         @ inverse(body.T_world_body) @ T_world_camera) for body in bodies]

    def optical_flow(self) -> F32:
        """Return (h, w, 2) how far right and down each pixel's point is in the other image [px].

        The sky moves as what is infinitely far. NaN where the point is behind the camera then.
        """
        with np.errstate(divide='ignore', invalid='ignore'):
            near = np.float32(1.0) / self._depth
        flow = cv2.merge(self._project(self._motion, near, self._u, self._v))
        for (rows, columns), motion in self._bodies:
            flow[rows, columns] = np.stack(self._project(
                motion, near[rows, columns], self._u[0, columns], self._v[rows, 0]), axis=-1)
        return np.asarray(flow, np.float32)

    def scene_flow(self) -> F32:
        """Return (h, w, 3) how far each pixel's point is from where it was [m].

        x right, y down, z forward: coordinates in the other camera less those in this one. NaN
        for the sky.
        """
        depth = np.where(self._depth < np.inf, self._depth, np.float32(np.nan))
        flow = cv2.merge(self._shift(self._motion, depth, self._u, self._v))
        for (rows, columns), motion in self._bodies:
            flow[rows, columns] = np.stack(self._shift(
                motion, depth[rows, columns], self._u[0, columns], self._v[rows, 0]), axis=-1)
        return np.asarray(flow, np.float32)

    def _project(self, motion: Array, near: F32, u: F32, v: F32) -> list[F32]:
        """Return the flow of points with inverse depths `near` at pixels u, v."""
        # Homogeneous pixel of the moved point, over its depth: H p + near h.
        H, h = self._K @ motion[:3, :3] @ np.linalg.inv(self._K), self._K @ motion[:3, 3]
        scale = near * np.float32(h[2])
        scale += _linear(H[2], u, v)
        with np.errstate(divide='ignore'):
            np.divide(np.float32(1.0), scale, out=scale)
        if scale.size and scale.min() <= 0.0:
            scale[scale <= 0.0] = np.nan
        flows = []
        for row, start in ((0, u), (1, v)):
            flow = near * np.float32(h[row])
            flow += _linear(H[row], u, v)
            flow *= scale
            flow -= start
            flows.append(flow)
        return flows

    def _shift(self, motion: Array, depth: F32, u: F32, v: F32) -> list[F32]:
        """Return how far points move."""
        turn = (motion[:3, :3] - np.eye(3)) @ np.linalg.inv(self._K)
        shifts = []
        for row, start in zip(turn, motion[:3, 3]):
            shift = _linear(row, u, v)
            shift *= depth
            shift += np.float32(start)
            shifts.append(shift)
        return shifts


def _linear(row: Array, u: F32, v: F32) -> F32:
    """Return row . (u, v, 1)."""
    a, b, c = map(float, row)
    return np.asarray(u * np.float32(a) + (v * np.float32(b) + np.float32(c)))
