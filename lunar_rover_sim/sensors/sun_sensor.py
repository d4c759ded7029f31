"""A fine sun sensor: the direction to the sun in body axes, from heads that look around."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from typing import Any, TYPE_CHECKING

import numpy as np

from lunar_rover_sim.bag.messages import xyz
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.image.illumination.sun_view import SeenSun
from lunar_rover_sim.sensors.sensor import HEADING, numbers, Platform, Sensor, Vector

if TYPE_CHECKING:
    from lunar_rover_sim.rover.physics.state import RoverState

_MOST_RAD = np.radians(89.99)       # of a measured angle
_LEAST_SHARE = 0.5                  # of the disc of the sun, below which a head is silent


@dataclasses.dataclass(frozen=True)
class SunSensorConfig(Parameters):
    """Sun sensors on the deck, as one.

    Field of view, error and rate are those of a NewSpace Systems NFSS-411 (cubesatshop.com: 140
    deg, below 0.1 deg RMS over the field, 5 Hz). Its maker does not say how much of the error
    stays; half of its power is a choice.
    """

    gone = {'least_share': 0.5}

    enabled: bool = param(True, 'false publishes the true direction')
    rate_hz: int = param(5, 'its period is a whole number of state periods', unit='Hz', low=1,
                         high=1000)
    position_m: tuple[float, ...] = param((-0.1, 0.0, 0.06), 'in base_link', unit='m',
                                          length=3, low=-10.0, high=10.0)
    heads_yaw_deg: tuple[float, ...] = param((0.0, 90.0, 180.0, 270.0), 'from ahead towards the '
                                             'left', unit='deg',
                                             low=-360.0, high=360.0)
    heads_elevation_deg: float = param(20.0, 'how far they look up', unit='deg', low=-90.0,
                                       high=90.0)
    field_of_view_deg: float = param(140.0, 'full angle of a head', unit='deg',
                                     low=1.0, high=170.0)
    bias_deg: float = param(0.07, 'standard deviation of the error that a head keeps, per axis',
                            unit='deg', low=0.0, high=45.0)
    noise_deg: float = param(0.07, 'standard deviation of a measurement, per axis',
                             unit='deg', low=0.0, high=45.0)

    @property
    def stddev_deg(self) -> float:
        """The standard deviation of a measured angle [deg]."""
        return float(np.hypot(self.bias_deg, self.noise_deg)) if self.enabled else 0.0


class SunHeads:
    """Measures the direction to the sun. rng: generator of its errors."""

    def __init__(self, config: SunSensorConfig, rng: np.random.Generator) -> None:
        self._config, self._rng = config, rng
        self._heads = [_axes(np.radians(yaw), np.radians(config.heads_elevation_deg))
                       for yaw in config.heads_yaw_deg]
        self._bias_rad = np.radians(config.bias_deg) * rng.standard_normal((len(self._heads), 2))
        self._edge = np.cos(np.radians(0.5 * config.field_of_view_deg))

    def measure(self, sun: SeenSun | None, R_world_base: Array) -> Array | None:
        """Return the (3,) unit vector to the sun in base axes, None if no head sees it.

        The head that looks nearest to the sun measures two angles about its axis z, atan(x / z)
        and atan(y / z), each with its errors.

        Args:
            sun: What the place of the sensor sees.
        """
        if sun is None or sun.share < _LEAST_SHARE or not self._heads:
            return None
        direction = R_world_base.T @ sun.direction
        k = int(np.argmax([head[2] @ direction for head in self._heads]))
        x, y, z = self._heads[k] @ direction
        if z < self._edge:
            return None
        if not self._config.enabled:
            return direction
        angles = np.arctan2([x, y], z) + self._bias_rad[k] \
            + np.radians(self._config.noise_deg) * self._rng.standard_normal(2)
        # Errors at the edge of a wide field may lead past 90 deg, where the tangent changes sign.
        angles = np.clip(angles, -_MOST_RAD, _MOST_RAD)
        measured = self._heads[k].T @ np.append(np.tan(angles), 1.0)
        return measured / np.linalg.norm(measured)


def _axes(yaw_rad: float, elevation_rad: float) -> Array:
    """Return the (3, 3) axes of a head in rows, base axes; z looks out, x is level."""
    out = np.array([np.cos(yaw_rad) * np.cos(elevation_rad),
                    np.sin(yaw_rad) * np.cos(elevation_rad), np.sin(elevation_rad)])
    level = np.array([-np.sin(yaw_rad), np.cos(yaw_rad), 0.0])
    return np.array([level, np.cross(out, level), out])


class SunSensor(Sensor):
    """The sun sensor on the rover."""

    name = 'sun_sensor'
    parameters = SunSensorConfig
    published = (topics.SUN_SENSOR,)
    content = HEADING
    stream = 3

    def __init__(self, config: SunSensorConfig, platform: Platform) -> None:
        super().__init__(config, platform)
        self._heads = SunHeads(config, self.random_numbers())

    def measure(self, state: RoverState, stamp_ns: int) -> Mapping[str, Vector]:
        """Return the direction to the sun in base_link; nothing if no head sees it."""
        sun = self.platform.sun.seen(state, self.config.position_m, stamp_ns)
        direction = self._heads.measure(sun, state.T_world_base[:3, :3])
        return {} if direction is None else {topics.SUN_SENSOR.name: Vector(direction)}

    @classmethod
    def read(cls, topic: str, message: Any) -> dict[str, Any]:
        """Return the direction of a geometry_msgs/Vector3Stamped."""
        return {'frame': message.header.frame_id, 'direction': numbers(xyz(message.vector))}
