"""Brown-Conrady distortion (Brown, 1971), as OpenCV and ROS's `plumb_bob` define it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.frames import Array

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
    point = target.copy()
    with np.errstate(all='ignore'):
        for _ in range(_TURNS):
            # One Newton step with the Jacobian by differences.
            value = distort(point, distortion)
            h = 1e-6
            dx = (distort(point + [h, 0.0], distortion) - value) / h
            dy = (distort(point + [0.0, h], distortion) - value) / h
            determinant = dx[..., 0] * dy[..., 1] - dx[..., 1] * dy[..., 0]
            rest = target - value
            point = point + np.stack(
                [(rest[..., 0] * dy[..., 1] - rest[..., 1] * dy[..., 0]) / determinant,
                 (dx[..., 0] * rest[..., 1] - dx[..., 1] * rest[..., 0]) / determinant], axis=-1)
        wrong = ~(np.abs(distort(point, distortion) - target).max(axis=-1) < 1e-9)
    point[wrong] = np.nan
    return point


def check_invertible(camera: CameraConfig) -> None:
    """Raise ConfigError unless the distortion maps one to one over the whole image."""
    half = np.array([0.5 * camera.width, 0.5 * camera.height]) / camera.focal_px
    u, v = np.meshgrid(np.linspace(-half[0], half[0], 41), np.linspace(-half[1], half[1], 31))
    ideal = undistort(np.stack([u, v], axis=-1), camera.distortion)
    if not np.all(np.isfinite(ideal)):
        raise _refusal(camera)
    # Between the centre and the farthest ideal point the radius must grow all the way.
    h = 1e-5
    farthest = float(np.linalg.norm(ideal, axis=-1).max())
    for angle in np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False):
        ray = np.linspace(0.0, farthest, 200)[:, None] * [math.cos(angle), math.sin(angle)]
        value = distort(ray, camera.distortion)
        dx = (distort(ray + [h, 0.0], camera.distortion) - value) / h
        dy = (distort(ray + [0.0, h], camera.distortion) - value) / h
        if np.any(dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0] <= 0.05):
            raise _refusal(camera)


def _refusal(camera: CameraConfig) -> ConfigError:
    return ConfigError(f'distortion: {list(camera.distortion)} is not valid; valid is one that '
                       f'can be inverted over {camera.horizontal_fov_deg:g} deg of view; use '
                       'smaller coefficients')


def padding(camera: CameraConfig) -> tuple[int, int]:
    """Return columns and rows that a pinhole view needs beyond each edge to fill the image."""
    if not camera.distorted:
        return 0, 0
    source = source_pixels(camera)
    size = np.array([camera.width, camera.height])
    beyond = np.maximum(-source.min(axis=(0, 1)), source.max(axis=(0, 1)) - (size - 1))
    x, y = np.maximum(np.ceil(beyond) + 2, 0).astype(int)
    return int(x), int(y)


def source_pixels(camera: CameraConfig) -> Array:
    """Return (h, w, 2): where in the pinhole image each pixel of the distorted one looks [px]."""
    centre = np.array([0.5 * (camera.width - 1), 0.5 * (camera.height - 1)])
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    ideal = undistort((pixels - centre) / camera.focal_px, camera.distortion)
    return ideal * camera.focal_px + centre
