"""Observations of a policy: the messages of a rover at one stamp, and what follows from them.

The environments and `policy_node` make their observations here, so that both are one.
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses

import numpy as np

from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, wxyz_from_rpy
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.physics.state import RoverState
from lunar_rover_sim.sensors.imu import ImuNoise

LIMIT = 10.0            # of a scaled observation: what is beyond is cut off
UPRIGHT_S = 1.0         # time constant with which the accelerometer corrects the attitude


@dataclasses.dataclass(frozen=True)
class Channel:
    """One number of an observation or an action.

    Attributes:
        name: What it is; that of a leg ends in `/LEG`.
        unit: Of `value = offset + scale * number`.
        scale: That factor; a policy sees and returns numbers of about 1.
        offset: The value for which the number is 0.
    """

    name: str
    unit: str
    scale: float
    offset: float = 0.0


def of_legs(name: str, unit: str, scale: float, legs: Sequence[str]) -> list[Channel]:
    """Return a channel for each leg."""
    return [Channel(f'{name}/{leg}', unit, scale) for leg in legs]


@dataclasses.dataclass(frozen=True)
class Sample:
    """What `joint_states` and `imu/data_raw` say at one stamp.

    Attributes:
        stamp_ns: Of both messages.
        angle_rad: (legs,) leg angles, unwrapped.
        speed_radps: (legs,) leg speeds.
        torque_nm: (legs,) motor torques at the leg, means since the state before.
        rate_radps: (3,) of the gyroscope, IMU axes.
        force_mps2: (3,) specific force, IMU axes; +g upwards at rest.
    """

    stamp_ns: int
    angle_rad: Array
    speed_radps: Array
    torque_nm: Array
    rate_radps: Array
    force_mps2: Array

    @classmethod
    def of(cls, state: RoverState, noise: ImuNoise | None = None) -> Sample:
        """Return what the messages of a state say, with the noise of an IMU or without."""
        force, rate = state.specific_force_mps2, state.imu_rate_radps
        if noise is not None:
            measured = noise.measure(force, rate)
            force, rate = measured.specific_force, measured.rate
        return cls(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps,
                   state.motor_torque_nm, rate, force)


class Upright:
    """The direction upwards in base axes, from the IMU alone: a complementary filter.

    The gyroscope turns it, and the specific force, which points upwards in the mean, pulls it back
    within `UPRIGHT_S` (Mahony, Hamel and Pflimlin, IEEE T-AC 53(5), 2008, eq. 10, without bias).
    """

    def __init__(self, rover: RoverDescription) -> None:
        self._R_base_imu = matrix_from_wxyz(wxyz_from_rpy(*np.radians(rover.imu.rpy_deg)))
        self.reset()

    def reset(self) -> None:
        """Forget: the next sample starts from its specific force."""
        self._last_ns: int | None = None
        self.up = np.array([0.0, 0.0, 1.0])
        self.rate_radps = np.zeros(3)

    def feel(self, sample: Sample) -> None:
        """Take a sample in; `up` (3,) and `rate_radps` (3,), base axes, are those of its stamp."""
        self.rate_radps = self._R_base_imu @ sample.rate_radps
        force = self._R_base_imu @ sample.force_mps2
        norm = float(np.sqrt(force @ force))
        measured = force / norm if norm > 1e-6 else self.up
        if self._last_ns is None:
            self.up = measured
        else:
            step_s = (sample.stamp_ns - self._last_ns) * 1e-9
            (a, b, c), (p, q, r) = self.up.tolist(), (self.rate_radps * step_s).tolist()
            # up x rate: the world turns against the body.
            turned = self.up + np.array([b * r - c * q, c * p - a * r, a * q - b * p])
            up = turned + min(1.0, step_s / UPRIGHT_S) * (measured - turned)
            self.up = up / float(np.sqrt(up @ up))
        self._last_ns = sample.stamp_ns


def scaled(values: Sequence[float] | Array, channels: Sequence[Channel]) -> np.ndarray:
    """Return values in their units as float32 numbers of channels without offsets, cut off."""
    numbers = np.asarray(values, float) / np.array([channel.scale for channel in channels])
    return np.minimum(np.maximum(numbers, -LIMIT), LIMIT).astype(np.float32)
