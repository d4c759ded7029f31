"""The shaping function: from the phase of a leg to its angle, with an analytic slope."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.errors import ConfigError

Array = NDArray[np.float64]


class ShapingFunction:
    """Maps phase [cycles] to leg angle [rad]; one cycle turns the leg by one spoke pitch.

    Phase 0 is the middle of stance: a spoke points straight down (angle 0). Stance is
    |phase| <= duty / 2, where the angle runs from -foot_width / 2 to +foot_width / 2; flight is
    the rest of the cycle and brings the next spoke into the same place. The function is odd, so
    walking backward is the same motion in reverse, and angle(phase + 1) = angle(phase) + pitch.

    The slope is a trapezium with raised-cosine flanks in each segment. `stance_smoothing` and
    `flight_smoothing` (0 to 1) are the shares of the segment taken by its flanks; all flanks meet
    at one slope, so angle and slope are continuous everywhere. With no stance smoothing the foot
    moves uniformly through the whole stance, and flight alone changes speed.

    Raises ConfigError where duty is not inside (0, 1), the foot width not inside (0, pitch), a
    smoothing outside [0, 1], or both smoothings zero (the slope would jump).
    """

    def __init__(self, duty: float, foot_width_rad: float, stance_smoothing: float,
                 flight_smoothing: float, pitch_rad: float = 2.0 * math.pi / 3.0) -> None:
        if not 0.0 < duty < 1.0:
            raise ConfigError(f'duty_factor: {duty:g} is not valid; valid is > 0 and < 1')
        if not 0.0 < foot_width_rad < pitch_rad:
            raise ConfigError(
                f'foot_width_deg: {math.degrees(foot_width_rad):g} is not valid; valid is > 0 and'
                f' < {math.degrees(pitch_rad):g} (the spoke pitch) [deg]')
        for name, value in (('stance_smoothing', stance_smoothing),
                            ('flight_smoothing', flight_smoothing)):
            if not 0.0 <= value <= 1.0:
                raise ConfigError(f'{name}: {value:g} is not valid; valid is >= 0 and <= 1')
        if stance_smoothing + flight_smoothing <= 0.0:
            raise ConfigError('stance_smoothing and flight_smoothing: both are 0, the slope would'
                              ' jump; valid is at least one > 0')
        self.duty = duty
        self.foot_width_rad = foot_width_rad
        self.pitch_rad = pitch_rad
        # Half segments, since the function is odd: stance [0, h], flight [h, 1/2].
        self._half_stance = h = 0.5 * duty
        half_flight = 0.5 - h
        self._stance_flank = a = stance_smoothing * h
        self._flight_flank = b = flight_smoothing * half_flight
        stance_mean = 0.5 * foot_width_rad / h
        flight_mean = 0.5 * (pitch_rad - foot_width_rad) / half_flight
        # The slope at touch-down and lift-off leans towards the segment that smooths less.
        self._edge = m = stance_mean + (flight_mean - stance_mean) * a / (a + b)
        # Plateaus so that each segment keeps its sweep: half a flank averages (plateau + m) / 2.
        self._stance_plateau = (stance_mean * h - 0.5 * a * m) / (h - 0.5 * a)
        self._flight_plateau = (flight_mean * half_flight - 0.5 * b * m) / (half_flight - 0.5 * b)

    @property
    def is_monotonic(self) -> bool:
        """Whether the leg never turns back while the phase grows.

        True for all parameters whose mean slopes in stance and flight differ by less than a
        factor of two; beyond that, strong smoothing may make the leg swing back.
        """
        return min(self._stance_plateau, self._flight_plateau, self._edge) >= 0.0

    @property
    def stance_slope(self) -> float:
        """Slope in the middle of stance [rad/cycle]."""
        return self._stance_plateau

    def is_stance(self, phase: ArrayLike) -> NDArray[np.bool_]:
        """Return whether (...) phases [cycles] lie in stance."""
        phase = np.asarray(phase, dtype=float)
        return np.abs(phase - np.round(phase)) <= self._half_stance

    def angle(self, phase: ArrayLike) -> Array:
        """Return the leg angle [rad] at (...) phases [cycles], unwrapped as the phase is."""
        phase = np.asarray(phase, dtype=float)
        turns = np.round(phase)
        local = phase - turns
        return turns * self.pitch_rad + np.sign(local) * self._half_angle(np.abs(local))

    def slope(self, phase: ArrayLike) -> Array:
        """Return d angle / d phase [rad/cycle] at (...) phases [cycles]."""
        phase = np.asarray(phase, dtype=float)
        x = np.abs(phase - np.round(phase))
        h, a, b = self._half_stance, self._stance_flank, self._flight_flank
        slope = np.where(x <= h, self._stance_plateau, self._flight_plateau)
        slope = np.where((x > h - a) & (x <= h),
                         _blend(self._stance_plateau, self._edge, x - (h - a), a), slope)
        return np.where((x > h) & (x < h + b),
                        _blend(self._edge, self._flight_plateau, x - h, b), slope)

    def phase(self, angle_rad: ArrayLike) -> Array:
        """Return the phase [cycles] at (...) angles [rad]: the inverse of `angle`, to 1e-12.

        Where the function is not monotonic, one of the phases of that angle.
        """
        angle = np.asarray(angle_rad, dtype=float)
        low = np.floor(angle / self.pitch_rad - 0.5)
        high = low + 2.0
        for _ in range(42):
            middle = 0.5 * (low + high)
            below = self.angle(middle) < angle
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return 0.5 * (low + high)

    def _half_angle(self, x: Array) -> Array:
        """Return the angle [rad] at local phases x in [0, 1/2]."""
        h, a, b = self._half_stance, self._stance_flank, self._flight_flank
        ps, pf, m = self._stance_plateau, self._flight_plateau, self._edge
        stance = ps * np.minimum(x, h - a) + _blend_integral(ps, m, np.clip(x - (h - a), 0.0, a),
                                                             a)
        flight = (_blend_integral(m, pf, np.clip(x - h, 0.0, b), b)
                  + pf * np.clip(x - h - b, 0.0, None))
        return stance + flight


def _blend(start: float, end: float, x: Array, length: float) -> Array:
    """Return a raised cosine from `start` at x = 0 to `end` at x = length."""
    if length == 0.0:
        return np.full_like(x, end)
    return start + (end - start) * 0.5 * (1.0 - np.cos(np.pi * x / length))


def _blend_integral(start: float, end: float, x: Array, length: float) -> Array:
    """Return the integral of `_blend` from 0 to x."""
    if length == 0.0:
        return np.zeros_like(x)
    return start * x + (end - start) * 0.5 * (x - length / np.pi * np.sin(np.pi * x / length))
