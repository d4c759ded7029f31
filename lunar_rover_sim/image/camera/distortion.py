"""Brown-Conrady distortion (Brown, 1971), as OpenCV and ROS's `plumb_bob` define it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.frames import Array

_TURNS = 30


def distort(xy: ArrayLike, distortion: ArrayLike) -> Array:
    """Return distorted (..., 2) normalised coordinates; distortion: k1, k2, p1, p2, k3."""
    x, y = np.moveaxis(np.asarray(xy, dtype=float), -1, 0)
    k1, k2, p1, p2, k3 = np.asarray(distortion, dtype=float)
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack([x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                     y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y], axis=-1)


def undistort(xy: ArrayLike, distortion: ArrayLike) -> Array:
    """Return the (..., 2) normalised coordinates that `distort` maps to `xy`.

    Fixed-point iteration from the outside in; NaN where it does not converge to 1e-9.
    """
    target = np.asarray(xy, dtype=float)
    shape, target = target.shape, target.reshape(-1, 2)
    point = target.copy()
    moving = np.arange(len(point))      # the others have arrived: another step changes nothing
    with np.errstate(all='ignore'):
        for _ in range(_TURNS):
            # One Newton step with the Jacobian by differences.
            here = point[moving]
            value = distort(here, distortion)
            h = 1e-6
            dx = (distort(here + [h, 0.0], distortion) - value) / h
            dy = (distort(here + [0.0, h], distortion) - value) / h
            determinant = dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0]
            rest = target[moving] - value
            point[moving] = here + np.stack(
                [(rest[:, 0] * dy[:, 1] - rest[:, 1] * dy[:, 0]) / determinant,
                 (dx[:, 0] * rest[:, 1] - dx[:, 1] * rest[:, 0]) / determinant], axis=-1)
            moving = moving[np.any(point[moving] != here, axis=-1)]
        wrong = ~(np.abs(distort(point, distortion) - target).max(axis=-1) < 1e-9)
    point[wrong] = np.nan
    return point.reshape(shape)


def is_invertible(distortion: ArrayLike, half_width: float, half_height: float) -> bool:
    """Return whether the distortion maps one to one over an image.

    Args:
        half_width, half_height: Distance from the centre to the edges, normalised coordinates.
    """
    u, v = np.meshgrid(np.linspace(-half_width, half_width, 41),
                       np.linspace(-half_height, half_height, 31))
    ideal = undistort(np.stack([u, v], axis=-1), distortion)
    if not np.all(np.isfinite(ideal)):
        return False
    # Between the centre and the farthest ideal point the radius must grow all the way.
    h = 1e-5
    farthest = float(np.linalg.norm(ideal, axis=-1).max())
    for angle in np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False):
        ray = np.linspace(0.0, farthest, 200)[:, None] * [math.cos(angle), math.sin(angle)]
        value = distort(ray, distortion)
        dx = (distort(ray + [h, 0.0], distortion) - value) / h
        dy = (distort(ray + [0.0, h], distortion) - value) / h
        if np.any(dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0] <= 0.05):
            return False
    return True
