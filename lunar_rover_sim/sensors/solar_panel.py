"""A solar panel on the rover: the electric power that it gives in sunlight."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from typing import Any, TYPE_CHECKING

import numpy as np

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.image.illumination.sun_view import SeenSun
from lunar_rover_sim.sensors.power_monitor import supply_values
from lunar_rover_sim.sensors.sensor import POWER, Sensor, Supply

if TYPE_CHECKING:
    from lunar_rover_sim.rover.physics.state import RoverState


@dataclasses.dataclass(frozen=True)
class SolarPanelConfig(Parameters):
    """A flat panel that is fixed to the body.

    Twelve cells of the AZUR SPACE 3G30A, 26.51 cm2 each, which give 29.6 % of the sun's power at
    the beginning of their life, at 28 deg C (as the Iris mission states its cells).
    """

    rate_hz: int = param(5, 'its period is a whole number of state periods', unit='Hz', low=1,
                         high=1000)
    position_m: tuple[float, ...] = param((-0.1, 0.0, 0.06), 'in base_link', unit='m',
                                          length=3, low=-10.0, high=10.0)
    normal: tuple[float, ...] = param((0.0, 0.0, 1.0), 'in base_link, of any length',
                                      length=3, low=-1e3, high=1e3)
    area_m2: float = param(0.0318, 'of its cells', unit='m^2', low=0.0, high=100.0)
    efficiency: float = param(0.296, 'electric power over that of the sunlight', low=0.0, high=1.0)

    def validate(self) -> None:
        """Raise ConfigError if the panel looks nowhere."""
        if not any(self.normal):
            raise ConfigError(f'normal: {list(self.normal)} is not valid; valid is a direction')


def solar_power_w(config: SolarPanelConfig, sun: SeenSun | None, irradiance: float,
                  R_world_base: Array) -> float:
    """Return the electric power of a panel [W].

    It is irradiance x visible share of the disc x cosine of incidence x area x efficiency. Light
    of the ground, and how cells reflect grazing light and suffer from heat, are left out.

    Args:
        sun: What its place sees of the sun.
        irradiance: Normal, of the whole disc [W/m2].
        R_world_base: (3, 3) attitude of the rover.
    """
    if sun is None:
        return 0.0
    normal = R_world_base @ np.asarray(config.normal) / np.linalg.norm(config.normal)
    cosine = max(float(normal @ sun.direction), 0.0)
    return irradiance * sun.share * cosine * config.area_m2 * config.efficiency


class SolarPanel(Sensor):
    """The panel on the rover, seen from the supply of the motors."""

    name = 'solar_panel'
    parameters = SolarPanelConfig
    published = (topics.SOLAR_POWER,)
    content = POWER
    groups_as = 'power'

    def measure(self, state: RoverState, stamp_ns: int) -> Mapping[str, Supply]:
        """Return the supply by the panel."""
        platform = self.platform
        supply_v = platform.rover.motor.supply_voltage_v
        sun = platform.sun.seen(state, self.config.position_m, stamp_ns)
        power_w = solar_power_w(self.config, sun, platform.sun_config.irradiance,
                                state.T_world_base[:3, :3])
        return {topics.SOLAR_POWER.name: Supply(
            self.name, supply_v, power_w / supply_v, gives=True)}

    @classmethod
    def read(cls, topic: str, message: Any) -> dict[str, Any]:
        """Return voltage and current."""
        return supply_values(message)
