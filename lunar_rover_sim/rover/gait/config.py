"""Parameters of the gait."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import math
from typing import NamedTuple, TypeVar

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.rover.description import Legs, RoverDescription
from lunar_rover_sim.rover.gait.shaping import ShapingFunction

G = TypeVar('G', bound='GaitConfig')

PACKAGED_SPOKES = Legs().spokes     # for a gait that no rover is named for


class Gait(NamedTuple):
    """A gait by name.

    Attributes:
        meaning: In words, for the description of the parameter.
        offset: Phase offset [cycles] of a leg by its side (0 left, 1 right), its number from the
            front on that side, from 0, and the number of legs there.
    """

    meaning: str
    offset: Callable[[int, int, int], float]


GAITS: dict[str, Gait] = {
    'trot': Gait('alternates neighbours (with six legs, tripods)',
                 lambda side, row, rows: 0.5 * ((side + row) % 2)),
    'pace': Gait('alternates sides', lambda side, row, rows: 0.5 * side),
    'bound': Gait('alternates pairs of a left and a right leg',
                  lambda side, row, rows: 0.5 * (row % 2)),
    'crawl': Gait('lifts one leg after the other',
                  lambda side, row, rows: (0.5 * side - row / (2.0 * rows)) % 1.0),
}
OWN, CUSTOM = 'rover', 'custom'


@dataclasses.dataclass(frozen=True)
class GaitConfig(Parameters):
    """How the legs move; all but `spokes` and `calibration` may change while the rover walks."""

    spokes: int = param(0, 'per leg; one cycle turns a leg by 360 / spokes; 0: those of the rover',
                        low=0, high=12)
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
    gait: str = param(OWN, 'phase offsets by name: rover has those of the rover, '
                      + ', '.join(f'{name} {gait.meaning}' for name, gait in GAITS.items())
                      + ', custom takes phase_offsets', choices=(OWN, *GAITS, CUSTOM), live=True)
    phase_offsets: tuple[float, ...] = param(
        (0.0, 0.5, 0.5, 0.0), 'of each leg, for gait custom', unit='cycles', low=0.0,
        high=1.0, open_high=True, live=True)
    phase_gain: float = param(2.0, 'phase rate of a leg per phase error',
                              unit='1/s', low=0.0, high=50.0, live=True)
    position_gain: float = param(8.0, 'velocity command per angle error', unit='1/s', low=0.0,
                                 high=100.0, live=True)
    velocity_gain: float = param(0.2, 'velocity command per velocity error of the motor',
                                 low=0.0, high=5.0, live=True)
    max_angle_lead_deg: float = param(25.0, 'a reference that leads a blocked leg by this'
                                      ' angle waits for it', unit='deg', low=0.0, high=90.0,
                                      open_low=True, live=True)
    max_flight_lead_radps: float = param(
        0.7, 'a leg in flight is driven at most this much faster than it turns',
        unit='rad/s', low=0.0, high=200.0, open_low=True, live=True)
    max_phase_rate_hz: float = param(2.2, 'greatest phase rate', unit='Hz', low=0.0, high=10.0,
                                     open_low=True, live=True)
    max_yaw_rate_radps: float = param(0.6, 'faster turns shake the rover',
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
    calibration: str = param('', 'map from velocity to gait: a file, or packaged rigid or '
                             'highland; empty: in a run that of its ground, else rigid')

    def validate(self) -> None:
        """Raise ConfigError where duty, foot width, smoothing or offsets are not compatible."""
        if self.spokes == 1:
            raise ConfigError('spokes: 1 is not valid; valid is 0, or 2 to 12')
        self.shaping()

    @property
    def pitch_rad(self) -> float:
        """Angle between neighbouring spokes [rad]."""
        return 2.0 * math.pi / (self.spokes or PACKAGED_SPOKES)

    def offsets(self, legs: Legs) -> tuple[float, ...]:
        """Return the phase offsets [cycles] of the legs of a rover.

        Raises:
            ConfigError: If they are custom and not one for each leg.
        """
        if self.gait == OWN:
            return tuple(leg.phase for leg in legs.each.values())
        if self.gait in GAITS:
            sides = [0 if left else 1 for left in legs.on_left]
            return tuple(GAITS[self.gait].offset(side, row, sides.count(side))
                         for side, row in zip(sides, legs.rows()))
        if len(self.phase_offsets) != len(legs.each):
            raise ConfigError(f'phase_offsets: {len(self.phase_offsets)} elements given; valid is '
                              f'one for each leg of the rover: {", ".join(legs.names)}')
        return self.phase_offsets

    def for_rover(self: G, rover: RoverDescription) -> G:
        """Return the parameters with the number of spokes that the rover's legs have.

        Raises:
            ConfigError: If the parameters name another number, if the foot width is not compatible
                with it, or if phase offsets are not one for each leg.
        """
        spokes = rover.legs.spokes
        if self.spokes not in (0, spokes):
            raise ConfigError(f'spokes: {self.spokes} is not valid for the gait; valid is '
                              f"{spokes}, as many as the rover's legs have, or 0")
        self.offsets(rover.legs)
        return dataclasses.replace(self, spokes=spokes)

    def shaping(self) -> ShapingFunction:
        """Return the shaping function of these parameters."""
        return ShapingFunction(self.duty_factor, math.radians(self.foot_width_deg),
                               self.stance_smoothing, self.flight_smoothing, self.pitch_rad)
