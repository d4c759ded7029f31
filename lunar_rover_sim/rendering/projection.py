"""From a camera's pose and intrinsics to clip space, view volume and image rows.

Cameras are (4, 4) poses of optical frames in the world; K is (3, 3), pixel centres at whole
numbers, for an image of w columns and h rows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array, inverse
from lunar_rover_sim.rendering.terrain import ViewVolume


def clip_matrix(camera: Array, K: Array, w: int, h: int, near: float,
                far: float) -> NDArray[np.float32]:
    """Return the matrix from camera-relative world axes to clip space, column-major.

    Window rows count downwards, as image rows do, so that nothing has to be flipped.
    """
    projection = np.zeros((4, 4))
    projection[0, 0], projection[0, 2] = 2 * K[0, 0] / w, 2 * (K[0, 2] + 0.5) / w - 1
    projection[1, 1], projection[1, 2] = 2 * K[1, 1] / h, 2 * (K[1, 2] + 0.5) / h - 1
    projection[2, 2] = (far + near) / (far - near)
    projection[2, 3] = -2 * far * near / (far - near)
    projection[3, 2] = 1.0
    rotation = np.eye(4)
    rotation[:3, :3] = inverse(camera)[:3, :3]
    return np.ascontiguousarray((projection @ rotation).T, dtype=np.float32)


def view_volume(cameras: list[Array], K: Array, w: int, h: int, ground_m: float) -> ViewVolume:
    """Return the view volume that holds those of all cameras of one kind."""
    camera = cameras[0]
    middle = np.mean([c[:3, 3] for c in cameras], axis=0)
    apart = max(float(np.linalg.norm(c[:3, 3] - middle)) for c in cameras)
    right, down, forward = camera[:3, 0], camera[:3, 1], camera[:3, 2]
    normals = []
    for axis, focal, centre, size in ((right, K[0, 0], K[0, 2], w),
                                      (down, K[1, 1], K[1, 2], h)):
        normals.append(axis + forward * ((centre + 0.5) / focal))
        normals.append(-axis + forward * ((size - centre - 0.5) / focal))
    normals.append(forward)
    planes = np.array([[*(n / np.linalg.norm(n)), apart + 0.01] for n in normals])
    return ViewVolume(middle, planes, max(float(middle[2]) - ground_m, 0.0))


def covered_rows(boxes: Array, camera: Array, K: Array, height: int,
                 near_m: float) -> tuple[int, int]:
    """Return the first row and the one after the last that (m, 2, 3) boxes may cover."""
    corners = np.stack([boxes[:, i, axis] for axis in range(3) for i in (0, 1)], axis=1)
    x, y, z = corners[:, :2], corners[:, 2:4], corners[:, 4:]
    offset = camera[:3, 3]
    points = np.stack(np.broadcast_arrays((x - offset[0])[:, :, None, None],
                                          (y - offset[1])[:, None, :, None],
                                          (z - offset[2])[:, None, None, :]), axis=-1)
    optical = points.reshape(-1, 3) @ camera[:3, 1:3]
    if np.any(optical[:, 1] < near_m):
        ahead = optical[:, 1] > near_m
        rows = K[1, 1] * optical[ahead, 0] / optical[ahead, 1] + K[1, 2]
        return int(np.clip(np.min(rows, initial=height) - 1, 0,
                           height - 1)), height
    rows = K[1, 1] * optical[:, 0] / optical[:, 1] + K[1, 2]
    first = int(np.clip(np.floor(rows.min()) - 1, 0, height - 1))
    return first, int(np.clip(np.ceil(rows.max()) + 2, first + 1, height))
