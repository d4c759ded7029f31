"""Disparity maps, depth from disparity, Z = f B / d, and points from depth."""

from __future__ import annotations

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array


@dataclasses.dataclass(frozen=True)
class DisparityMap:
    """A disparity image and what a reader must know of it, as in stereo_msgs/DisparityImage.

    Attributes:
        disparity_px: (h, w) float32, left column minus right column of a point; invalid pixels are
            min_disparity_px - 1, as in ROS's stereo_image_proc.
        min_disparity_px: Least disparity of the search range.
        max_disparity_px: Greatest disparity of the search range.
        delta_d_px: The smallest step of disparity.
        valid_window: Column, row, width, height of the part in which matches are possible.
        focal_px: Focal length of the rectified pair; None if it is not known.
        baseline_m: Baseline of the rectified pair; None if it is not known.
    """

    disparity_px: NDArray[np.float32]
    min_disparity_px: float
    max_disparity_px: float
    delta_d_px: float
    valid_window: tuple[int, int, int, int]
    focal_px: float | None = None
    baseline_m: float | None = None

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(h, w) whether the pixel has a disparity; 0 is a point at infinity."""
        return self.disparity_px >= self.min_disparity_px

    @property
    def has_finite_depth(self) -> NDArray[np.bool_]:
        """(h, w) whether the pixel has a disparity above 0."""
        return self.valid & (self.disparity_px > 0.0)

    @property
    def depth_m(self) -> NDArray[np.float32]:
        """(h, w) float32 depth, see `depth_from_disparity`; ConfigError without focal length."""
        if self.focal_px is None or self.baseline_m is None:
            raise ConfigError('depth_m: focal length and baseline of the pair are not known; give '
                              'the matcher a rig')
        return depth_from_disparity(self, self.focal_px, self.baseline_m)


def depth_from_disparity(disparity: DisparityMap, focal_px: float,
                         baseline_m: float) -> NDArray[np.float32]:
    """Return (h, w) float32 depth along the optical axis [m].

    Unmatched pixels are NaN and a disparity of zero is +inf (REP 118).
    """
    d = disparity.disparity_px
    depth = np.full(d.shape, np.nan, np.float32)
    with np.errstate(divide='ignore'):
        np.divide(np.float32(focal_px * baseline_m), d, out=depth,
                  where=disparity.valid & (d >= 0))
    return depth


def disparity_from_depth(depth_m: ArrayLike, focal_px: float,
                         baseline_m: float) -> NDArray[np.float32]:
    """Return the true disparity of depth [m], float32 [px]; that of the sky (+inf) is 0.

    NaN stays NaN.
    """
    depth = np.asarray(depth_m, dtype=np.float32)
    with np.errstate(divide='ignore', over='ignore'):
        return np.float32(focal_px * baseline_m) / depth


def points_from_depth(depth_m: NDArray[np.float32], K: Array) -> NDArray[np.float32]:
    """Return the (h, w, 3) float32 points of an image [m], optical frame: x right, y down.

    Pixels without a finite depth are NaN in all three coordinates.

    Args:
        depth_m: (h, w) along the optical axis.
        K: (3, 3) intrinsics of the rectified image [px].
    """
    depth = np.where(np.isfinite(depth_m), depth_m, np.float32(np.nan))
    height, width = depth.shape
    u = ((np.arange(width) - K[0, 2]) / K[0, 0]).astype(np.float32)
    v = ((np.arange(height) - K[1, 2]) / K[1, 1]).astype(np.float32)
    points = np.empty((height, width, 3), np.float32)
    points[..., 0] = depth * u
    points[..., 1] = depth * v[:, None]
    points[..., 2] = depth
    return points


def grey(image: NDArray[Any]) -> NDArray[Any]:
    """Return the (h, w) brightness of a grey image, or of a colour image (red, green, blue)."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
