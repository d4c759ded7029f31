"""`Gait`: the parameters of the gait as the action, at 5 Hz; the gait itself walks at 200 Hz.

An action of zero is the packaged gait. The phase offsets of all legs but the first one, duty
factor, foot width, smoothing, gains and a factor on the commanded speed are free.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from lunar_rover_sim.autonomy.learning.follow import FollowConfig, FollowTask
from lunar_rover_sim.autonomy.learning.senses import Channel, of_legs, Sample, scaled, Upright
from lunar_rover_sim.autonomy.learning.task import Driver, STATE_HZ
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import param
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.gait.calibration import GaitCalibration
from lunar_rover_sim.rover.gait.config import CUSTOM, GaitConfig
from lunar_rover_sim.rover.gait.controller import GaitController

# Offset, scale, and bounds of the values; the offset is the packaged gait's.
_SHAPE = {'duty_factor': (0.25, 0.35, 0.85), 'foot_width_deg': (45.0, 15.0, 105.0),
          'stance_smoothing': (0.5, 0.0, 1.0), 'flight_smoothing': (0.8, 0.2, 1.0),
          'position_gain': (8.0, 0.5, 40.0), 'velocity_gain': (0.6, 0.0, 2.0)}
_UNITS = {'foot_width_deg': 'deg', 'position_gain': '1/s'}
_SPEED_FACTOR = 0.5


@dataclasses.dataclass(frozen=True)
class GaitTaskConfig(FollowConfig):
    """Parameters of `Gait`."""

    decision_hz: int = param(5, 'rate of decisions; a divisor of 200', unit='Hz', low=1, high=50)

    def validate(self) -> None:
        """Raise ConfigError for a period of no whole number of states, or a range upside down."""
        super().validate()
        if STATE_HZ % self.decision_hz:
            raise ConfigError(f'decision_hz: {self.decision_hz} is not valid; valid is a divisor '
                              f'of {STATE_HZ} [Hz]')


class GaitDriver(Driver):
    """Observations of `Gait`, and the gait that its actions shape."""

    follow_ns = 1_000_000_000 // STATE_HZ

    def __init__(self, config: GaitTaskConfig, rover: RoverDescription) -> None:
        """Walk with the gait of a rover on the ground of a task."""
        legs = rover.legs
        gait = GaitConfig().for_rover(rover)
        self._packaged = dataclasses.replace(gait, gait=CUSTOM, phase_offsets=gait.offsets(legs))
        self._gait = GaitController(
            self._packaged, GaitCalibration.of(gait, config.ground, rover.name), legs)
        self._upright = Upright(rover)
        self._motor = rover.motor
        self._command = (0.0, 0.0)
        self.decision_ns = 1_000_000_000 // config.decision_hz
        names = legs.names
        self.actions = (
            *(Channel(name, _UNITS.get(name, ''), scale, getattr(gait, name))
              for name, (scale, _, _) in _SHAPE.items()),
            Channel('speed_factor', '', _SPEED_FACTOR, 1.0),
            *(Channel(f'phase/{leg}', 'cycles', 0.5, offset)
              for leg, offset in zip(names[1:], self._packaged.phase_offsets[1:])))
        self.channels = (
            Channel('command_forward', 'm/s', 0.2), Channel('command_yaw_rate', 'rad/s', 0.5),
            *(Channel(f'up_{axis}', '', 0.3) for axis in 'xy'),
            *(Channel(f'rate_rms_{axis}', 'rad/s', 0.5) for axis in 'xyz'),
            Channel('power', 'W', 1.0), *of_legs('torque_rms', 'N m', 0.2, names),
            *(Channel(f'last_{channel.name}', '', 1.0) for channel in self.actions))
        self.reset()

    def reset(self) -> None:
        """Forget everything but the command."""
        self._gait.configure(self._packaged)
        self._gait.reset()
        self._upright.reset()
        self.action = np.zeros(len(self.actions))
        self._factor = 1.0
        self._forget()
        self.set_velocity(*self._command)

    def set_velocity(self, forward_mps: float, yaw_rate_radps: float) -> None:
        """Set the velocity that is asked for."""
        self._command = (forward_mps, yaw_rate_radps)
        self._gait.set_velocity(forward_mps * self._factor, yaw_rate_radps)

    def feel(self, sample: Sample) -> None:
        """Take in a sample, and let the gait answer it."""
        self._upright.feel(sample)
        self._rates += self._upright.rate_radps ** 2
        self._torques += sample.torque_nm ** 2
        self._power += self._motor.drawn_w(sample.torque_nm, sample.speed_radps)
        self._count += 1
        self._asked = self._gait.update(sample.stamp_ns, sample.angle_rad, sample.speed_radps)

    def observation(self) -> np.ndarray:
        """Return what a policy sees now: means since the last decision, scaled."""
        n = max(1, self._count)
        return scaled([*self._command, *self._upright.up[:2], *np.sqrt(self._rates / n),
                       self._power / n, *np.sqrt(self._torques / n), *self.action], self.channels)

    def decide(self, action: Array) -> None:
        """Take an action, and shape the gait by it."""
        self._forget()
        if np.array_equal(action, self.action):
            return
        self.action = action
        config, self._factor = gait_of(action, self.actions, self._packaged)
        self._gait.configure(config)
        self.set_velocity(*self._command)

    def legs(self) -> tuple[Array, Array]:
        """Return leg speeds and reference angles."""
        return self._asked.velocity_radps, self._asked.angle_rad

    def _forget(self) -> None:
        self._rates, self._torques = np.zeros(3), np.zeros(len(self._packaged.phase_offsets))
        self._power, self._count = 0.0, 0


def gait_of(action: Array, actions: tuple[Channel, ...],
            packaged: GaitConfig) -> tuple[GaitConfig, float]:
    """Return the gait that an action means, and its factor on the commanded speed."""
    values = {channel.name: channel.offset + channel.scale * number
              for channel, number in zip(actions, action.tolist())}
    shape = {name: min(max(values[name], low), high) for name, (_, low, high) in _SHAPE.items()}
    phases = [value % 1.0 for name, value in values.items() if name.startswith('phase/')]
    return dataclasses.replace(
        packaged, phase_offsets=(packaged.phase_offsets[0], *phases), **shape
        ), values['speed_factor']


class Gait(FollowTask):
    """Choose the parameters of the gait."""

    name = 'gait'
    config: GaitTaskConfig
    driver: GaitDriver

    def make_driver(self) -> GaitDriver:
        """Return the driver of the rover as its file describes it."""
        return GaitDriver(self.config, self.rover)
