"""One camera as the shaders know it: a block of uniforms that all programs share."""

from __future__ import annotations

from typing import NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.projection import Projection, ViewVolume

Window = tuple[int, int, int, int]      # x, y, width, height within a framebuffer [px]

# The layout std140 of the block View in shaders/view.glsl.
_BLOCK = np.dtype([(name, kind, size) for name, kind, size in (
    ('clip', 'f4', 16), ('camera', 'f4', 3), ('above', 'f4', ()), ('axis', 'f4', 3),
    ('pixel', 'f4', ()), ('ray', 'f4', 3), ('first_row', 'f4', ()), ('ray_right', 'f4', 4),
    ('ray_down', 'f4', 4), ('texel', 'f4', 2),
    ('centre', 'f4', 2))])


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


class View:
    """The uniform block of one camera.

    Attributes:
        numbers: What it has, for compiled loops.
    """

    numbers: ViewNumbers

    def __init__(self, context: moderngl.Context) -> None:
        self._buffer = context.buffer(reserve=_BLOCK.itemsize, dynamic=True)

    def place(self, T_world_camera: Array, projection: Projection, volume: ViewVolume, *,
              window: Window, size: tuple[int, int]) -> None:
        """Set where the camera is, what it sees, and where its image lies.

        Args:
            volume: Of all cameras that the ground is chosen for.
            window: Place of the image within attachments of this size [px].
        """
        K, camera = projection.K, T_world_camera
        block = np.zeros((), _BLOCK)
        right, down = camera[:3, 0] / K[0, 0], camera[:3, 1] / K[1, 1]
        block['clip'] = projection.clip_matrix(camera).ravel()
        block['camera'], block['above'] = camera[:3, 3], volume.above_m
        block['axis'], block['pixel'] = camera[:3, 2], 1.0 / K[0, 0]
        block['ray'] = camera[:3, 2] - right * K[0, 2] - down * K[1, 2]
        block['ray_right'][:3], block['ray_down'][:3] = right, down
        block['first_row'] = window[1]
        block['texel'] = 1.0 / np.array(size)
        block['centre'] = volume.centre_m[:2] - camera[:2, 3]
        self.numbers = ViewNumbers(
            np.concatenate([block['ray'], block['ray_right'][:3], block['ray_down'][:3],
                            block['camera'], block['axis'], [block['pixel']]]).astype(np.float32),
            camera[:3, 3], volume.centre_m[:2])
        self._buffer.orphan()   # the previous content may still be in use
        self._buffer.write(block.tobytes())

    def bind(self) -> None:
        """Let all programs draw what this camera sees."""
        self._buffer.bind_to_uniform_block(0)

    def release(self) -> None:
        """Release the GL objects."""
        self._buffer.release()
