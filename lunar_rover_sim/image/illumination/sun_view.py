"""The sun from one place: the visible share of its disc, and where its light comes from."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array, sun_direction
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.illumination.config import SunConfig

# Whether light comes from each of (n, 3) directions to a (3,) place, past what is near.
Clear = Callable[[Array, Array], NDArray[np.bool_]]

_RAYS = 19              # the share of the disc is known to a twentieth
_SAMPLES = 400          # of the horizon beyond the fine ground
_NEAREST_M = 0.5


@dataclasses.dataclass(frozen=True)
class SeenSun:
    """What of the sun a place sees.

    Attributes:
        direction: (3,) unit vector to the middle of what is seen, world axes.
        share: Of the area of the disc, above 0 and up to 1.
    """

    direction: Array
    share: float


class SunView:
    """The sun's disc over a world, by rays to points of it that stand for equal areas."""

    def __init__(self, world: World, sun: SunConfig) -> None:
        self._world = world
        self._shines = sun.shines
        centre = sun_direction(sun.azimuth_deg, sun.elevation_deg)
        right = np.cross([0.0, 0.0, 1.0], centre)
        right /= np.linalg.norm(right) or 1.0
        # Points of a sunflower (Vogel 1979): equal areas at the golden angle.
        k = np.arange(_RAYS)
        radius = np.tan(np.radians(0.5 * sun.angular_diameter_deg)) * np.sqrt((k + 0.5) / _RAYS)
        turn = k * np.pi * (3.0 - np.sqrt(5.0))
        rays = (centre + np.outer(radius * np.cos(turn), right)
                + np.outer(radius * np.sin(turn), np.cross(centre, right)))
        self._rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        self._along = centre[:2] / (np.linalg.norm(centre[:2]) or 1.0)

    def seen_from(self, point_m: Array, clear: Clear) -> SeenSun | None:
        """Return what a (3,) place in the world sees of the sun, None if nothing.

        Args:
            clear: Whether rays pass what stands on the fine ground, and that ground; the relief
                beyond it is looked at here.
        """
        if not self._shines:
            return None
        rays = self._rays[self._rays[:, 2] > self._horizon_sine(point_m)]
        if len(rays):
            rays = rays[clear(point_m, rays)]
        if not len(rays):
            return None
        middle = rays.mean(axis=0)
        return SeenSun(middle / np.linalg.norm(middle), len(rays) / _RAYS)

    def _horizon_sine(self, point_m: Array) -> float:
        """Return the sine of the elevation of the relief beyond the fine ground, sunward."""
        levels = self._world.levels
        away = float(np.abs(point_m[:2] - levels[0].middle_m).max())
        nearest = max(levels[0].half_extent_m - away, _NEAREST_M)
        distance = np.geomspace(nearest, max(levels[-1].half_extent_m, 2.0 * nearest), _SAMPLES)
        height = self._world.height_at(point_m[:2] + np.outer(distance, self._along))
        known = np.isfinite(height)     # the world ends somewhere
        if not known.any():
            return -1.0
        rise = float(np.max((height[known] - point_m[2]) / distance[known]))
        return rise / float(np.hypot(1.0, rise))
