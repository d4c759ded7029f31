"""An inclinometer: noisy roll and pitch of the rover."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from typing import Any, TYPE_CHECKING

import numpy as np

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import rpy_from_wxyz
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.sensors.sensor import numbers, Platform, Sensor, Vector

if TYPE_CHECKING:
    from lunar_rover_sim.rover.physics.state import RoverState


@dataclasses.dataclass(frozen=True)
class InclinometerConfig(Parameters):
    """An inclinometer at base_link."""

    rate_hz: int = param(10, 'its period is a whole number of state periods', unit='Hz', low=1,
                         high=1000)
    noise_deg: float = param(0.1, 'standard deviation per axis', unit='deg', low=0.0, high=10.0)


class Inclinometer(Sensor):
    """Roll and pitch with noise."""

    name = 'inclinometer'
    parameters = InclinometerConfig
    published = (topics.INCLINOMETER,)
    stream = 5

    def __init__(self, config: InclinometerConfig, platform: Platform) -> None:
        super().__init__(config, platform)
        self._rng = self.random_numbers()

    def measure(self, state: RoverState, stamp_ns: int) -> Mapping[str, Vector]:
        """Return roll and pitch in x and y [rad]."""
        tilt = rpy_from_wxyz(state.orientation_wxyz)[:2]
        noise = np.radians(self.config.noise_deg) * self._rng.standard_normal(2)
        return {topics.INCLINOMETER.name: Vector(np.append(tilt + noise, 0.0))}

    @classmethod
    def read(cls, topic: str, message: Any) -> dict[str, Any]:
        """Return roll and pitch of a geometry_msgs/Vector3Stamped."""
        return {'tilt_rad': numbers((message.vector.x, message.vector.y))}
