"""Points of a cloud from a depth image, and their brightness."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array


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
