"""Mapping between pixels and viewing directions, for lens and motion blur."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera import equidistant
from lunar_rover_sim.image.camera.fisheye import FisheyeCamera
from lunar_rover_sim.image.camera.motion import CameraTwist
from lunar_rover_sim.image.camera.rig import cosine_fourth


def lengths(x: Array, y: Array) -> Array:
    """Return the lengths of vectors whose components broadcast, sooner than `numpy.hypot`."""
    return np.asarray(np.sqrt(x * x + y * y))


class PinholeImage:
    """The image that is drawn of a pinhole camera, padding included; its rays have depth 1.

    Attributes:
        K: (3, 3) focal lengths and principal point [px].
        fisheye: k1 to k4 of `equidistant`, and the angle to the axis where the image ends [rad];
            empty for a pinhole.
        ray_table: (height, width, 3) unit vectors, NaN beyond the image; empty for a pinhole.
    """

    fisheye: tuple[float, ...] = ()
    ray_table = np.empty((0, 0, 3))

    def __init__(self, K: Array, width: int, height: int) -> None:
        self.K, self.width, self.height = K, width, height
        self.focal_px = float(K[0, 0])

    def falloff(self, places_px: Array) -> Array:
        """Return cos^4 of the angle to the axis."""
        return cosine_fourth(places_px, self.K)

    def place(self, direction: Array) -> Array:
        """Return the (2,) pixel that shows a direction; the direction looks ahead."""
        return (self.K @ direction)[:2] / max(float(direction[2]), 1e-6)

    def pupil(self, direction: Array) -> float:
        """Return the cosine of the angle to the axis."""
        return max(float(direction[2]), 1e-6)

    def scatter(self, columns_px: Array, rows_px: Array,
                direction: Array) -> tuple[Array, Array]:
        """Return what light from a direction scatters to pixels depends on.

        Columns and rows broadcast. Returns the distances that the law of scatter counts, in
        direction cosines, and the scattered radiance for a scatter of one per steradian.
        """
        x = (columns_px - self.K[0, 2]) / self.focal_px
        y = (rows_px - self.K[1, 2]) / self.focal_px
        cosine = 1.0 / np.sqrt(1.0 + x * x + y * y)
        return lengths(x * cosine - direction[0], y * cosine - direction[1]), np.ones(())

    def rays(self, places_px: Array) -> Array:
        """Return (n, 3) vectors of depth 1."""
        return np.concatenate([(places_px - self.K[:2, 2]) / np.diag(self.K)[:2],
                               np.ones((len(places_px), 1))], axis=1)

    def nearness(self, points_m: Array) -> Array:
        """Return inverse depths, infinite behind the camera."""
        return 1.0 / np.maximum(points_m[:, 2], 1e-9)

    def image_speed(self, twist: CameraTwist, rays: Array, nearness: Array) -> Array:
        """Return the (n,) speeds of points in the image [px/s]."""
        return twist.image_speed(rays, nearness) * self.focal_px


class FisheyeImage:
    """The image of a fisheye, with what `PinholeImage` has; its rays have length 1."""

    def __init__(self, camera: FisheyeCamera) -> None:
        self._camera = camera
        self.width, self.height, self.K = camera.width, camera.height, camera.K
        self.focal_px = camera.focal_px
        self.fisheye = (*camera.D, camera.limit_rad)
        self.ray_table = np.ascontiguousarray(camera.directions(camera.pixels()))

    def falloff(self, places_px: Array) -> Array:
        """Return the solid angle of pixels, over that on the axis; see `FisheyeCamera`."""
        return self._camera.falloff(places_px)

    def place(self, direction: Array) -> Array:
        """Return the (2,) place of a direction in the image plane, also beyond the image."""
        beside = float(np.linalg.norm(direction[:2]))
        theta = np.arctan2(beside, direction[2])
        limit = self._camera.limit_rad
        rho = float(equidistant.radius(min(theta, limit), self._camera.D))
        rho += max(theta - limit, 0.0)
        return self.K[:2, 2] + self.focal_px * rho / max(beside, 1e-12) * direction[:2]

    def pupil(self, direction: Array) -> float:
        """Return 1: as in `FisheyeCamera.falloff`."""
        return 1.0

    def scatter(self, columns_px: Array, rows_px: Array,
                direction: Array) -> tuple[Array, Array]:
        """Return distances in the image over the focal length.

        Behind the front elements, which bend light from the side towards the axis, directions lie
        about as the image does.
        """
        x, y = self.place(direction)
        apart = lengths(columns_px - x, rows_px - y) / self.focal_px
        places = np.stack(np.broadcast_arrays(columns_px, rows_px), axis=-1)
        return apart, 1.0 / self.falloff(places)

    def rays(self, places_px: Array) -> Array:
        """Return (n, 3) unit vectors, beyond the limit those on the limit."""
        offset = places_px - self.K[:2, 2]
        theta = self._camera.angles(places_px)
        across = offset / np.maximum(np.linalg.norm(offset, axis=1), 1e-12)[:, None]
        return np.concatenate([np.sin(theta)[:, None] * across, np.cos(theta)[:, None]], axis=1)

    def nearness(self, points_m: Array) -> Array:
        """Return inverse distances."""
        return 1.0 / np.maximum(np.linalg.norm(points_m, axis=1), 1e-9)

    def image_speed(self, twist: CameraTwist, rays: Array, nearness: Array) -> Array:
        """Return the (n,) speeds of points in the image [px/s], by the denser of both directions.
        """
        speed = (np.cross(twist.angular_velocity_radps, rays)
                 + twist.linear_velocity_mps * nearness[:, None])
        speed -= rays * (speed * rays).sum(axis=1, keepdims=True)
        theta = np.arccos(np.clip(rays[:, 2], -1.0, 1.0))
        D = self._camera.D
        density = np.maximum(equidistant.radius_slope(theta, D), equidistant.radius(theta, D)
                             / np.maximum(np.sin(theta), 1e-9))
        density = np.where(theta > 1e-6, density, 1.0)
        return np.linalg.norm(speed, axis=1) * density * self.focal_px


ImageGeometry = PinholeImage | FisheyeImage
