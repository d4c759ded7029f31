"""The shaping function: from the phase of a leg to its angle, with an analytic slope."""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array


class ShapingFunction:
    """Maps phase [cycles] to leg angle [rad]; one cycle turns the leg by one spoke pitch.

    Phase 0 is the middle of stance: a spoke points straight down (angle 0). In stance
    `|phase| <= duty / 2`, and the angle runs from -foot_width / 2 to +foot_width / 2; flight is
    the rest of the cycle and brings the next spoke to the same place. The function is odd, so
    walking backward is the same motion in reverse, and angle(phase + 1) = angle(phase) + pitch.

    The slope is a trapezium with raised-cosine flanks in each segment. `stance_smoothing` and
    `flight_smoothing` (0 to 1) are the shares of the segment taken by its flanks; all flanks meet
    at one slope, so angle and slope are continuous everywhere. Without stance smoothing the leg
    turns uniformly through the whole stance, and only flight changes its speed. The slope is
    positive everywhere: the leg never turns back while its phase grows.

    Raises:
        ConfigError: If the foot width is not inside (0, pitch), or both smoothings are zero (the
            slope would jump).
    """

    def __init__(self, duty: float, foot_width_rad: float, stance_smoothing: float,
                 flight_smoothing: float, pitch_rad: float) -> None:
        if not 0.0 < foot_width_rad < pitch_rad:
            raise ConfigError(
                f'foot_width_deg: {math.degrees(foot_width_rad):g} is not valid; valid is > 0 and'
                f' < {math.degrees(pitch_rad):g} (the spoke pitch) [deg]')
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
        # The slope at touch-down and lift-off is near that of the segment with less smoothing; its
        # bounds leave the plateaus at least a quarter of the mean slope.
        m = stance_mean + (flight_mean - stance_mean) * a / (a + b)
        for mean, half, flank in ((stance_mean, h, a), (flight_mean, half_flight, b)):
            m = min(m, 1.5 * mean * half / flank) if flank > 0.0 else m
        self._edge = m
        # The plateaus keep the sweep of each segment: a flank averages (plateau + m) / 2.
        self._stance_plateau = (stance_mean * h - 0.5 * a * m) / (h - 0.5 * a)
        self._flight_plateau = (flight_mean * half_flight - 0.5 * b * m) / (half_flight - 0.5 * b)

    def angle(self, phase: ArrayLike) -> Array:
        """Return the leg angle [rad] at (...) phases [cycles], unwrapped as the phase is."""
        return self._each(self.angle_at, phase)

    def slope(self, phase: ArrayLike) -> Array:
        """Return d angle / d phase [rad/cycle] at (...) phases [cycles]."""
        return self._each(self.slope_at, phase)

    def angle_at(self, phase: float) -> float:
        """Return the leg angle [rad] at one phase [cycles]."""
        turns = round(phase)
        x = abs(phase - turns)
        h, a, b = self._half_stance, self._stance_flank, self._flight_flank
        half = self._stance_plateau * min(x, h - a)
        if x > h - a:
            half += _blend_integral(self._stance_plateau, self._edge, min(x - (h - a), a), a)
        if x > h:
            half += (_blend_integral(self._edge, self._flight_plateau, min(x - h, b), b)
                     + self._flight_plateau * max(x - h - b, 0.0))
        return turns * self.pitch_rad + (half if phase >= turns else -half)

    def slope_at(self, phase: float) -> float:
        """Return d angle / d phase [rad/cycle] at one phase [cycles]."""
        x = abs(phase - round(phase))
        h, a, b = self._half_stance, self._stance_flank, self._flight_flank
        if x <= h - a:
            return self._stance_plateau
        if x <= h:
            return _blend(self._stance_plateau, self._edge, (x - (h - a)) / a)
        if x < h + b:
            return _blend(self._edge, self._flight_plateau, (x - h) / b)
        return self._flight_plateau

    def is_flight(self, phase: float) -> bool:
        """Return whether one phase [cycles] is of flight."""
        return abs(phase - round(phase)) > self._half_stance

    def phase(self, angle_rad: ArrayLike) -> Array:
        """Return the phase [cycles] at (...) angles [rad]: the inverse of `angle`, to 1e-12."""
        angle = np.asarray(angle_rad, dtype=float)
        low = np.floor(angle / self.pitch_rad - 0.5)
        high = low + 2.0
        for _ in range(42):
            middle = 0.5 * (low + high)
            below = self.angle(middle) < angle
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return 0.5 * (low + high)

    @staticmethod
    def _each(function: Callable[[float], float], phase: ArrayLike) -> Array:
        values = np.asarray(phase, dtype=float)
        return np.array([function(x) for x in values.ravel().tolist()]).reshape(values.shape)


def _blend(start: float, end: float, x: float) -> float:
    """Return a raised cosine from `start` at x = 0 to `end` at x = 1."""
    return start + (end - start) * 0.5 * (1.0 - math.cos(math.pi * x))


def _blend_integral(start: float, end: float, x: float, length: float) -> float:
    """Return the integral from 0 to x of a raised cosine that ends at `length`."""
    if length == 0.0:
        return 0.0
    return start * x + (end - start) * 0.5 * (
        x - length / math.pi * math.sin(math.pi * x / length))
