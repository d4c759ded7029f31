"""The phases of the legs, which follow one clock at the offsets of the gait."""

from __future__ import annotations

from collections.abc import Sequence
import math

from lunar_rover_sim.gait.config import GaitConfig
from lunar_rover_sim.gait.stride import Stride

SETTLE_GAIN = 3.0   # phase rate per phase error when standing [1/s]
_AGILITY = 4.0      # factor by which legs may change their rate faster than the clock
# Bounds on the rate that corrects the phase of a leg: back and ahead, as shares of the clock's
# rate, and ahead in Hz. A leg that is early slows down but never turns back.
_BACK, _AHEAD, _AHEAD_HZ = 0.75, 0.5, 0.2


class LegPhases:
    """One phase per leg [cycles, unwrapped], each with a rate of its own.

    While walking, leg i converges to the nearest phase equal to direction * (clock + offset i)
    modulo 1, at a bounded rate, from any start, after a block and after a change of gait. While
    standing, it converges to the nearest whole phase, where a spoke points straight down. Phases
    never jump, and rates change with bounded acceleration.
    """

    def __init__(self, on_left: Sequence[bool]) -> None:
        """Start at rest; on_left: which legs are on the left."""
        self._on_left = tuple(on_left)
        self.phase = [0.0] * len(on_left)   # [cycles]
        self.rate = [0.0] * len(on_left)    # [Hz]
        self._clock = 0.0        # [cycles]
        self._clock_rate = 0.0   # [Hz], >= 0
        self._walking = False

    def start(self, phase: Sequence[float]) -> None:
        """Start at rest from the phases of the legs."""
        self.phase = list(phase)

    def advance(self, dt: float, config: GaitConfig, stride: Stride,
                offsets: Sequence[float]) -> None:
        """Advance by dt [s] with the rate and the directions of a stride, at phase offsets."""
        step = config.phase_acceleration_hzps * dt
        self._clock_rate += _clip(stride.phase_rate_hz - self._clock_rate, -step, step)
        direction = [math.copysign(1.0, stride.left_sweep if left else stride.right_sweep)
                     for left in self._on_left]
        if stride.stands:
            target = [_clip(-SETTLE_GAIN * _wrap(phase), -config.settle_rate_hz,
                            config.settle_rate_hz) for phase in self.phase]
        else:
            if not self._walking:
                self._clock = self._nearest_clock(direction, offsets)
            self._clock += self._clock_rate * dt
            target = []
            for sign, offset, phase in zip(direction, offsets, self.phase):
                error = sign * _wrap(sign * (self._clock + offset) - phase)
                pull = _clip(config.phase_gain * error, -_BACK * self._clock_rate,
                             _AHEAD * self._clock_rate + _AHEAD_HZ)
                target.append(sign * (self._clock_rate + pull))
        self._walking = not stride.stands
        for leg in range(len(target)):
            self.rate[leg] += _clip(target[leg] - self.rate[leg], -_AGILITY * step,
                                    _AGILITY * step)
            self.phase[leg] += self.rate[leg] * dt

    def _nearest_clock(self, direction: Sequence[float], offsets: Sequence[float]) -> float:
        """Return the clock [cycles] with the least sum of squared phase errors of the legs."""
        def error(clock: float) -> float:
            return sum(_wrap(sign * (clock + offset) - phase) ** 2
                       for sign, offset, phase in zip(direction, offsets, self.phase))

        return min((k / 64.0 for k in range(64)), key=error)


def _wrap(phase: float) -> float:
    """Return a phase wrapped to [-1/2, 1/2)."""
    return (phase + 0.5) % 1.0 - 0.5


def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
