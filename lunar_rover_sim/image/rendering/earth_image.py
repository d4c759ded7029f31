"""The Earth: its disc in the images, behind whatever stands in front of the sky."""

from __future__ import annotations

from collections.abc import Collection
import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera.development import LitImage
from lunar_rover_sim.image.illumination.earth_disc import earth_disc, EarthDisc
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.projection import Projection
from lunar_rover_sim.image.rendering.scene import Scene

_FINE = 64      # samples across the disc, at least, that make its image


class EarthImage:
    """Draws the Earth into the radiance of the sky."""

    def __init__(self, projection: Projection, config: RenderConfig) -> None:
        """Prepare the disc; projection: of both cameras."""
        self._projection = projection
        self.relight(config)

    def relight(self, config: RenderConfig) -> None:
        """Move the Earth to the date of the sun."""
        self._earth = earth_disc(config.sun) if config.earth.drawn else None
        if self._earth is None:
            return
        K = self._projection.K
        across = 2.0 * K[0, 0] * math.tan(self._earth.radius_rad)
        corner = np.abs(K[:2, 2]).max() * math.sqrt(2.0) / K[0, 0]
        # The image of a disc is longer towards the corners.
        self._side = 2 * math.ceil(0.55 * across * (1.0 + corner**2)) + 2
        self._finer = int(np.clip(math.ceil(_FINE / across), 2, 16))

    def draw(self, scene: Scene, images: Collection[LitImage]) -> None:
        """Add the disc to the sky of lit images; both cameras see it in one place."""
        if self._earth is None:
            return
        R = scene.T_world_cameras[0][:3, :3]
        direction = R.T @ self._earth.direction
        if direction[2] <= 0.0:
            return
        K, side = self._projection.K, self._side
        limit = 1e6     # of pixels, so that directions near the plane of the lens stay whole
        centre = np.clip((K @ direction)[:2] / direction[2], -limit, limit)
        first = np.rint(centre).astype(int) - side // 2
        size = np.array([self._projection.width, self._projection.height])
        low, high = np.maximum(first, 0), np.minimum(first + side, size)
        if np.any(low >= high):
            return
        patch = self._image(first, dataclasses.replace(
            self._earth, direction=direction, sun_direction=R.T @ self._earth.sun_direction))
        part = slice(low[1], high[1]), slice(low[0], high[0])
        patch = patch[low[1] - first[1]:high[1] - first[1], low[0] - first[0]:high[0] - first[0]]
        for image in images:
            image.radiance[part] += np.where(image.depth_m[part] == 0.0, patch, 0.0)

    def _image(self, first: Array, earth: EarthDisc) -> NDArray[np.float32]:
        """Return (side, side) mean radiance of pixels; earth: in axes of the cameras."""
        K, side, finer = self._projection.K, self._side, self._finer
        fine = (np.arange(side * finer) + 0.5) / finer - 0.5
        x, y = (fine + first[0] - K[0, 2]) / K[0, 0], (fine + first[1] - K[1, 2]) / K[1, 1]
        rays = np.stack(np.broadcast_arrays(x[None], y[:, None], 1.0), axis=-1)
        radiance = earth.radiance(rays).reshape(side, finer, side, finer).mean(axis=(1, 3))
        return np.asarray(radiance, np.float32)
