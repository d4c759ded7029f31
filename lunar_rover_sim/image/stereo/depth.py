"""Disparity maps, and depth from disparity: Z = f B / d."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.errors import ConfigError


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
