"""A thermometer on the deck: its plate radiates what it absorbs of the sun."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from typing import Any, TYPE_CHECKING

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.sensors.sensor import number, Platform, Sensor

if TYPE_CHECKING:
    from lunar_rover_sim.rover.physics.state import RoverState

_STEFAN_BOLTZMANN = 5.670374e-8     # W m^-2 K^-4 (CODATA 2018)
_KELVIN = 273.15                    # of 0 deg C


@dataclasses.dataclass(frozen=True)
class ThermometerConfig(Parameters):
    """A white plate on the deck; absorption, cold side and noise are choices."""

    rate_hz: int = param(10, 'its period is a whole number of state periods', unit='Hz', low=1,
                         high=1000)
    position_m: tuple[float, ...] = param((-0.1, 0.0, 0.06), 'in base_link', unit='m', length=3,
                                          low=-10.0, high=10.0)
    absorption: float = param(0.4, 'share of the sunlight that it takes, over its emissivity',
                              low=0.0, high=100.0)
    cold_k: float = param(100.0, 'its temperature in shadow', unit='K', low=0.0, high=1000.0)
    noise_k: float = param(0.1, 'standard deviation', unit='K', low=0.0, high=100.0)


class Thermometer(Sensor):
    """The temperature of the plate, which follows the light at once."""

    name = 'thermometer'
    parameters = ThermometerConfig
    published = (topics.THERMOMETER,)
    stream = 5

    def __init__(self, config: ThermometerConfig, platform: Platform) -> None:
        super().__init__(config, platform)
        self._rng = self.random_numbers()

    def measure(self, state: RoverState, stamp_ns: int) -> Mapping[str, Any]:
        """Return the fields of a sensor_msgs/Temperature [deg C]."""
        config, platform = self.config, self.platform
        sun = platform.sun.seen(state, config.position_m, stamp_ns)
        up = state.T_world_base[:3, 2]
        light = 0.0 if sun is None else max(0.0, sun.share * float(up @ sun.direction))
        absorbed = config.absorption * platform.sun_config.irradiance * light
        true_k = (absorbed / _STEFAN_BOLTZMANN + config.cold_k**4) ** 0.25
        return {topics.THERMOMETER.name: {
            'temperature': true_k - _KELVIN + config.noise_k * self._rng.standard_normal(),
            'variance': config.noise_k**2}}

    @classmethod
    def read(cls, topic: str, message: Any) -> dict[str, Any]:
        """Return the temperature of a sensor_msgs/Temperature."""
        return {'temperature_c': number(message.temperature)}
