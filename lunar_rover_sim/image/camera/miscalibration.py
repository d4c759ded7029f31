"""A right camera that is not what its CameraInfo says: turned, of other focal length and gain.

A turn about the centre of the camera and another focal length move the image alone, by a
homography (Hartley and Zisserman, Multiple View Geometry, 2004, section 8.4): the ideal image is
drawn, and pixels show other places of it.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools

import numpy as np
import scipy  # its parts when they are used

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera.config import CameraConfig, MiscalibrationConfig
from lunar_rover_sim.image.camera.distortion import undistort

_STREAM = 5150      # of the seed


@dataclasses.dataclass(frozen=True)
class Miscalibration:
    """What is wrong with the right camera.

    Attributes:
        rotation_rad: Rotation vector of the camera against its optical frame, in axes of that.
        focal_ratio: Its focal length over that of CameraInfo.
        gain: Its signal over that of the left camera under the same light.
    """

    rotation_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    focal_ratio: float = 1.0
    gain: float = 1.0

    @classmethod
    def drawn(cls, config: MiscalibrationConfig, seed: int) -> Miscalibration:
        """Return one within the bounds, each part uniform.

        Args:
            seed: Of the scenario.
        """
        parts = np.random.default_rng([seed, _STREAM]).uniform(-1.0, 1.0, 5)
        x, y, z = np.radians(config.rotation_deg) * parts[:3]
        return cls((float(x), float(y), float(z)),
                   float(1.0 + 0.01 * config.focal_percent * parts[3]),
                   float(1.0 + 0.01 * config.gain_percent * parts[4]))

    def source(self, camera: CameraConfig) -> Array:
        """Return (h, w, 2): the place in the ideal image that each pixel shows [px]."""
        if not any(self.rotation_rad) and self.focal_ratio == 1.0:
            return source_pixels(camera)
        centre = 0.5 * np.array([camera.width - 1.0, camera.height - 1.0])
        beside = (source_pixels(camera) - centre) / (self.focal_ratio * camera.focal_px)
        rays = np.concatenate([beside, np.ones((*beside.shape[:2], 1))], axis=-1)
        rays = rays @ scipy.spatial.transform.Rotation.from_rotvec(self.rotation_rad).as_matrix().T
        return np.asarray(rays[..., :2] / rays[..., 2:] * camera.focal_px + centre)

    def told(self, camera: CameraConfig) -> dict[str, object]:
        """Return it for JSON, beside the focal length [px]."""
        return {'camera': 'right', 'rotation_vector_rad': list(self.rotation_rad),
                'focal_px': self.focal_ratio * camera.focal_px,
                'focal_px_of_camera_info': camera.focal_px, 'gain': self.gain}


def margin(camera: CameraConfig, bounds: MiscalibrationConfig) -> tuple[int, int]:
    """Return columns and rows that the ideal image needs beyond each edge to fill both images."""
    if not bounds.moves:
        return padding(camera)
    turn, longer = np.radians(bounds.rotation_deg), 0.01 * bounds.focal_percent
    size, beyond = np.array([camera.width, camera.height]), np.zeros(2)
    for x, y, z, part in itertools.product((-turn, turn), (-turn, turn), (-turn, turn),
                                           (-longer, longer)):
        source = Miscalibration((x, y, z), 1.0 + part).source(camera)
        beyond = np.maximum(beyond, np.maximum(-source.min(axis=(0, 1)),
                                               source.max(axis=(0, 1)) - (size - 1)))
    columns, rows = (np.ceil(beyond) + 2).astype(int)
    return int(columns), int(rows)


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
