"""What one drawing gives: images and the layers of truth."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

LAYERS = ('left', 'right', 'depth', 'normal', 'label', 'radiance')
LABEL_SKY, LABEL_GROUND, LABEL_ROVER, LABEL_FIRST_ROCK = 0, 1, 2, 16


@dataclasses.dataclass(frozen=True)
class StereoFrame:
    """What was drawn; layers that were not asked for are None.

    left, right: (h, w) uint8 or uint16, or (h, w, 3) uint8: what the sensors put out
    depth_m: (h, w) float32 depth along the optical axis of the left camera, +inf for the sky
    normal: (h, w, 3) float32 unit normals of the ground grid and of rocks, world frame; sky 0
    label: (h, w) int32: 0 sky, 1 ground, 2 rover, 16 + index for rocks
    radiance: (h, w) float32 ideal image of the left camera [W m-2 sr-1]
    exposure_s: exposure time

    Where the camera is distorted, left and right are; the layers of truth are those of the
    undistorted view.
    """

    left: NDArray[np.generic] | None = None
    right: NDArray[np.generic] | None = None
    depth_m: NDArray[np.float32] | None = None
    normal: NDArray[np.float32] | None = None
    label: NDArray[np.int32] | None = None
    radiance: NDArray[np.float32] | None = None
    exposure_s: float = 0.0


def read_image(target: Any, attachment: int, eye: int, size: tuple[int, int],
               padding: tuple[int, int], components: int = 1) -> NDArray[np.float32]:
    """Read one eye's float attachment within the image: (h, w) or (h, w, components).

    target: framebuffer of the left image above the right; size: rows and columns drawn of each,
    `padding` columns and rows beyond the edges of the image included
    """
    h, w = size
    data = target.read(viewport=(0, eye * h, w, h), components=components,
                       attachment=attachment, alignment=1, dtype='f4')
    shape = (h, w) if components == 1 else (h, w, components)
    x, y = padding
    return np.frombuffer(data, np.float32).reshape(shape)[y:h - y, x:w - x]
