"""The IMU study: the noise of an IMU at rest, read back by its Allan deviation."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.errors import StudyError
from lunar_rover_sim.files.figures import save_figure
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise, noise_parameters
from lunar_rover_sim.studies.allan import AllanCurve, fit_noise, NoiseFit, overlapping_allan

GRAVITY_MPS2 = 1.62
# Largest relative errors of what is read back from an hour at 200 Hz.
WHITE_TOLERANCE, RANDOM_WALK_TOLERANCE = 0.05, 0.15


@dataclasses.dataclass(frozen=True)
class SensorNoise:
    """The noise of one sensor: Allan deviation, configured densities, and those read back.

    name: accelerometer or gyroscope; unit: that of its signal
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
    """Simulate an IMU at rest for a time [s]; return the noise of accelerometer and gyroscope.

    Raises StudyError for fewer than 100 samples.
    """
    n = round(duration_s * rate_hz)
    at_rest = np.broadcast_to([0.0, 0.0, GRAVITY_MPS2], (n, 3))
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

    Raises StudyError if the file cannot be written.
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
