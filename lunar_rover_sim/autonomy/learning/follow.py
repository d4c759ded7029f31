"""What `Walk` and `Gait` have in common: velocity commands, and the reward of following them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from lunar_rover_sim.autonomy.learning.randomisation import check_ranges, even
from lunar_rover_sim.autonomy.learning.task import RoverTask, TaskConfig
from lunar_rover_sim.base.parameters import param
from lunar_rover_sim.rover.physics.state import RoverState


@dataclasses.dataclass(frozen=True)
class FollowConfig(TaskConfig):
    """Parameters of tasks that follow velocity commands.

    A policy is offered for the ranges of speed and yaw rate that it was trained on.
    """

    forward_mps: tuple[float, ...] = param((0.06, 0.16), 'commanded speed, least and greatest',
                                           unit='m/s', length=2, low=0.0, high=0.6)
    yaw_rate_radps: tuple[float, ...] = param(
        (-0.2, 0.2), 'commanded yaw rate, least and greatest', unit='rad/s', length=2, low=-1.0,
        high=1.0)
    command_s: float = param(6.0, 'time for which a command holds', unit='s', low=0.1)
    tracking_s: float = param(0.6, 'time constant over which velocity, power and shaking are'
                              ' judged: about one cycle of the gait', unit='s', low=0.01,
                              high=10.0)
    yaw_lever_m: float = param(0.3, 'speed that counts as much as a yaw rate of 1 rad/s',
                               unit='m', low=0.0)
    least_mps: float = param(0.02, 'a slower command is judged as if it were as fast; that of'
                             ' zero is answered best by standing', unit='m/s', low=0.0,
                             open_low=True)
    energy_weight: float = param(0.5, 'the reward is divided by 1 + power over weight times'
                                 ' commanded speed, to this power', low=0.0)
    shaking_weight: float = param(1.0, 'the reward falls to 1/e where this times the squared'
                                  ' pitch and roll rates is 1', unit='s^2/rad^2', low=0.0)

    def validate(self) -> None:
        """Raise ConfigError for a range that is upside down."""
        check_ranges(self, 'forward_mps', 'yaw_rate_radps')


class FollowTask(RoverTask):
    """Follow velocity commands.

    The reward of a second is the share of the commanded velocity that is reached, of which energy
    and shaking leave a part. So it is at most 1, standing has none, and going elsewhere costs up
    to 1. The return of an episode is a number of seconds.
    """

    config: FollowConfig

    @property
    def commanded(self) -> tuple[float, float]:
        """The velocity that is asked for: forward [m/s] and yaw rate [rad/s]."""
        return self._commanded

    def begin(self, rng: np.random.Generator) -> None:
        """Draw the first command."""
        # Forward velocity, yaw rate, power, and squared pitch and roll rates, as they are judged.
        self._judged = np.zeros(4)
        self._time_s = self._command_s = 0.0
        self._draw_command(rng)

    def watch(self, state: RoverState, interval_s: float) -> None:
        """Follow velocity, power and shaking."""
        roll, pitch, yaw = state.angular_velocity_radps.tolist()
        now = (state.linear_velocity_mps[0], yaw, self.power_w(state), roll * roll + pitch * pitch)
        self._judged += -math.expm1(-interval_s / self.config.tracking_s) * (now - self._judged)
        self._time_s += interval_s

    def reward(self) -> float:
        """Return the reward of the decision that is over; draw the next command in its time."""
        c, (forward, yaw_rate, power_w, shaking) = self.config, self._judged.tolist()
        asked_mps, asked_radps = self._commanded
        asked = max(math.hypot(asked_mps, c.yaw_lever_m * asked_radps), c.least_mps)
        missed = math.hypot(forward - asked_mps, c.yaw_lever_m * (yaw_rate - asked_radps))
        share = max(1.0 - missed / asked, -1.0)
        if share > 0.0:
            share *= ((1.0 + power_w / (self.weight_n * asked)) ** -c.energy_weight
                      * math.exp(-c.shaking_weight * shaking))
        total, self._time_s = share * self._time_s, 0.0
        if self.state.stamp_ns * 1e-9 >= self._command_s + c.command_s:
            self._command_s = self.state.stamp_ns * 1e-9
            self._draw_command(self._rng)
        return total

    def _draw_command(self, rng: np.random.Generator) -> None:
        self._commanded = (even(rng, self.config.forward_mps),
                           even(rng, self.config.yaw_rate_radps))
        self.driver.set_velocity(*self._commanded)
