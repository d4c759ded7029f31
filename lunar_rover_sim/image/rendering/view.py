"""One camera as the shaders know it: a block of uniforms that all programs share."""

from __future__ import annotations

from typing import NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.rendering.projection import Projection

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
