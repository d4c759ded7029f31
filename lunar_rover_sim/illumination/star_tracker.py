"""A star tracker: the attitude of the rover, where stars can be seen."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from lunar_rover_sim.frames import Array
from lunar_rover_sim.illumination.star_tracker_config import StarTrackerConfig
from lunar_rover_sim.illumination.sun_view import SeenSun

_ARCSEC = np.pi / 180.0 / 3600.0


class StarTracker:
    """Measures the attitude. rng: generator of its errors."""

    def __init__(self, config: StarTrackerConfig, rng: np.random.Generator) -> None:
        self._config, self._rng = config, rng
        # The sensor's axes in base axes, z along the line of sight.
        tilt = np.pi / 2.0 - np.radians(config.elevation_deg)
        self._R_base_sensor = Rotation.from_euler(
            'ZY', [np.radians(config.yaw_deg), tilt]).as_matrix()
        self._stddev_rad = _ARCSEC * np.array(
            [config.cross_arcsec, config.cross_arcsec, config.roll_arcsec])

    def measure(self, R_world_base: Array, angular_velocity_radps: Array, sun: SeenSun | None,
                earth: Array | None) -> Array | None:
        """Return the measured (3, 3) rotation R_world_base, None where stars cannot be seen.

        angular_velocity_radps: (3,) of the rover
        sun: what the place of the tracker sees of the sun
        earth: (3,) unit vector to the Earth, world axes; None below the horizon or unknown
        """
        c = self._config
        sight = R_world_base @ self._R_base_sensor[:, 2]
        turning = float(np.linalg.norm(angular_velocity_radps))
        if (turning > np.radians(c.largest_rate_degps)
                or sight[2] < np.sin(np.radians(c.ground_exclusion_deg))
                or (sun is not None and _within(sight, sun.direction, c.sun_exclusion_deg))
                or (earth is not None and _within(sight, earth, c.earth_exclusion_deg))):
            return None
        if not c.enabled:
            return R_world_base
        error = Rotation.from_rotvec(self._stddev_rad * self._rng.standard_normal(3)).as_matrix()
        return R_world_base @ self._R_base_sensor @ error @ self._R_base_sensor.T

    def covariance_rad2(self, R_world_base: Array) -> Array:
        """Return the (3, 3) covariance of the error, about the axes of the world [rad^2]."""
        axes = R_world_base @ self._R_base_sensor
        variance = self._stddev_rad**2 if self._config.enabled else np.zeros(3)
        return axes @ np.diag(variance) @ axes.T


def _within(sight: Array, direction: Array, angle_deg: float) -> bool:
    return bool(sight @ direction > np.cos(np.radians(angle_deg)))
