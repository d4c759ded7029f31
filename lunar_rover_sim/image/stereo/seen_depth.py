"""Depth as stereo sees it, without images: rays at fewer pixels, with the errors of the matcher.

Rays of the left camera are cast on the world, and from where they meet it to the sun. Matched is
what is lit and seen by both cameras. Errors are those that `validate stereo` measured on rendered
pairs of `baseline` (docs/measurements/accuracy.md): 0.2 px of the disparity, 14 % of lit ground
without a match, 2.3 % of the matches wrong by more than a pixel. Both come in patches, as those of
a matcher do.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array, inverse, sun_direction
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.lidar.ray_arrays import HeightPyramid, RockHulls
from lunar_rover_sim.image.lidar.ray_caster import RayCaster
from lunar_rover_sim.rover.description import RoverDescription

WIDTH, HEIGHT = 128, 96
ERROR_PX, UNMATCHED, WRONG = 0.25, 0.14, 0.023
WRONG_PX = 12.0             # a wrong match is off by up to so much [px]
_PATCH = 6                  # of pixels here, that err together
_ABOVE_M = 2e-3             # a ray to the sun starts this far from where it left
_SHADOW_M = 12.0            # how far away what casts a shadow may be: 1.2 m high at 6 degrees


class SeenDepth:
    """Draws depth images of a world at poses of the rover.

    They have a fifth of the columns and rows of real ones: enough points for cells of 5 cm.

    Attributes:
        K: (3, 3) intrinsics of them.
        baseline_m: Of the stereo pair.
        real_baseline_m: That with which these few pixels have the errors of the real images.
        T_base_camera: (4, 4) optical frame of the left camera in base_link.
    """

    def __init__(self, world: World, rover: RoverDescription, camera: CameraConfig,
                 sun: SunConfig, seed: int, exact: bool = False) -> None:
        """Prepare a world; exact: without errors and shadows, as far as rays reach."""
        small = dataclasses.replace(camera, width=WIDTH, height=HEIGHT)
        rig = StereoRig(rover, small)
        self.K, self.baseline_m = rig.K, rig.baseline_m
        self.T_base_camera, self._exact = rig.T_base_left, exact
        self._right = (inverse(rig.T_base_left) @ rig.T_base_right)[:3, 3]
        # Errors are those of the real images, with their focal length.
        self._real = camera.width / WIDTH
        self.real_baseline_m = rig.baseline_m * self._real
        self._rays = rig.rays().reshape(-1, 3)
        self._lengths = np.linalg.norm(self._rays, axis=1)
        # Rays are cast in the frame of the window.
        self._middle_m = np.array(world.ground.middle_m)
        local = world.local()
        hulls = RockHulls(local.rocks, local.rock_shapes)
        self._caster = RayCaster([HeightPyramid(local.ground, hulls)], hulls)
        self._limit_m = world.ground.half_extent_m - 0.5
        self._sun = sun_direction(sun.azimuth_deg, sun.elevation_deg)
        self._rng = np.random.default_rng([seed, 46])

    def look(self, T_world_base: Array, range_m: float) -> NDArray[np.float32]:
        """Return the depth (h, w) [m] at a pose (4, 4), NaN where nothing is matched."""
        T = T_world_base @ self.T_base_camera
        T[:2, 3] -= self._middle_m
        rays = self._rays @ T[:3, :3].T / self._lengths[:, None]
        origin = np.broadcast_to(T[:3, 3], rays.shape)
        depth = np.full(len(rays), np.nan)
        if np.abs(T[:2, 3]).max() > self._limit_m:
            return depth.reshape(HEIGHT, WIDTH).astype(np.float32)
        # Rays above the horizon of the range meet nothing that is looked for.
        which = np.flatnonzero(rays[:, 2] < 0.2)
        hits = self._caster.cast(origin, rays, 1.3 * range_m, which, from_one_place=False)
        distance = hits.distance_m
        met = np.isfinite(distance)
        depth[met] = distance[met] / self._lengths[met]
        if self._exact:
            return depth.reshape(HEIGHT, WIDTH).astype(np.float32)
        points = origin + np.where(met, distance, 0.0)[:, None] * rays
        start = points + _ABOVE_M * hits.normal
        seen = met & self._sees(start, np.broadcast_to(self._sun, rays.shape), met, _SHADOW_M)
        to_right = T[:3, :3] @ self._right + T[:3, 3] - start
        apart = np.linalg.norm(to_right, axis=1)
        seen &= self._sees(start, to_right / apart[:, None], seen, apart)
        return self._with_errors(np.where(seen, depth, np.nan))

    def _sees(self, start: Array, direction: Array, asked: NDArray[np.bool_],
              range_m: float | Array) -> NDArray[np.bool_]:
        """Return which rays meet nothing within a range [m]; those not asked for count as met."""
        which = np.flatnonzero(asked)
        free = np.zeros(len(start), bool)
        inside = np.abs(start[which, :2]).max(axis=1, initial=0.0) < self._limit_m
        which = which[inside]
        if len(which):
            far = float(np.max(range_m)) if np.ndim(range_m) else float(range_m)    # type: ignore
            hits = self._caster.cast(start, np.ascontiguousarray(direction), far, which,
                                     from_one_place=False)
            limit = range_m[which] if isinstance(range_m, np.ndarray) else range_m
            free[which] = ~(hits.distance_m[which] < limit)
        return free

    def _with_errors(self, depth: Array) -> NDArray[np.float32]:
        image = depth.reshape(HEIGHT, WIDTH)
        scale = self.K[0, 0] * self._real * self.baseline_m
        disparity = scale / image
        disparity += ERROR_PX * self._rng.standard_normal(image.shape)
        wrong = self._patches() < WRONG
        disparity[wrong] += (WRONG_PX * (2.0 * self._patches() - 1.0))[wrong]
        lost = (self._patches() < UNMATCHED) | ~(disparity > 0.25)
        found = scale / np.where(lost, np.nan, disparity)
        return found.astype(np.float32)

    def _patches(self) -> Array:
        """Return (h, w) values, evenly distributed in [0, 1], equal within patches."""
        rows, columns = -(-HEIGHT // _PATCH) + 1, -(-WIDTH // _PATCH) + 1
        values = self._rng.random((rows, columns))
        big: Any = cv2.resize(values, (columns * _PATCH, rows * _PATCH),
                              interpolation=cv2.INTER_NEAREST)
        y, x = self._rng.integers(0, _PATCH, 2)
        return np.asarray(big[y:y + HEIGHT, x:x + WIDTH], float)
