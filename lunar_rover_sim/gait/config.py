"""Parameters of the gait."""

from __future__ import annotations

import dataclasses
import math
from typing import TypeVar

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.gait.shaping import ShapingFunction
from lunar_rover_sim.parameters import param, Parameters
from lunar_rover_sim.rover.description import Legs, RoverDescription

G = TypeVar('G', bound='GaitConfig')

PACKAGED_SPOKES = Legs().spokes     # for a gait that no rover is named for

# Phase offsets [cycles] of front_left, front_right, rear_left, rear_right.
GAIT_ARRAYS: dict[str, tuple[float, float, float, float]] = {
    'trot': (0.0, 0.5, 0.5, 0.0),
    'pace': (0.0, 0.5, 0.0, 0.5),
    'bound': (0.0, 0.0, 0.5, 0.5),
    'crawl': (0.0, 0.5, 0.75, 0.25),
}


@dataclasses.dataclass(frozen=True)
class GaitConfig(Parameters):
    """How the legs move; all but `spokes` and `calibration` may change while the rover walks."""

    spokes: int = param(0, 'spokes per leg, one cycle turns a leg by 360 / spokes; 0: those of '
                        'the rover', low=0, high=12)
    duty_factor: float = param(0.6, 'share of the cycle that a leg is in stance', low=0.0,
                               high=1.0, open_low=True, open_high=True, live=True)
    foot_width_deg: float = param(60.0, 'angle swept in stance, less than the spoke pitch',
                                  unit='deg', low=0.0, high=180.0, open_low=True, live=True)
    # Feet that share the load should have one speed: with uniform stances the rover walks far more
    # evenly.
    stance_smoothing: float = param(0.05, 'share of the stance with changing slope', low=0.0,
                                    high=1.0, live=True)
    flight_smoothing: float = param(1.0, 'share of the flight with changing slope', low=0.0,
                                    high=1.0, live=True)
    gait: str = param('trot', 'phase offsets by name; custom takes phase_offsets',
                      choices=(*GAIT_ARRAYS, 'custom'), live=True)
    phase_offsets: tuple[float, ...] = param(
        (0.0, 0.5, 0.5, 0.0), 'offsets of front_left, front_right, rear_left, rear_right, used by'
        ' gait custom; below 1', unit='cycles', low=0.0, high=1.0, length=4, live=True)
    phase_gain: float = param(2.0, 'phase rate of a leg per phase error',
                              unit='1/s', low=0.0, high=50.0, live=True)
    position_gain: float = param(8.0, 'velocity command per angle error', unit='1/s', low=0.0,
                                 high=100.0, live=True)
    velocity_gain: float = param(0.2, 'velocity command per velocity error of the motor',
                                 low=0.0, high=5.0, live=True)
    max_angle_lead_deg: float = param(25.0, 'a reference that leads a blocked leg by this'
                                      ' angle waits for it', unit='deg', low=0.0, high=90.0,
                                      open_low=True, live=True)
    max_phase_rate_hz: float = param(2.2, 'greatest phase rate', unit='Hz', low=0.0, high=10.0,
                                     open_low=True, live=True)
    max_yaw_rate_radps: float = param(0.6, 'greatest yaw rate; faster turns shake the rover',
                                      unit='rad/s', low=0.0, high=5.0, open_low=True, live=True)
    phase_acceleration_hzps: float = param(2.0, 'greatest change of the phase rate', unit='Hz/s',
                                           low=0.0, high=100.0, open_low=True, live=True)
    settle_rate_hz: float = param(0.5, 'greatest phase rate of legs that come to a stand',
                                  unit='Hz', low=0.0, high=5.0, open_low=True, live=True)
    max_joint_velocity_radps: float = param(20.0, 'greatest velocity command', unit='rad/s',
                                            low=0.0, high=200.0, open_low=True, live=True)
    blend_time_s: float = param(0.5, 'time in which a change of parameters or turn takes effect',
                                unit='s', low=0.0, high=10.0, open_low=True, live=True)
    cmd_timeout_s: float = param(0.5, 'a velocity command older than this stops the rover',
                                 unit='s', low=0.0, open_low=True, live=True)
    calibration: str = param('', 'measured map from velocity to gait: a file, or packaged for a'
                             ' ground, rigid or highland; empty: in a run that of its ground,'
                             ' else rigid')

    def validate(self) -> None:
        """Raise ConfigError where duty, foot width, smoothing or offsets are not compatible."""
        if self.spokes == 1:
            raise ConfigError('spokes: 1 is not valid; valid is 0, or 2 to 12')
        self.shaping()
        for offset in self.phase_offsets:
            if offset >= 1.0:
                raise ConfigError(f'phase_offsets: {offset:g} is not valid; valid is >= 0 and < 1'
                                  ' [cycles]')

    @property
    def pitch_rad(self) -> float:
        """Angle between neighbouring spokes [rad]."""
        return 2.0 * math.pi / (self.spokes or PACKAGED_SPOKES)

    @property
    def offsets(self) -> tuple[float, ...]:
        """Phase offsets [cycles] of the four legs, by name or custom."""
        return GAIT_ARRAYS.get(self.gait, self.phase_offsets)

    def for_rover(self: G, rover: RoverDescription) -> G:
        """Return the parameters with the number of spokes that the rover's legs have.

        Raises ConfigError if the parameters name another number, or if the foot width is not
        compatible with it.
        """
        spokes = rover.legs.spokes
        if self.spokes not in (0, spokes):
            raise ConfigError(f'spokes: {self.spokes} is not valid for the gait; valid is '
                              f"{spokes}, as many as the rover's legs have, or 0")
        return dataclasses.replace(self, spokes=spokes)

    def shaping(self) -> ShapingFunction:
        """Return the shaping function of these parameters."""
        return ShapingFunction(self.duty_factor, math.radians(self.foot_width_deg),
                               self.stance_smoothing, self.flight_smoothing, self.pitch_rad)
