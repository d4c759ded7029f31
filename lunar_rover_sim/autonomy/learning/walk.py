"""`Walk`: follow velocity commands over terrain, by leg speeds at 50 Hz.

An action is added to the speeds that a gait asks of the legs (`residual`), or is the speeds
themselves (`speeds`). A residual of zero walks as that gait does, the packaged one or a tuned one,
so that learning starts from it and is measured against it. The gait follows at 200 Hz.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from lunar_rover_sim.autonomy.learning.follow import FollowConfig, FollowTask
from lunar_rover_sim.autonomy.learning.senses import Channel, of_legs, Sample, scaled, Upright
from lunar_rover_sim.autonomy.learning.task import Driver, STATE_HZ
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import group, param
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.gait.calibration import GaitCalibration
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.gait.controller import GaitController

RESIDUAL, SPEEDS = 'residual', 'speeds'
DECISION_NS = 20_000_000


@dataclasses.dataclass(frozen=True)
class WalkConfig(FollowConfig):
    """Parameters of `Walk`."""

    action: str = param(RESIDUAL, 'what an action is: residual to the leg speeds of the gait, or'
                        ' the leg speeds', choices=(RESIDUAL, SPEEDS))
    gait: GaitConfig = group(GaitConfig)
    speed_factor: float = param(1.0, 'factor on the commanded speed that the gait is given',
                                low=0.1, high=2.0)
    residual_radps: float = param(1.5, 'greatest residual', unit='rad/s', low=0.0, open_low=True,
                                  high=20.0)
    smoothing_s: float = param(0.0, 'time constant with which the legs follow an action, so that'
                               ' noise costs no energy; 0: at once', unit='s', low=0.0, high=10.0)
    fastest_radps: float = param(6.0, 'greatest leg speed where actions are speeds', unit='rad/s',
                                 low=0.0, open_low=True, high=50.0)


class WalkDriver(Driver):
    """Observations and leg speeds of `Walk`; those of the gait at each decision."""

    decision_ns, follow_ns = DECISION_NS, 1_000_000_000 // STATE_HZ

    def __init__(self, config: WalkConfig, rover: RoverDescription) -> None:
        """Walk with the gait of a rover on the ground of a task."""
        legs = rover.legs
        gait = config.gait.for_rover(rover)
        self._speed_factor = config.speed_factor
        self._residual = config.action == RESIDUAL
        self._scale = config.residual_radps if self._residual else config.fastest_radps
        self._share = (-math.expm1(-1e-9 * self.decision_ns / config.smoothing_s)
                       if config.smoothing_s > 0.0 else 1.0)
        self._gait = GaitController(
            gait, GaitCalibration.of(gait, config.ground, rover.name), legs)
        self._spokes = legs.spokes
        self._upright = Upright(rover)
        self._command = (0.0, 0.0)
        names = legs.names
        self.channels = (
            Channel('command_forward', 'm/s', 0.2), Channel('command_yaw_rate', 'rad/s', 0.5),
            *(Channel(f'rate_{axis}', 'rad/s', 1.0) for axis in 'xyz'),
            *(Channel(f'up_{axis}', '', 0.3) for axis in 'xy'),
            *of_legs('spoke_sin', '', 1.0, names), *of_legs('spoke_cos', '', 1.0, names),
            *of_legs('speed', 'rad/s', 5.0, names), *of_legs('torque', 'N m', 0.2, names),
            *of_legs('last_action', '', 1.0, names),
            *(of_legs('lead', 'rad', 0.3, names) if self._residual else ()))
        self.actions = tuple(of_legs('speed_residual' if self._residual else 'speed', 'rad/s',
                                     self._scale, names))
        self.reset()

    def reset(self) -> None:
        """Forget everything but the command."""
        self._gait.reset()
        self._upright.reset()
        self.action = np.zeros(len(self.actions))
        self._sample: Sample | None = None

    def set_velocity(self, forward_mps: float, yaw_rate_radps: float) -> None:
        """Set the velocity that is asked for."""
        self._command = (forward_mps, yaw_rate_radps)
        self._gait.set_velocity(self._speed_factor * forward_mps, yaw_rate_radps)

    def feel(self, sample: Sample) -> None:
        """Take in a sample, and let the gait answer it."""
        self._sample = sample
        self._upright.feel(sample)
        self._asked = self._gait.update(sample.stamp_ns, sample.angle_rad, sample.speed_radps)

    def observation(self) -> np.ndarray:
        """Return what a policy sees now, scaled."""
        sample = self._sample
        assert sample is not None       # `feel` comes first
        turned = self._spokes * sample.angle_rad
        lead = self._asked.angle_rad - sample.angle_rad if self._residual else ()
        return scaled([*self._command, *self._upright.rate_radps, *self._upright.up[:2],
                       *np.sin(turned), *np.cos(turned), *sample.speed_radps, *sample.torque_nm,
                       *self.action, *lead], self.channels)

    def decide(self, action: Array) -> None:
        """Take an action, (legs,) within -1 and 1; `action` follows it."""
        self.action = self.action + self._share * (action - self.action)

    def legs(self) -> tuple[Array, Array]:
        """Return leg speeds and reference angles."""
        speeds = self._scale * self.action
        if self._residual:
            speeds = speeds + self._asked.velocity_radps
        return speeds, self._asked.angle_rad


class Walk(FollowTask):
    """Follow velocity commands."""

    name = 'walk'
    config: WalkConfig
    driver: WalkDriver

    def make_driver(self) -> WalkDriver:
        """Return the driver of the rover as its file describes it."""
        return WalkDriver(self.config, self.rover)
