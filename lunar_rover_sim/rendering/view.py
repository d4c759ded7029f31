"""One camera as the shaders know it: a block of uniforms that all programs share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.terrain import ViewVolume

if TYPE_CHECKING:
    import moderngl

# The layout std140 of the block View in shaders/view.glsl.
_BLOCK = np.dtype([(name, kind, size) for name, kind, size in (
    ('clip', 'f4', 16), ('camera', 'f4', 3), ('above', 'f4', ()), ('axis', 'f4', 3),
    ('pixel', 'f4', ()), ('ray', 'f4', 3), ('first_row', 'f4', ()), ('ray_right', 'f4', 3),
    ('last_row', 'f4', ()), ('ray_down', 'f4', 4), ('texel', 'f4', 2),
    ('middle', 'f4', 2))])


class View:
    """Owns the block of one camera."""

    def __init__(self, context: moderngl.Context) -> None:
        self._buffer = context.buffer(reserve=_BLOCK.itemsize, dynamic=True)

    def place(self, camera: Array, clip: NDArray[np.float32], K: Array, view: ViewVolume, *,
              window: tuple[int, int, int, int], size: tuple[int, int]) -> None:
        """Say where the camera is.

        camera: (4, 4) pose of the optical frame in the world; clip: as of
        `projection.clip_matrix`; K: (3, 3); view: what is drawn; window: the image's
        place in attachments of this size
        """
        block = np.zeros((), _BLOCK)
        right, down = camera[:3, 0] / K[0, 0], camera[:3, 1] / K[1, 1]
        block['clip'] = clip.ravel()
        block['camera'], block['above'] = camera[:3, 3], view.above_m
        block['axis'], block['pixel'] = camera[:3, 2], 1.0 / K[0, 0]
        block['ray'] = camera[:3, 2] - right * K[0, 2] - down * K[1, 2]
        block['ray_right'], block['ray_down'][:3] = right, down
        block['first_row'], block['last_row'] = window[1], window[1] + window[3] - 1
        block['texel'] = 1.0 / np.array(size)
        block['middle'] = view.camera_m[:2] - camera[:2, 3]
        self._buffer.orphan()   # the last content may still be in use
        self._buffer.write(block.tobytes())

    def bind(self) -> None:
        """Make it the camera that is drawn for."""
        self._buffer.bind_to_uniform_block(0)
