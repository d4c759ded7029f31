"""IMU errors: the signals that a real IMU would measure, from the true ones.

Per sensor, with true signal s (specific force or angular rate, IMU axes):

    s~ = (I + E) M s + b + n                                               (accelerometer, gyro)

where E holds scale errors, M the rotation of the sensor's axes, n is white noise and b a random
walk. With E = 0 and M = I this is a~ = a + b_a + n_a, w~ = w + b_g + n_g. The continuous-time
densities sigma [unit/sqrt(Hz)] and sigma_b [unit s^-1/sqrt(Hz)] become, at a sampling interval dt,

    n[k] ~ N(0, sigma^2 / dt),   b[k + 1] = b[k] + N(0, sigma_b^2 dt)

(Crassidis, Sigma-point Kalman filtering for integrated GPS and inertial navigation, IEEE Trans.
Aerospace and Electronic Systems 42 (2), 2006). The sum is then rounded and clipped.
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.bag.messages import xyz
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.state_file import attributes, restore_attributes
from lunar_rover_sim.base.frames import Array, matrix_from_rotvec
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.sensors.sensor import Content, FROM_PRESET, numbers, over_preset, Sensor


@dataclasses.dataclass(frozen=True)
class ImuConfig(Parameters):
    """Errors of the IMU; densities and random walks in continuous-time units.

    The four noise parameters come from the preset unless they are given (>= 0). PRESETS
    has their sources. With `enabled` false the true signal is published.
    """

    enabled: bool = param(True, 'false publishes the true signal')
    preset: str = param('adis16448', 'part whose noise is taken',
                        choices=('none', 'adis16448', 'bmi160'))
    accel_noise_density: float = param(
        FROM_PRESET, 'white noise; -1: from the preset',
        unit='m/s^2/sqrt(Hz)', low=-1.0)
    gyro_noise_density: float = param(
        FROM_PRESET, 'white noise; -1: from the preset', unit='rad/s/sqrt(Hz)',
        low=-1.0)
    accel_bias_random_walk: float = param(
        FROM_PRESET, '-1: from the preset',
        unit='m/s^3/sqrt(Hz)', low=-1.0)
    gyro_bias_random_walk: float = param(
        FROM_PRESET, '-1: from the preset',
        unit='rad/s^2/sqrt(Hz)', low=-1.0)
    accel_initial_bias_mps2: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), 'at time 0', unit='m/s^2', length=3)
    gyro_initial_bias_radps: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), 'at time 0', unit='rad/s', length=3)
    accel_scale_error: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), 'per axis, relative', low=-0.5, high=0.5,
        length=3)
    gyro_scale_error: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), 'per axis, relative', low=-0.5, high=0.5,
        length=3)
    accel_misalignment_deg: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), 'rotation vector from imu_link to the true sensor axes', unit='deg',
        low=-20.0, high=20.0, length=3)
    gyro_misalignment_deg: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), 'rotation vector from imu_link to the true sensor axes', unit='deg',
        low=-20.0, high=20.0, length=3)
    accel_range_mps2: float = param(0.0, 'where the signal saturates; 0: nowhere',
                                    unit='m/s^2', low=0.0)
    gyro_range_radps: float = param(0.0, 'where the signal saturates; 0: nowhere',
                                    unit='rad/s', low=0.0)
    accel_resolution_mps2: float = param(0.0, 'step of quantisation; 0: none', unit='m/s^2',
                                         low=0.0)
    gyro_resolution_radps: float = param(0.0, 'step of quantisation; 0: none', unit='rad/s',
                                         low=0.0)

    def validate(self) -> None:
        """Raise ConfigError if a noise parameter is negative, other than -1 for the preset."""
        for name in ('accel_noise_density', 'gyro_noise_density', 'accel_bias_random_walk',
                     'gyro_bias_random_walk'):
            value = getattr(self, name)
            if value < 0.0 and value != FROM_PRESET:
                raise ConfigError(f'{name}: {value} is not valid; valid is >= 0, or -1 for the'
                                  f' value of the preset')


@dataclasses.dataclass(frozen=True)
class ImuNoiseParameters:
    """Continuous-time noise of one IMU.

    Attributes:
        accel_noise_density: White noise of the accelerometer [m/s^2/sqrt(Hz)].
        gyro_noise_density: White noise of the gyroscope [rad/s/sqrt(Hz)].
        accel_bias_random_walk: Of the accelerometer's bias [m/s^3/sqrt(Hz)].
        gyro_bias_random_walk: Of the gyroscope's bias [rad/s^2/sqrt(Hz)].
    """

    accel_noise_density: float
    gyro_noise_density: float
    accel_bias_random_walk: float
    gyro_bias_random_walk: float


PRESETS = {
    'none': ImuNoiseParameters(0.0, 0.0, 0.0, 0.0),
    # Analog Devices ADIS16448 as in the EuRoC data sets (Burri et al., The EuRoC micro aerial
    # vehicle datasets, IJRR 35 (10), 2016; file imu0/sensor.yaml).
    'adis16448': ImuNoiseParameters(2.0e-3, 1.6968e-4, 3.0e-3, 1.9393e-5),
    # Bosch BMI160, a consumer part, as measured for the TUM VI data sets (Schubert et al., The
    # TUM VI benchmark for evaluating visual-inertial odometry, IROS 2018).
    'bmi160': ImuNoiseParameters(1.4e-3, 8.0e-5, 8.6e-5, 2.2e-6),
}


@dataclasses.dataclass(frozen=True)
class ImuSample:
    """Measured signals and the true biases in them; (3,), or (n, 3) for many samples.

    Attributes:
        specific_force: Measured [m/s^2], IMU axes.
        rate: Measured [rad/s], IMU axes.
        accel_bias: True bias in it [m/s^2].
        gyro_bias: True bias in it [rad/s].
    """

    specific_force: Array
    rate: Array
    accel_bias: Array
    gyro_bias: Array


def noise_parameters(config: ImuConfig) -> ImuNoiseParameters:
    """Return the noise of the preset, replaced where the configuration gives a value."""
    return over_preset(config, PRESETS[config.preset])


class ImuNoise:
    """Adds the errors of an IMU to true signals; each sample advances the random walk of the bias.

    Args:
        rate_hz: Sampling rate [Hz].
        rng: Generator of the noise.
    """

    def __init__(self, config: ImuConfig, rate_hz: float, rng: np.random.Generator) -> None:
        noise = noise_parameters(config)
        interval_s = 1.0 / rate_hz
        self._enabled = config.enabled
        self._rng = rng
        # Columns: accelerometer x y z, gyroscope x y z.
        self._white = np.repeat([noise.accel_noise_density, noise.gyro_noise_density],
                                3) / np.sqrt(interval_s)
        self._walk = np.repeat([noise.accel_bias_random_walk, noise.gyro_bias_random_walk],
                               3) * np.sqrt(interval_s)
        self._bias = np.array([*config.accel_initial_bias_mps2, *config.gyro_initial_bias_radps])
        self._mixing = np.zeros((6, 6))
        self._mixing[:3, :3] = _axes(config.accel_scale_error, config.accel_misalignment_deg)
        self._mixing[3:, 3:] = _axes(config.gyro_scale_error, config.gyro_misalignment_deg)
        self._resolution = np.repeat([config.accel_resolution_mps2, config.gyro_resolution_radps],
                                     3)
        self._quantised = bool(np.any(self._resolution > 0.0))
        limits = np.repeat([config.accel_range_mps2, config.gyro_range_radps], 3)
        self._limit = np.where(limits > 0.0, limits, np.inf)

    def state(self) -> dict[str, Any]:
        """Return what the noise goes on from."""
        return attributes(self, '_rng', '_bias')

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` has returned, of an IMU with the same parameters."""
        restore_attributes(self, state)

    def white_noise_variances(self) -> tuple[float, float]:
        """Return the variance of one sample: accelerometer [m^2/s^4], gyroscope [rad^2/s^2].

        White noise and, where there is one, the rounding of the quantiser.
        """
        if not self._enabled:
            return 0.0, 0.0
        variance = self._white ** 2 + self._resolution ** 2 / 12.0
        return float(variance[0]), float(variance[3])

    def measure(self, specific_force: ArrayLike, rate: ArrayLike) -> ImuSample:
        """Return the measurement of one true (3,) specific force and (3,) rate."""
        true = np.concatenate([specific_force, rate])
        if not self._enabled:
            return ImuSample(true[:3], true[3:], np.zeros(3), np.zeros(3))
        draws = self._rng.standard_normal(12)
        bias = self._bias
        self._bias = bias + self._walk * draws[6:]
        measured = (self._mixing * true).sum(axis=1) + bias + self._white * draws[:6]
        measured = self._limited(measured)
        return ImuSample(measured[:3], measured[3:], bias[:3], bias[3:])

    def measure_many(self, specific_force: ArrayLike, rate: ArrayLike) -> ImuSample:
        """Return the measurements of (n, 3) true signals, one sampling interval apart.

        They equal those of n calls of `measure`.
        """
        true = np.concatenate([np.asarray(specific_force, float), np.asarray(rate, float)], axis=1)
        if not self._enabled:
            zero = np.zeros_like(true)
            return ImuSample(true[:, :3], true[:, 3:], zero[:, :3], zero[:, 3:])
        draws = self._rng.standard_normal((len(true), 12))
        bias = np.empty((len(true) + 1, 6))
        bias[0] = self._bias
        bias[1:] = self._walk * draws[:, 6:]
        np.cumsum(bias, axis=0, out=bias)
        self._bias = bias[-1]
        bias = bias[:-1]
        measured = (self._mixing * true[:, None]).sum(axis=2) + bias + self._white * draws[:, :6]
        measured = self._limited(measured)
        return ImuSample(measured[:, :3], measured[:, 3:], bias[:, :3], bias[:, 3:])

    def _limited(self, measured: Array) -> Array:
        """Return (..., 6) signals rounded and clipped."""
        if self._quantised:
            step = np.where(self._resolution > 0.0, self._resolution, 1.0)
            measured = np.where(self._resolution > 0.0, step * np.round(measured / step), measured)
        return np.minimum(np.maximum(measured, -self._limit), self._limit)


def _axes(scale_error: tuple[float, ...], misalignment_deg: tuple[float, ...]) -> Array:
    """Return the (3, 3) matrix from true signals in IMU axes to those along the sensor axes."""
    rotation = matrix_from_rotvec(np.radians(misalignment_deg))
    return np.diag(1.0 + np.asarray(scale_error)) @ rotation.T


class Imu(Sensor):
    """The IMU; `nodes.state_publisher` measures by ImuNoise."""

    name = 'imu'
    parameters = ImuConfig
    published = (topics.IMU_RAW,)
    content = Content('imu', 'inertial data')
    in_state = True
    stream = 1

    @classmethod
    def read(cls, topic: str, message: Any) -> dict[str, Any]:
        """Return specific force and rate of a sensor_msgs/Imu."""
        return {'frame': message.header.frame_id,
                'specific_force_mps2': numbers(xyz(message.linear_acceleration)),
                'rate_radps': numbers(xyz(message.angular_velocity))}
