"""Power monitors: supply voltage and current of the motors, as a measuring part gives them.

A motor's driver takes the electric power of the motor, i^2 R + torque times speed, out of the
supply: its current is that power over the supply voltage. What a braking motor gives is burnt in
the driver. The part measures the voltage over a shunt and that of the supply; each has a gain and
an offset, drawn once, is rounded to its step, and that of the shunt ends at its range:

    u~ = round(clip((1 + e) u + o, -range, range) / step) step
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.rover.description import Motor
from lunar_rover_sim.sensors.sensor import number, Platform, POWER, Sensor, Supply

if TYPE_CHECKING:
    from lunar_rover_sim.rover.physics.state import RoverState

# Of the INA226 (data sheet SBOS547B, 2024, typical values, which are taken for standard
# deviations): range and step of the shunt's voltage, step of that of the supply; the offset of
# each has a deviation of one step.
_SHUNT_RANGE_V, _SHUNT_STEP_V, _BUS_STEP_V = 0.08192, 2.5e-6, 1.25e-3


@dataclasses.dataclass(frozen=True)
class PowerMonitorConfig(Parameters):
    """Monitors of voltage and current in the supply line of each motor and of all of them.

    The part is a Texas Instruments INA226 with shunts of 20 mohm, for up to 4 A.
    """

    gone = {'shunt_range_v': 0.08192, 'shunt_step_v': 2.5e-6, 'shunt_offset_v': 2.5e-6,
            'bus_step_v': 1.25e-3, 'bus_offset_v': 1.25e-3}

    enabled: bool = param(True, 'false publishes the true values')
    shunt_ohm: float = param(0.02, 'shunt resistor', unit='ohm', low=0.0, open_low=True,
                             high=1000.0)
    gain_error: float = param(2e-4, 'standard deviation', low=0.0, high=0.5)


@dataclasses.dataclass(frozen=True)
class LinePower:
    """Voltages [V] and currents [A] of the lines: one for each motor, last that of them all.

    Current flows to the motors.
    """

    voltage_v: Array
    current_a: Array


class PowerMonitors:
    """Measures the lines of some motors.

    Args:
        motor: Each of them.
        motors: Their number.
        config: The parts.
        rng: Generator of gains and offsets, which are drawn once, here.
    """

    def __init__(self, motor: Motor, motors: int, config: PowerMonitorConfig,
                 rng: np.random.Generator) -> None:
        self._motor, self._config = motor, config
        count = motors + 1
        self._gain = 1.0 + config.gain_error * rng.standard_normal((2, count))
        self._shunt_offset_v = _SHUNT_STEP_V * rng.standard_normal(count)
        self._bus_offset_v = _BUS_STEP_V * rng.standard_normal(count)

    def measure(self, motor_torque_nm: ArrayLike, joint_velocity_radps: ArrayLike) -> LinePower:
        """Return what the parts show.

        Args:
            motor_torque_nm, joint_velocity_radps: (legs,) torques and speeds.
        """
        c, supply_v = self._config, self._motor.supply_voltage_v
        power_w = np.maximum(self._motor.electric_power_w(
            np.asarray(motor_torque_nm, float), np.asarray(joint_velocity_radps, float)), 0.0)
        current = np.append(power_w, power_w.sum()) / supply_v
        voltage = np.full(len(current), supply_v)
        if not c.enabled:
            return LinePower(voltage, current)
        shunt = np.clip(self._gain[0] * current * c.shunt_ohm + self._shunt_offset_v,
                        -_SHUNT_RANGE_V, _SHUNT_RANGE_V)
        return LinePower(
            _rounded(self._gain[1] * voltage + self._bus_offset_v, _BUS_STEP_V),
            _rounded(shunt, _SHUNT_STEP_V) / c.shunt_ohm)


def _rounded(values: Array, step: float) -> Array:
    return np.round(values / step) * step


def supply_values(message: Any) -> dict[str, Any]:
    """Return voltage and current of a sensor_msgs/BatteryState, for JSON."""
    return {'voltage_v': number(message.voltage), 'current_a': number(message.current)}


class SupplyLines(Sensor):
    """The monitors of the supply lines of the motors."""

    name = 'power_monitor'
    parameters = PowerMonitorConfig
    published = topics.POWER
    content = POWER
    groups_as = 'power'
    stream = 2

    def __init__(self, config: PowerMonitorConfig, platform: Platform) -> None:
        super().__init__(config, platform)
        self._monitors = PowerMonitors(platform.rover.motor, len(platform.rover.legs.each),
                                       config, self.random_numbers())

    def measure(self, state: RoverState, stamp_ns: int) -> Mapping[str, Supply]:
        """Return the supply of each line in the interval that the state ends."""
        shown = self._monitors.measure(state.motor_torque_nm, state.joint_velocity_radps)
        return {topic.name: Supply(topic.name.rpartition('/')[2], float(voltage_v),
                                   -float(current_a))
                for topic, voltage_v, current_a in zip(
                    self.offered, shown.voltage_v, shown.current_a)}

    @classmethod
    def read(cls, topic: str, message: Any) -> dict[str, Any]:
        """Return voltage and current."""
        return supply_values(message)
