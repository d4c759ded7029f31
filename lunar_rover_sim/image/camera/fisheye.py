"""A fisheye camera: where it images what, and how bright."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera import equidistant
from lunar_rover_sim.image.camera.config import FurtherCameraConfig
from lunar_rover_sim.image.camera.hazard import HazardCameraConfig
from lunar_rover_sim.image.camera.lens import Lens
from lunar_rover_sim.image.camera.rig import PinholeCamera


class FisheyeCamera:
    """An equidistant fisheye, wherever it is mounted.

    Pixel coordinates follow OpenCV and ROS: the centre of the upper left pixel is (0, 0).

    distortion_model: as CameraInfo names it

    Attributes:
        K: (3, 3) focal length and principal point [px].
        D: (4,) coefficients k1, k2, k3, k4, see `equidistant`.
        R: (3, 3) rectification, the identity.
        P_left: (3, 4) K of its optical frame.
        limit_rad: Angle to the axis beyond which no light arrives.
    """

    distortion_model = 'equidistant'

    def __init__(self, camera: HazardCameraConfig) -> None:
        self.width, self.height = camera.width, camera.height
        focal = camera.focal_px
        self.K: Array = np.array([[focal, 0.0, 0.5 * (self.width - 1)],
                                  [0.0, focal, 0.5 * (self.height - 1)],
                                  [0.0, 0.0, 1.0]])
        self.D: Array = np.array(camera.fisheye_distortion)
        self.R: Array = np.eye(3)
        self.P_left: Array = np.hstack([self.K, np.zeros((3, 1))])
        self.limit_rad = math.radians(0.5 * camera.image_circle_deg)

    @property
    def focal_px(self) -> float:
        """Focal length [px], on the axis also per radian."""
        return float(self.K[0, 0])

    def project(self, points_m: ArrayLike) -> Array:
        """Return the (..., 2) pixels of (..., 3) points, optical frame; NaN beyond the limit."""
        points = np.asarray(points_m, dtype=float)
        beside = np.linalg.norm(points[..., :2], axis=-1)
        theta = np.arctan2(beside, points[..., 2])
        rho = equidistant.radius(theta, self.D)
        scale = np.where(theta <= self.limit_rad, rho / np.maximum(beside, 1e-300), np.nan)
        return self.focal_px * scale[..., None] * points[..., :2] + self.K[:2, 2]

    def angles(self, places_px: ArrayLike) -> Array:
        """Return the angles to the axis [rad] that (..., 2) pixels show, at most `limit_rad`."""
        offset = (np.asarray(places_px, dtype=float) - self.K[:2, 2]) / self.focal_px
        return equidistant.angle(np.linalg.norm(offset, axis=-1), self.D, self.limit_rad)

    def directions(self, places_px: ArrayLike) -> Array:
        """Return the (..., 3) unit vectors that (..., 2) pixels show; NaN beyond the limit."""
        offset = (np.asarray(places_px, dtype=float) - self.K[:2, 2]) / self.focal_px
        rho = np.linalg.norm(offset, axis=-1)
        theta = self.angles(places_px)
        inside = rho <= equidistant.radius(self.limit_rad, self.D) + 1e-9
        theta = np.where(inside, theta, np.nan)
        beside = np.sin(theta) / np.maximum(rho, 1e-300)
        return np.concatenate([offset * beside[..., None], np.cos(theta)[..., None]], axis=-1)

    def pixels(self) -> Array:
        """Return the (height, width, 2) places of all pixels."""
        return np.stack(np.meshgrid(np.arange(self.width, dtype=float),
                                    np.arange(self.height, dtype=float)), axis=-1)

    def falloff(self, places_px: ArrayLike) -> Array:
        """Return the irradiance of (..., 2) pixels under even radiance, over that on the axis.

        It is the solid angle that a pixel covers, sin(theta) / (rho rho'), sin(theta) / theta for
        the ideal equidistant lens: 0.64 at 90 deg. The cos^4 law does not hold for a fisheye: its
        entrance pupil tilts and stretches towards the side (pupil coma; Johnson & Sasian, 2020,
        Appl. Opt. 59, G19), without which nothing could be seen at 90 deg. The area of the pupil
        square to the ray is taken as the same for all rays, which is a choice. Beyond the limit
        the value stays.
        """
        theta = np.maximum(self.angles(places_px), 1e-6)
        return np.sin(theta) / (equidistant.radius(theta, self.D)
                                * equidistant.radius_slope(theta, self.D))


class FisheyeLens(Lens):
    """The lens of a fisheye: what it scatters falls with the distance in the image."""

    @property
    def reach(self) -> float:
        """Distance in the image over the focal length, within which light is scattered."""
        return 2.0 * FisheyeCamera(self._fisheye).limit_rad

    @property
    def _fisheye(self) -> HazardCameraConfig:
        assert isinstance(self.camera, HazardCameraConfig)
        return self.camera

    def beyond_rad(self, direction: Array) -> float:
        """Return how far outside the image a (3,) unit vector, camera axes, points [rad]."""
        corner = float(FisheyeCamera(self._fisheye).angles([-0.5, -0.5]))
        return math.acos(min(max(float(direction[2]), -1.0), 1.0)) - corner


def geometry_of(config: FurtherCameraConfig) -> PinholeCamera | FisheyeCamera:
    """Return where a camera images what: a pinhole or a fisheye, as its parameters ask for it."""
    camera = config.camera
    return (FisheyeCamera(camera) if isinstance(camera, HazardCameraConfig) and camera.is_fisheye
            else PinholeCamera(camera))
