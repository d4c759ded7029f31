"""The pinhole image that a distorted image is made from."""

from __future__ import annotations

import functools

import numpy as np

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.camera.distortion import undistort
from lunar_rover_sim.frames import Array


def padding(camera: CameraConfig) -> tuple[int, int]:
    """Return columns and rows that a pinhole view needs beyond each edge to fill the image."""
    if not camera.distorted:
        return 0, 0
    source = source_pixels(camera)
    size = np.array([camera.width, camera.height])
    beyond = np.maximum(-source.min(axis=(0, 1)), source.max(axis=(0, 1)) - (size - 1))
    x, y = np.maximum(np.ceil(beyond) + 2, 0).astype(int)
    return int(x), int(y)


@functools.lru_cache(maxsize=2)     # a renderer asks three times
def source_pixels(camera: CameraConfig) -> Array:
    """Return (h, w, 2): the place in the pinhole image that each distorted pixel shows [px]."""
    centre = np.array([0.5 * (camera.width - 1), 0.5 * (camera.height - 1)])
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    ideal = undistort((pixels - centre) / camera.focal_px, camera.distortion)
    source = ideal * camera.focal_px + centre
    source.setflags(write=False)
    return source
