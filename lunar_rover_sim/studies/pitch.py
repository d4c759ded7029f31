"""Pitch over time, and what a pitch curve shows: amplitude, transient, dominant frequency."""

from __future__ import annotations

import csv
import dataclasses
import math
from pathlib import Path

import numpy as np

from lunar_rover_sim.arguments import brief
from lunar_rover_sim.errors import StudyError
from lunar_rover_sim.files.yaml_text import read_text
from lunar_rover_sim.frames import Array

START_S = 5.0         # the transient is looked for in this time after the command
STEADY_FROM_S = 10.0  # the steady walk begins this time after the command

_MAX_BYTES = 1 << 26    # of a curve
_LARGEST = 1e9          # of a number of a curve [s, deg]


@dataclasses.dataclass(frozen=True)
class PitchCurve:
    """Pitch over time: time_s (n,) even steps, pitch_deg (n,), positive nose down."""

    name: str
    time_s: Array
    pitch_deg: Array


@dataclasses.dataclass(frozen=True)
class PitchReport:
    """What a pitch curve shows.

    steady_low_deg, steady_high_deg: least and greatest pitch of the steady part
    steady_rms_deg, rms_deg: about the mean, of the steady part and of all after the command
    overshoot_deg: how far the first seconds after the command go beyond the steady range, which
        here includes the pitch at rest, so that leaving it is no overshoot
    decay_s: time after the command when the curve is last beyond that range by a tenth of the
        steady amplitude
    dominant_hz: frequency of the highest line of the steady spectrum (Hann window)
    step_share: share of the steady variance within 10 % of the step frequency; NaN if unknown
    periodicity: autocorrelation of the steady part at one gait cycle, 1 = strictly periodic
    """

    steady_low_deg: float
    steady_high_deg: float
    steady_rms_deg: float
    rms_deg: float
    overshoot_deg: float
    decay_s: float
    dominant_hz: float
    step_share: float
    periodicity: float

    @property
    def steady_amplitude_deg(self) -> float:
        """Half the steady range."""
        return 0.5 * (self.steady_high_deg - self.steady_low_deg)

    @property
    def transient(self) -> float:
        """Steady amplitude plus overshoot, over steady amplitude: above 1 there is a transient."""
        amplitude = self.steady_amplitude_deg
        return 1.0 + self.overshoot_deg / amplitude if amplitude > 1e-6 else math.nan


def analyse(curve: PitchCurve, command_s: float, cycle_hz: float = math.nan,
            step_hz: float = math.nan) -> PitchReport:
    """Return what a curve shows.

    command_s: when the command begins [s]; cycle_hz, step_hz: gait cycles and steps per second
    Raises StudyError if the curve ends before the steady part has lasted 2 s.
    """
    time, pitch = curve.time_s - command_s, curve.pitch_deg
    steady = time >= STEADY_FROM_S
    if time[-1] < STEADY_FROM_S + 2.0:
        raise StudyError(f'{curve.name}: ends {time[-1]:.1f} s after the command; valid is'
                         f' >= {STEADY_FROM_S + 2.0:g} s')
    low, high = float(pitch[steady].min()), float(pitch[steady].max())
    after, rest = time >= 0.0, float(np.interp(0.0, time, pitch))
    beyond = np.maximum(pitch - max(high, rest), min(low, rest) - pitch)
    late = time[after & (beyond > 0.05 * (high - low))]
    interval = float(np.median(np.diff(time)))
    signal = pitch[steady] - pitch[steady].mean()
    dominant, share = _spectrum(signal, interval, step_hz)
    return PitchReport(
        low, high, float(signal.std()), float(pitch[after].std()),
        max(0.0, float(beyond[after & (time <= START_S)].max())),
        float(late[-1]) if len(late) else 0.0, dominant, share,
        _autocorrelation(signal, 1.0 / (cycle_hz * interval)))


def read_curve(path: str | Path, name: str = '') -> PitchCurve:
    """Read a pitch curve from a CSV of two columns: time [s], pitch [deg]; a header is skipped.

    The curve is resampled to even steps. Raises StudyError that names file and line.
    """
    rows: list[tuple[float, float]] = []
    text = read_text(Path(path), _MAX_BYTES, StudyError)
    try:
        for number, row in enumerate(csv.reader(text.splitlines()), start=1):
            if not row or row[0].lstrip().startswith('#'):
                continue
            try:
                time, pitch = float(row[0]), float(row[1])
            except (ValueError, IndexError):
                if rows or number > 1:
                    raise StudyError(f'{path}, line {number}: {brief(",".join(row))} is not'
                                     ' time [s], pitch [deg]') from None
                continue
            if not (abs(time) <= _LARGEST and abs(pitch) <= _LARGEST):
                raise StudyError(f'{path}, line {number}: {time:g}, {pitch:g} is not valid; valid '
                                 f'are numbers up to {_LARGEST:g}')
            rows.append((time, pitch))
    except csv.Error as error:
        raise StudyError(f'{path} cannot be read: {error}') from None
    times, values = np.array(rows).reshape(-1, 2).T
    if len(times) < 2 or np.any(np.diff(times) <= 0.0):
        raise StudyError(f'{path}: valid are two or more rows with increasing time')
    even = np.linspace(times[0], times[-1], len(times))
    return PitchCurve(name or Path(path).stem, even, np.interp(even, times, values))


def _spectrum(signal: Array, interval_s: float, step_hz: float) -> tuple[float, float]:
    """Return the dominant frequency [Hz] and the share of power near the step frequency."""
    n = len(signal)
    power = np.abs(np.fft.rfft(signal * np.hanning(n), 8 * n)) ** 2
    frequency = np.fft.rfftfreq(8 * n, interval_s)
    total = power.sum()
    if total < 1e-20 * n:
        return math.nan, math.nan
    near = np.abs(frequency - step_hz) <= max(0.1 * step_hz, 2.0 / (n * interval_s))
    share = float(power[near].sum() / total) if math.isfinite(step_hz) else math.nan
    return float(frequency[np.argmax(power)]), share


def _autocorrelation(signal: Array, lag: float) -> float:
    """Return the normalised autocorrelation at a lag [samples], or NaN."""
    if not math.isfinite(lag) or not 1 <= round(lag) < len(signal) - 1:
        return math.nan
    a, b = signal[:-round(lag)], signal[round(lag):]
    norm = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / norm if norm > 1e-12 else math.nan
