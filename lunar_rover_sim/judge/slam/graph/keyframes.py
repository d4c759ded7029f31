"""Keyframes: corners of a stereo pair with their points and descriptors."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.slam.euroc_reader import Camera, Image
from lunar_rover_sim.judge.slam.reference.features import detect, disparities
from lunar_rover_sim.judge.slam.reference.geometry import from_disparity

_CORNERS = 350
_MIN_DISPARITY_PX = 1.5
_COARSE_PX = 320            # width of the image for the first disparities
# A descriptor covers this width on the ground, so that a place looks the same from near and far.
_PATCH_M = 0.12
_PATCH_PX = 6.0             # width of the patch of SIFT over the size of its keypoint
_SIZES_PX = 2.0, 24.0       # of a keypoint
_SIZE_OF_OCTAVE_PX = 4.0    # of a keypoint of the first octave


@dataclasses.dataclass(frozen=True)
class Keyframe:
    """Corners of one pair.

    Attributes:
        left: The left image.
        px: (n, 3) u, v and right u.
        points_m: (n, 3) in the left camera.
        descriptors: (n, 128) SIFT.
    """

    left: Image
    px: Array
    points_m: Array
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.px)


def keyframe(camera: Camera, left: Image, right: Image) -> Keyframe:
    """Return the corners of a rectified pair that have a disparity."""
    px = detect(left, np.zeros((0, 2)), _CORNERS)
    shrink = max(1, left.shape[1] // _COARSE_PX)
    found = disparities(left, right, px, shrink) if len(px) else np.zeros(0)
    good = found > _MIN_DISPARITY_PX
    px, disparity = px[good], found[good]
    points = from_disparity(camera, px, disparity)
    return Keyframe(left, np.column_stack([px, px[:, 0] - disparity]), points,
                    _descriptors(camera, left, px, points[:, 2]))


def _descriptors(camera: Camera, image: Image, px: Array, depth_m: Array) -> NDArray[np.uint8]:
    """Return SIFT descriptors (Lowe, 2004), upright, of patches of one size on the ground."""
    if not len(px):
        return np.zeros((0, 128), np.uint8)
    size = np.clip(camera.focal_px[0] * _PATCH_M / (_PATCH_PX * depth_m), *_SIZES_PX)
    octave = np.maximum(np.rint(np.log2(size / _SIZE_OF_OCTAVE_PX)), 0).astype(int)
    # The index of the keypoint, since OpenCV may drop some and change their order.
    points = [cv2.KeyPoint(float(u), float(v), float(s), 0.0, 0.0, int(o) | (1 << 8), k)
              for k, ((u, v), s, o) in enumerate(zip(px, size, octave))]
    kept, found = cv2.SIFT.create().compute(image, points)
    descriptors = np.zeros((len(px), 128), np.uint8)
    if found is not None:
        descriptors[[point.class_id for point in kept]] = np.asarray(found).astype(np.uint8)
    return descriptors
