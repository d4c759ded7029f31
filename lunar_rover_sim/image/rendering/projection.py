"""From a camera's pose and intrinsics to clip space, view volume, and what shaders and loops take.

A camera's pose is `T_world_camera` (4, 4), that of its optical frame in the world.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.ground.world.model import World

_MARGIN_M = 0.01        # of view volumes, beyond the cameras' own positions


@dataclasses.dataclass(frozen=True)
class ViewVolume:
    """The part of the world that one camera or a stereo pair may see.

    Attributes:
        centre_m: (3,) mean camera position, world frame [m].
        planes: (p, 4) half-spaces relative to the centre: a . x + d >= 0 for visible x [m].
        above_m: Height of the centre above the ground [m].
    """

    centre_m: Array
    planes: Array
    above_m: float

    def sees(self, boxes: Array) -> NDArray[np.bool_]:
        """Return (m,) whether (m, 2, 3) boxes, least and greatest coordinates [m], may be seen."""
        middle = 0.5 * (boxes[:, 0] + boxes[:, 1]) - self.centre_m
        half = 0.5 * (boxes[:, 1] - boxes[:, 0])
        normals, offsets = self.planes[:, :3].T, self.planes[:, 3]
        seen: NDArray[np.bool_] = np.all(
            middle @ normals + half @ np.abs(normals) >= -offsets, axis=1)
        return seen


@dataclasses.dataclass(frozen=True)
class Projection:
    """A pinhole camera and its range of depth.

    Attributes:
        K: (3, 3) intrinsics [px], pixel centres at whole numbers.
        width, height: Image size [px].
        near_m, far_m: Least and greatest depth that is drawn [m].
    """

    K: Array
    width: int
    height: int
    near_m: float
    far_m: float

    @property
    def focal_px(self) -> float:
        """Focal length [px]."""
        return float(self.K[0, 0])

    def finer(self, times: int) -> Projection:
        """Return this camera with `times` pixels along each side of its own pixels."""
        K = self.K.copy()
        K[:2] *= times
        K[:2, 2] += 0.5 * (times - 1)
        return dataclasses.replace(self, K=K, width=times * self.width,
                                   height=times * self.height)

    def clip_matrix(self, T_world_camera: Array) -> NDArray[np.float32]:
        """Return the (4, 4) matrix from camera-relative world axes to clip space, transposed.

        Window rows count downwards, as image rows do, so that no image has to be flipped.
        """
        K, w, h, near, far = self.K, self.width, self.height, self.near_m, self.far_m
        projection = np.zeros((4, 4))
        projection[0, 0], projection[0, 2] = 2 * K[0, 0] / w, 2 * (K[0, 2] + 0.5) / w - 1
        projection[1, 1], projection[1, 2] = 2 * K[1, 1] / h, 2 * (K[1, 2] + 0.5) / h - 1
        projection[2, 2] = (far + near) / (far - near)
        projection[2, 3] = -2 * far * near / (far - near)
        projection[3, 2] = 1.0
        rotation = np.eye(4)
        rotation[:3, :3] = inverse(T_world_camera)[:3, :3]
        return np.ascontiguousarray((projection @ rotation).T, dtype=np.float32)

    def view_volume(self, T_world_cameras: list[Array], world: World) -> ViewVolume:
        """Return the volume that holds those of all cameras, which look in one direction."""
        centre = np.mean([T[:3, 3] for T in T_world_cameras], axis=0)
        ground_m = float(np.nan_to_num(world.height_at(centre[:2]), nan=centre[2]))
        return ViewVolume(centre, self.planes(T_world_cameras),
                          max(float(centre[2]) - ground_m, 0.0))

    def planes(self, T_world_cameras: list[Array]) -> Array:
        """Return the (p, 4) planes of a view volume of cameras that look in one direction."""
        K, w, h = self.K, self.width, self.height
        camera = T_world_cameras[0]
        centre = np.mean([T[:3, 3] for T in T_world_cameras], axis=0)
        apart = max(float(np.linalg.norm(T[:3, 3] - centre)) for T in T_world_cameras)
        right, down, forward = camera[:3, 0], camera[:3, 1], camera[:3, 2]
        normals = []
        for axis, focal, middle, size in ((right, K[0, 0], K[0, 2], w),
                                          (down, K[1, 1], K[1, 2], h)):
            normals.append(axis + forward * ((middle + 0.5) / focal))
            normals.append(-axis + forward * ((size - middle - 0.5) / focal))
        normals.append(forward)
        return np.array([[*(n / np.linalg.norm(n)), apart + _MARGIN_M] for n in normals])


Window = tuple[int, int, int, int]      # x, y, width, height within a framebuffer [px]

# The layout std140 of the block View in shaders/view.glsl.
_BLOCK = np.dtype([('clip', 'f4', 16), ('camera', 'f4', 3), ('pixel', 'f4'), ('axis', 'f4', 4)])


class ViewNumbers(NamedTuple):
    """The same for compiled loops.

    Attributes:
        numbers: (16,) float32: the ray through pixel (0, 0) to depth 1, its steps per column and
            per row, world position [m], optical axis, size of a pixel at depth 1.
        camera: (3,) world position [m].
        middle: (2,) that of the middle of all cameras [m].
    """

    numbers: NDArray[np.float32]
    camera: Array
    middle: Array

    @property
    def pixel(self) -> float:
        """Size of a pixel at depth 1."""
        return float(self.numbers[15])


def view_numbers(T_world_camera: Array, projection: Projection, middle: Array) -> ViewNumbers:
    """Return the numbers of a camera; middle: (2,) or more, that of all cameras [m]."""
    K, camera = projection.K, T_world_camera
    right, down = camera[:3, 0] / K[0, 0], camera[:3, 1] / K[1, 1]
    ray = camera[:3, 2] - right * K[0, 2] - down * K[1, 2]
    return ViewNumbers(np.concatenate([ray, right, down, camera[:3, 3], camera[:3, 2],
                                       [1.0 / K[0, 0]]]).astype(np.float32),
                       camera[:3, 3], middle[:2])


class View:
    """The uniform block of one camera.

    Attributes:
        numbers: What it has, for compiled loops.
    """

    numbers: ViewNumbers

    def __init__(self, context: moderngl.Context) -> None:
        self._buffer = context.buffer(reserve=_BLOCK.itemsize, dynamic=True)

    def place(self, T_world_camera: Array, projection: Projection, middle: Array) -> None:
        """Set where the camera is and what it sees.

        Args:
            middle: (2,) or more, place of the middle of all cameras [m].
        """
        self.numbers = view_numbers(T_world_camera, projection, middle)
        block = np.zeros((), _BLOCK)
        block['clip'] = projection.clip_matrix(T_world_camera).ravel()
        block['camera'], block['pixel'] = T_world_camera[:3, 3], self.numbers.pixel
        block['axis'][:3] = T_world_camera[:3, 2]
        self._buffer.orphan()   # the previous content may still be in use
        self._buffer.write(block.tobytes())

    def bind(self) -> None:
        """Let all programs draw what this camera sees."""
        self._buffer.bind_to_uniform_block(0)

    def release(self) -> None:
        """Release the GL objects."""
        self._buffer.release()
