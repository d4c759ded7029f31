"""A camera's intrinsics; the stereo rig: projection matrices and mounting of its two cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import optical_poses


class PinholeCamera:
    """A camera, wherever it is mounted.

    Pixel coordinates follow OpenCV and ROS: the centre of the upper left pixel is (0, 0).

    Attributes:
        K: (3, 3) intrinsics [px].
        D: (5,) Brown-Conrady distortion k1, k2, p1, p2, k3 (`plumb_bob`) of the raw images.
        R: (3, 3) rectification, the identity: the cameras are mounted rectified.
        P_left: (3, 4) projection of its optical frame; that of the left one of a pair.
        distortion_model: As CameraInfo names it.
    """

    distortion_model = 'plumb_bob'

    def __init__(self, camera: CameraConfig) -> None:
        self.width, self.height = camera.width, camera.height
        focal = camera.focal_px
        self.K: Array = np.array([[focal, 0.0, 0.5 * (self.width - 1)],
                                  [0.0, focal, 0.5 * (self.height - 1)],
                                  [0.0, 0.0, 1.0]])
        self.D: Array = np.array(camera.distortion)
        self.R: Array = np.eye(3)
        self.P_left: Array = np.hstack([self.K, np.zeros((3, 1))])

    @property
    def focal_px(self) -> float:
        """Focal length [px]."""
        return float(self.K[0, 0])

    def falloff(self, places_px: ArrayLike) -> Array:
        """Return the irradiance of (..., 2) pixels under even radiance, over that on the axis.

        It is cos^4 of the angle to the axis.
        """
        return cosine_fourth(places_px, self.K)

    def rays(self) -> Array:
        """Return the (height, width, 3) ray of each rectified pixel, optical frame, with z = 1."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return np.stack([(u - self.K[0, 2]) / self.K[0, 0], (v - self.K[1, 2]) / self.K[1, 1],
                         np.ones(u.shape)], axis=-1)


def cosine_fourth(places_px: ArrayLike, K: Array) -> Array:
    """Return cos^4 of the angle to the axis of (..., 2) pixels; K: (3, 3) intrinsics [px]."""
    tangents = (np.asarray(places_px, dtype=float) - K[:2, 2]) / K[0, 0]
    return (1.0 + tangents[..., 0]**2 + tangents[..., 1]**2)**-2


class StereoRig(PinholeCamera):
    """Two equal cameras whose optical axes are parallel and whose rows correspond.

    Attributes:
        P_left: (3, 4) projection of the left optical frame into the left image.
        P_right: (3, 4) projection of the left optical frame into the right image;
            P_right[0, 3] = -fx baseline_m.
        T_base_left: (4, 4) left optical frame in base_link.
        T_base_right: (4, 4) right optical frame in base_link.
    """

    def __init__(self, rover: RoverDescription, camera: CameraConfig) -> None:
        super().__init__(camera)
        self.baseline_m = rover.stereo.baseline_m
        self.P_right: Array = self.P_left.copy()
        self.P_right[0, 3] = -self.focal_px * self.baseline_m
        self.T_base_left, self.T_base_right = optical_poses(rover)

    def project(self, points_world_m: ArrayLike, T_world_base: ArrayLike) -> tuple[Array, Array]:
        """Project (..., 3) world points into both rectified images.

        Returns:
            left_px, right_px, each (..., 2); points behind the cameras are NaN.
        """
        T_left_world = inverse(np.asarray(T_world_base, dtype=float) @ self.T_base_left)
        points = np.asarray(points_world_m, dtype=float)
        optical = points @ T_left_world[:3, :3].T + T_left_world[:3, 3]
        homogeneous = np.concatenate([optical, np.ones(optical.shape[:-1] + (1,))], axis=-1)
        pixels = []
        for P in (self.P_left, self.P_right):
            uvw = homogeneous @ P.T
            depth = np.where(uvw[..., 2:] > 0.0, uvw[..., 2:], np.nan)
            pixels.append(uvw[..., :2] / depth)
        return pixels[0], pixels[1]
