"""The IMU study: the noise of an IMU at rest, read back by its Allan deviation."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.results import save_figure
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.gravity import MOON_MPS2
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise, noise_parameters

PER_DECADE = 10     # averaging times


@dataclasses.dataclass(frozen=True)
class AllanCurve:
    """Overlapping Allan deviation of some channels.

    Attributes:
        tau_s: (k,) averaging times [s].
        deviation: (k, c) in the unit of the signal.
        duration_s: Length of the record.
    """

    tau_s: Array
    deviation: Array
    duration_s: float


@dataclasses.dataclass(frozen=True)
class NoiseFit:
    """Densities read from a curve: white [unit/sqrt(Hz)], random walk [unit/s/sqrt(Hz)]."""

    white: float
    random_walk: float

    def deviation(self, tau_s: ArrayLike) -> Array:
        """Return the Allan deviation of these densities at averaging times [s]."""
        tau = np.asarray(tau_s, dtype=float)
        return np.sqrt(self.white ** 2 / tau + self.random_walk ** 2 * tau / 3.0)


def overlapping_allan(signal: ArrayLike, rate_hz: float) -> AllanCurve:
    """Return the curve of (n,) or (n, c) samples taken at rate_hz [Hz].

    Averaging times are spaced evenly in the logarithm, up to a tenth of the record.
    """
    samples = np.asarray(signal, dtype=float)
    samples = samples.reshape(len(samples), -1)
    n = len(samples)
    interval = 1.0 / rate_hz
    # Less the mean, which cancels anyway, the integral keeps its digits.
    integral = np.zeros((n + 1, samples.shape[1]))
    np.cumsum((samples - samples.mean(axis=0)) * interval, axis=0, out=integral[1:])
    decades = np.log10(n / 10.0)
    sizes = np.unique(np.logspace(0.0, decades, int(PER_DECADE * decades) + 1).astype(int))
    deviation = np.empty((len(sizes), samples.shape[1]))
    for row, m in enumerate(sizes):
        second = integral[2 * m:] - 2.0 * integral[m:-m] + integral[:-2 * m]
        deviation[row] = np.sqrt(np.mean(second ** 2, axis=0) / (2.0 * (m * interval) ** 2))
    return AllanCurve(sizes * interval, deviation, n * interval)


def fit_noise(curve: AllanCurve) -> NoiseFit:
    """Return white noise and random walk read from the mean variance of the curve's channels.

    Weighted least squares of the relative error of S^2 / tau + K^2 tau / 3; a variance at tau has
    about duration / tau degrees of freedom. Iterated, since the weights are relative to the fit.
    """
    tau = curve.tau_s
    variance = np.mean(curve.deviation ** 2, axis=1)
    basis = np.stack([1.0 / tau, tau / 3.0], axis=1)
    freedom = curve.duration_s / tau
    model = variance
    squares = np.zeros(2)
    for _ in range(20):
        # The number of points per decade is even, so weights need no further correction.
        weight = np.sqrt(freedom) / np.maximum(model, 1e-300)
        squares = nnls(basis * weight[:, None], variance * weight)[0]
        model = basis @ squares
    return NoiseFit(float(np.sqrt(squares[0])), float(np.sqrt(squares[1])))


# Largest relative errors of what is read back from an hour at 200 Hz.
WHITE_TOLERANCE, RANDOM_WALK_TOLERANCE = 0.05, 0.15


@dataclasses.dataclass(frozen=True)
class SensorNoise:
    """The noise of one sensor: Allan deviation, configured densities, and those read back.

    Attributes:
        name: Accelerometer or gyroscope.
        unit: That of its signal.
    """

    name: str
    unit: str
    curve: AllanCurve
    configured: NoiseFit
    measured: NoiseFit


@dataclasses.dataclass(frozen=True)
class NoiseComparison:
    """One density, configured and read back, and the largest relative error that passes."""

    sensor: str
    noise: str
    configured: float
    measured: float
    bound: float

    @property
    def error(self) -> float:
        """Relative error; 0 if no noise is configured."""
        return self.measured / self.configured - 1.0 if self.configured > 0.0 else 0.0

    @property
    def passed(self) -> bool:
        """Whether the error is within the bound."""
        return abs(self.error) <= self.bound


def study(config: ImuConfig, duration_s: float = 3600.0, rate_hz: float = 200.0,
          seed: int = 1) -> list[SensorNoise]:
    """Simulate an IMU at rest for a time [s]; return the noise of accelerometer and gyroscope."""
    n = round(duration_s * rate_hz)
    at_rest = np.broadcast_to([0.0, 0.0, MOON_MPS2], (n, 3))
    noise = ImuNoise(config, rate_hz, np.random.default_rng(seed))
    sample = noise.measure_many(at_rest, np.zeros((n, 3)))
    true = noise_parameters(config)
    sensors = (
        ('accelerometer', 'm/s²', sample.specific_force,
         NoiseFit(true.accel_noise_density, true.accel_bias_random_walk)),
        ('gyroscope', 'rad/s', sample.rate,
         NoiseFit(true.gyro_noise_density, true.gyro_bias_random_walk)))
    result = []
    for name, unit, signal, configured in sensors:
        curve = overlapping_allan(signal, rate_hz)
        result.append(SensorNoise(name, unit, curve, configured, fit_noise(curve)))
    return result


def compare(sensors: list[SensorNoise]) -> list[NoiseComparison]:
    """Return white noise and bias random walk of each sensor, configured and read back."""
    return [comparison for s in sensors for comparison in (
        NoiseComparison(s.name, 'white noise', s.configured.white, s.measured.white,
                        WHITE_TOLERANCE),
        NoiseComparison(s.name, 'bias random walk', s.configured.random_walk,
                        s.measured.random_walk, RANDOM_WALK_TOLERANCE))]


def plot_format(path: str | Path) -> str:
    """Return the format that the suffix of a plot says, PNG without one; raise StudyError."""
    kind, valid = Path(path).suffix.lstrip('.').lower() or 'png', FigureCanvasAgg.filetypes
    if kind not in valid:
        raise StudyError(f'{path}: .{kind} is not valid; valid are .{", .".join(sorted(valid))}')
    return kind


def plot(sensors: list[SensorNoise], path: str | Path) -> None:
    """Write a plot of the Allan deviation of each sensor; PNG, or what the suffix says.

    Raises:
        StudyError: If the file cannot be written.
    """
    figure = Figure(figsize=(11, 4.5), layout='constrained')
    for axes, sensor in zip(figure.subplots(1, len(sensors)), sensors):
        tau_s = sensor.curve.tau_s
        for axis, letter in enumerate('xyz'):
            axes.loglog(tau_s, sensor.curve.deviation[:, axis], '.', ms=4, label=letter)
        axes.loglog(tau_s, sensor.configured.deviation(tau_s), 'k-', lw=2, alpha=0.4,
                    label='configured')
        axes.loglog(tau_s, sensor.measured.deviation(tau_s), 'r--', lw=1, label='read back')
        axes.set_title(sensor.name)
        axes.set_xlabel('averaging time [s]')
        axes.set_ylabel(f'Allan deviation [{sensor.unit}]')
        axes.grid(True, which='both', alpha=0.3)
        axes.legend()
    save_figure(figure, path, StudyError, kind=plot_format(path))
