"""Disparity and depth: Z = f B / d."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.stereo.sgm import DisparityMap


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
    """Return the true disparity [px] of depth [m]; sky (+inf) is 0, NaN stays NaN."""
    depth = np.asarray(depth_m, dtype=np.float32)
    with np.errstate(divide='ignore'):
        return np.float32(focal_px * baseline_m) / depth
