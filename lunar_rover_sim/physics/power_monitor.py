"""Power monitors: supply voltage and current of the motors, as a measuring part gives them.

A motor's driver takes the electric power of the motor, i^2 R + torque times speed, out of the
supply: its current is that power over the supply voltage. What a braking motor gives is burnt in
the driver. The part measures the voltage over a shunt and that of the supply; each has a gain and
an offset, drawn once, is rounded to its step, and that of the shunt ends at its range:

    u~ = round(clip((1 + e) u + o, -range, range) / step) step
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.frames import Array
from lunar_rover_sim.physics.config import PowerMonitorConfig
from lunar_rover_sim.rover.description import LEG_NAMES, Motor

# The lines, in the order of the measured values: one per motor, and the one that feeds them all.
LINES = (*LEG_NAMES, 'bus')


@dataclasses.dataclass(frozen=True)
class LinePower:
    """Voltages [V] and currents [A] of the lines, (5,) in the order of LINES.

    Current flows to the motors.
    """

    voltage_v: Array
    current_a: Array


class PowerMonitors:
    """Measures the lines. rng: generator of gains and offsets, which are drawn here."""

    def __init__(self, motor: Motor, config: PowerMonitorConfig,
                 rng: np.random.Generator) -> None:
        self._motor, self._config = motor, config
        count = len(LINES)
        self._gain = 1.0 + config.gain_error * rng.standard_normal((2, count))
        self._shunt_offset_v = config.shunt_offset_v * rng.standard_normal(count)
        self._bus_offset_v = config.bus_offset_v * rng.standard_normal(count)

    def measure(self, motor_torque_nm: ArrayLike, joint_velocity_radps: ArrayLike) -> LinePower:
        """Return what the parts show.

        motor_torque_nm, joint_velocity_radps: (4,) torques and speeds of the legs
        """
        c, supply_v = self._config, self._motor.supply_voltage_v
        power_w = np.maximum(self._motor.electric_power_w(
            np.asarray(motor_torque_nm, float), np.asarray(joint_velocity_radps, float)), 0.0)
        current = np.append(power_w, power_w.sum()) / supply_v
        voltage = np.full(len(LINES), supply_v)
        if not c.enabled:
            return LinePower(voltage, current)
        shunt = np.clip(self._gain[0] * current * c.shunt_ohm + self._shunt_offset_v,
                        -c.shunt_range_v, c.shunt_range_v)
        return LinePower(
            _rounded(self._gain[1] * voltage + self._bus_offset_v, c.bus_step_v),
            _rounded(shunt, c.shunt_step_v) / c.shunt_ohm)


def _rounded(values: Array, step: float) -> Array:
    return np.round(values / step) * step if step > 0.0 else values
