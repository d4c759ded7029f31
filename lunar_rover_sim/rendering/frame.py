"""A stereo frame: the images and the layers of truth."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

LAYERS = ('left', 'right', 'depth', 'normal', 'label', 'radiance')
LABEL_SKY, LABEL_GROUND, LABEL_ROVER, LABEL_DISTURBED, LABEL_FIRST_ROCK = 0, 1, 2, 3, 16


@dataclasses.dataclass(frozen=True)
class StereoFrame:
    """Images and truth of one state; layers that were not asked for are None.

    left, right: (h, w) uint8 or uint16, or (h, w, 3) uint8: the output of the sensors
    depth_m: (h, w) float32 depth along the optical axis of the left camera [m]; sky +inf
    normal: (h, w, 3) float32 unit normals of the ground grid and of rocks, world frame; sky 0
    label: (h, w) int32: 0 sky, 1 ground, 2 rover, 3 ground that the rover has disturbed, 16 +
        index for rocks, the far ones
        (`world.far_rocks`) after those of the world
    radiance: (h, w) float32 ideal image of the left camera [W m-2 sr-1]
    exposure_s: exposure time [s]

    Where the camera has distortion, left and right are distorted; the layers of truth are those
    of the undistorted view.
    """

    left: NDArray[np.generic] | None = None
    right: NDArray[np.generic] | None = None
    depth_m: NDArray[np.float32] | None = None
    normal: NDArray[np.float32] | None = None
    label: NDArray[np.int32] | None = None
    radiance: NDArray[np.float32] | None = None
    exposure_s: float = 0.0
