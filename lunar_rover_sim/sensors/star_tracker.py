"""A star tracker: the attitude of the rover, where stars can be seen."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from typing import Any, TYPE_CHECKING

import numpy as np

from lunar_rover_sim.bag.messages import wxyz
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import Array, matrix_from_rotvec, matrix_from_wxyz, wxyz_from_rpy
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.image.illumination.sun_view import SeenSun
from lunar_rover_sim.sensors.sensor import Attitude, HEADING, numbers, Platform, Sensor

if TYPE_CHECKING:
    from lunar_rover_sim.rover.physics.state import RoverState

_ARCSEC = np.pi / 180.0 / 3600.0
_SMALL_DIGITS = 20      # of variances
# It is blind with a light nearer to its line of sight: with the sun where that shines on it, with
# the middle of the Earth, whose place follows from a date, with the horizontal, where the bright
# ground begins. Like all its values these are choices.
_SUN_DEG, _EARTH_DEG, _GROUND_DEG = 34.0, 25.0, 25.0


@dataclasses.dataclass(frozen=True)
class StarTrackerConfig(Parameters):
    """A star tracker on the deck.

    All values are choices, of the size that small star trackers have.
    """

    gone = {'sun_exclusion_deg': 34.0, 'earth_exclusion_deg': 25.0, 'ground_exclusion_deg': 25.0}

    enabled: bool = param(True, 'false publishes the true attitude')
    rate_hz: int = param(2, 'its period is a whole number of state periods', unit='Hz', low=1,
                         high=1000)
    position_m: tuple[float, ...] = param((-0.1, 0.0, 0.06), 'in base_link',
                                          unit='m', length=3, low=-10.0,
                                          high=10.0)
    yaw_deg: float = param(180.0, 'from ahead towards the left', unit='deg',
                           low=-360.0, high=360.0)
    elevation_deg: float = param(80.0, 'how far it looks up', unit='deg', low=-90.0, high=90.0)
    cross_arcsec: float = param(5.0, 'standard deviation across the line of sight, per axis',
                                unit='arcsec', low=0.0, high=36000.0)
    roll_arcsec: float = param(55.0, 'standard deviation about the line of sight', unit='arcsec',
                               low=0.0, high=36000.0)
    largest_rate_degps: float = param(3.0, 'turning faster it loses the stars', unit='deg/s',
                                      low=0.0, high=1000.0)


class StarCamera:
    """Measures the attitude. rng: generator of its errors."""

    def __init__(self, config: StarTrackerConfig, rng: np.random.Generator) -> None:
        self._config, self._rng = config, rng
        # The sensor's axes in base axes, z along the line of sight.
        tilt = np.pi / 2.0 - np.radians(config.elevation_deg)
        self._R_base_sensor = matrix_from_wxyz(
            wxyz_from_rpy(0.0, tilt, np.radians(config.yaw_deg)))
        self._stddev_rad = _ARCSEC * np.array(
            [config.cross_arcsec, config.cross_arcsec, config.roll_arcsec])

    def measure(self, R_world_base: Array, angular_velocity_radps: Array, sun: SeenSun | None,
                earth: Array | None) -> Array | None:
        """Return the measured (3, 3) rotation R_world_base, None where stars cannot be seen.

        Args:
            angular_velocity_radps: (3,) of the rover.
            sun: What the place of the tracker sees of the sun.
            earth: (3,) unit vector to the Earth, world axes; None below the horizon or unknown.
        """
        c = self._config
        sight = R_world_base @ self._R_base_sensor[:, 2]
        turning = float(np.linalg.norm(angular_velocity_radps))
        if (turning > np.radians(c.largest_rate_degps)
                or sight[2] < np.sin(np.radians(_GROUND_DEG))
                or (sun is not None and _within(sight, sun.direction, _SUN_DEG))
                or (earth is not None and _within(sight, earth, _EARTH_DEG))):
            return None
        if not c.enabled:
            return R_world_base
        error = matrix_from_rotvec(self._stddev_rad * self._rng.standard_normal(3))
        return R_world_base @ self._R_base_sensor @ error @ self._R_base_sensor.T

    def covariance_rad2(self, R_world_base: Array) -> Array:
        """Return the (3, 3) covariance of the error, about the axes of the world [rad^2]."""
        axes = R_world_base @ self._R_base_sensor
        variance = self._stddev_rad**2 if self._config.enabled else np.zeros(3)
        return axes @ np.diag(variance) @ axes.T


def _within(sight: Array, direction: Array, angle_deg: float) -> bool:
    return bool(sight @ direction > np.cos(np.radians(angle_deg)))


class StarTracker(Sensor):
    """The star tracker on the rover."""

    name = 'star_tracker'
    parameters = StarTrackerConfig
    published = (topics.STAR_TRACKER,)
    content = HEADING
    stream = 4

    def __init__(self, config: StarTrackerConfig, platform: Platform) -> None:
        super().__init__(config, platform)
        self._camera = StarCamera(config, self.random_numbers())

    def measure(self, state: RoverState, stamp_ns: int) -> Mapping[str, Attitude]:
        """Return the attitude of base_link in the world; nothing where stars cannot be seen."""
        R_world_base, sun = state.T_world_base[:3, :3], self.platform.sun
        measured = self._camera.measure(
            R_world_base, state.angular_velocity_radps,
            sun.seen(state, self.config.position_m, stamp_ns), sun.earth(stamp_ns))
        return {} if measured is None else {topics.STAR_TRACKER.name: Attitude(
            measured, self._camera.covariance_rad2(R_world_base))}

    @classmethod
    def read(cls, topic: str, message: Any) -> dict[str, Any]:
        """Return orientation and covariance of a sensor_msgs/Imu."""
        covariance = np.reshape(message.orientation_covariance, (3, 3))
        return {'frame': message.header.frame_id,
                'wxyz_world_base': numbers(wxyz(message.orientation)),
                'covariance_rad2': [numbers(row, _SMALL_DIGITS) for row in covariance]}
