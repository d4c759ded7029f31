"""IMU noise: what was configured is what is in the signal."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.judge.studies.imu import AllanCurve, fit_noise, NoiseFit, overlapping_allan
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise, noise_parameters, PRESETS
from lunar_rover_sim.sensors.sensor import number

RATE_HZ = 200.0
REST = np.array([0.0, 0.0, 1.62])


def record(config: ImuConfig, n: int, seed: int = 0, rate_hz: float = RATE_HZ):
    noise = ImuNoise(config, rate_hz, np.random.default_rng(seed))
    return noise.measure_many(np.broadcast_to(REST, (n, 3)), np.zeros((n, 3)))


@pytest.mark.parametrize('preset', ['adis16448', 'bmi160'])
def test_allan_deviation_of_an_hour_gives_the_noise_back(preset):
    """At 50 Hz; for 200 Hz, four times the samples would say the same."""
    rate_hz = 50.0
    sample = record(ImuConfig(preset=preset), round(3600 * rate_hz), 1, rate_hz)
    true = PRESETS[preset]
    for signal, white, walk in (
            (sample.specific_force, true.accel_noise_density, true.accel_bias_random_walk),
            (sample.rate, true.gyro_noise_density, true.gyro_bias_random_walk)):
        fit = fit_noise(overlapping_allan(signal, rate_hz))
        assert fit.white == pytest.approx(white, rel=0.05)
        assert fit.random_walk == pytest.approx(walk, rel=0.15)


def test_noise_is_discretised_for_the_rate():
    """Sample deviation sigma sqrt(rate); the bias spreads as sigma_b sqrt(t)."""
    config = ImuConfig(preset='none', accel_noise_density=2e-3, gyro_bias_random_walk=1e-3)
    sample = record(config, 100_000)
    assert np.std(sample.specific_force - REST) == pytest.approx(2e-3 * np.sqrt(RATE_HZ), rel=0.01)
    np.testing.assert_array_equal(sample.accel_bias, 0.0)
    np.testing.assert_array_equal(sample.rate, sample.gyro_bias)
    steps = np.diff(sample.gyro_bias, axis=0)
    assert np.std(steps) == pytest.approx(1e-3 / np.sqrt(RATE_HZ), rel=0.01)


def test_sample_by_sample_equals_all_at_once():
    config = ImuConfig(accel_scale_error=(0.01, 0.0, -0.01), accel_range_mps2=1.7)
    noise = ImuNoise(config, RATE_HZ, np.random.default_rng(3))
    singles = [noise.measure(REST, np.zeros(3)) for _ in range(50)]
    many = record(config, 50, seed=3)
    for name in ('specific_force', 'rate', 'accel_bias', 'gyro_bias'):
        np.testing.assert_allclose([getattr(s, name) for s in singles], getattr(many, name),
                                   atol=1e-15)


def test_measured_is_true_plus_bias_plus_white_noise():
    """Eq. (1): without noise of one kind the other is left."""
    config = ImuConfig(preset='none', accel_initial_bias_mps2=(0.1, -0.2, 0.3),
                       gyro_initial_bias_radps=(0.01, 0.02, -0.03))
    sample = record(config, 3)
    np.testing.assert_allclose(sample.specific_force, np.tile(REST + [0.1, -0.2, 0.3], (3, 1)))
    np.testing.assert_allclose(sample.rate, np.tile([0.01, 0.02, -0.03], (3, 1)))
    np.testing.assert_allclose(sample.accel_bias, np.tile([0.1, -0.2, 0.3], (3, 1)))


def test_given_values_replace_those_of_the_preset():
    config = ImuConfig(preset='adis16448', gyro_noise_density=0.0, accel_noise_density=5e-3)
    noise = noise_parameters(config)
    assert noise.gyro_noise_density == 0.0
    assert noise.accel_noise_density == 5e-3
    assert noise.accel_bias_random_walk == PRESETS['adis16448'].accel_bias_random_walk
    accel, gyro = ImuNoise(config, RATE_HZ, np.random.default_rng()).white_noise_variances()
    assert accel == pytest.approx(25e-6 * RATE_HZ)
    assert gyro == 0.0
    # A quantiser rounds evenly within its step.
    coarse = dataclasses.replace(config, accel_resolution_mps2=0.5, gyro_resolution_radps=0.02)
    assert ImuNoise(coarse, RATE_HZ, np.random.default_rng()).white_noise_variances() \
        == pytest.approx((accel + 0.25 / 12.0, 4e-4 / 12.0))


def test_disabled_noise_is_the_truth():
    config = ImuConfig(enabled=False, accel_scale_error=(0.1, 0.1, 0.1))
    noise = ImuNoise(config, RATE_HZ, np.random.default_rng())
    sample = noise.measure(REST, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(sample.specific_force, REST)
    np.testing.assert_array_equal(sample.rate, [0.1, 0.2, 0.3])
    assert noise.white_noise_variances() == (0.0, 0.0)
    many = noise.measure_many([REST], [[0.1, 0.2, 0.3]])
    for name, value in dataclasses.asdict(sample).items():
        np.testing.assert_array_equal(getattr(many, name), [value])


def test_numbers_for_json_have_twelve_places_and_are_finite():
    assert number(math.pi) == pytest.approx(math.pi, abs=6e-13) and number(math.nan) is None


def test_scale_misalignment_range_and_resolution():
    quiet = ImuConfig(preset='none')

    def measure(**changes):
        config = dataclasses.replace(quiet, **changes)
        noise = ImuNoise(config, RATE_HZ, np.random.default_rng())
        return noise.measure([1.0, 2.0, 3.0], [0.1, 0.2, 0.3])

    np.testing.assert_allclose(
        measure(accel_scale_error=(0.1, 0.0, -0.1)).specific_force, [1.1, 2.0, 2.7])
    # Sensor axes turned by 90 deg about z would see y where x was: check with a small turn.
    angle = np.radians(5.0)
    turned = measure(gyro_misalignment_deg=(0.0, 0.0, 5.0)).rate
    np.testing.assert_allclose(turned, [0.1 * np.cos(angle) + 0.2 * np.sin(angle),
                                        0.2 * np.cos(angle) - 0.1 * np.sin(angle), 0.3])
    vector = (3.0, -4.0, 5.0)
    axes = Rotation.from_rotvec(vector, degrees=True)
    np.testing.assert_allclose(measure(gyro_misalignment_deg=vector).rate,
                               axes.inv().apply([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(measure(accel_range_mps2=1.5).specific_force, [1.0, 1.5, 1.5])
    rounded = measure(gyro_resolution_radps=0.04)
    np.testing.assert_allclose(rounded.rate, [0.08, 0.2, 0.32])
    np.testing.assert_allclose(measure(accel_scale_error=(0.1, 0.0, -0.1),
                                       gyro_resolution_radps=0.04).specific_force, [1.1, 2.0, 2.7])


def test_the_seed_decides():
    one, same, other = (record(ImuConfig(), 100, seed=s).rate for s in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert not np.any(one == other)


def test_allan_deviation_of_known_signals():
    """A ramp of slope c has c tau / sqrt(2); alternating +-1 has 2 / sqrt(2) at one sample."""
    ramp = overlapping_allan(0.3 * np.arange(1000) / 50.0, 50.0)
    np.testing.assert_allclose(ramp.deviation[:, 0], 0.3 * ramp.tau_s / np.sqrt(2.0), rtol=1e-9)
    alternating = overlapping_allan(np.tile([1.0, -1.0], 500), 50.0)
    assert alternating.tau_s[0] == pytest.approx(0.02)
    assert alternating.deviation[0, 0] == pytest.approx(np.sqrt(2.0))


def test_a_fit_of_the_model_itself_is_exact():
    tau = np.logspace(-2, 2, 40)
    for true in (NoiseFit(2e-3, 3e-3), NoiseFit(1.0, 0.0), NoiseFit(0.0, 1e-5)):
        fit = fit_noise(AllanCurve(tau, true.deviation(tau)[:, None], 3600.0))
        assert fit.white == pytest.approx(true.white, rel=1e-6, abs=1e-9)
        assert fit.random_walk == pytest.approx(true.random_walk, rel=1e-6, abs=1e-9)


def validate(*arguments: str) -> int:
    return execute(['validate', 'imu', *arguments])


def test_validate_imu_reads_the_noise_back(tmp_path, capsys):
    plot = tmp_path / 'allan.png'
    assert validate('--set', 'gyro_bias_random_walk=1e-3', '--rate', '50', '-o', str(plot)) == 0
    out = capsys.readouterr().out
    assert 'read back' in out and 'OUT' not in out
    assert plot.read_bytes().startswith(b'\x89PNG')


@pytest.mark.parametrize('arguments', [('--hours', '0'), ('--rate', '-1'), ('--set', 'nonsense'),
                                       ('--set', 'nonsense=1'), ('-o', '/nowhere/at/all.png')])
def test_validate_imu_refuses(arguments):
    with pytest.raises(ConfigError, match='valid|did you mean|/nowhere/at is not a folder'):
        validate(*arguments)


def test_presets_are_those_of_the_published_data_sets():
    """EuRoC's imu0/sensor.yaml and TUM VI's calibration: white noise and walk, m/s^2 and rad/s."""
    published = {
        'adis16448': {'accel_noise_density': 2.0e-3, 'accel_bias_random_walk': 3.0e-3,
                      'gyro_noise_density': 1.6968e-4, 'gyro_bias_random_walk': 1.9393e-5},
        'bmi160': {'accel_noise_density': 1.4e-3, 'accel_bias_random_walk': 8.6e-5,
                   'gyro_noise_density': 8.0e-5, 'gyro_bias_random_walk': 2.2e-6},
        'none': dict.fromkeys(('accel_noise_density', 'accel_bias_random_walk',
                               'gyro_noise_density', 'gyro_bias_random_walk'), 0.0)}
    assert {name: dataclasses.asdict(preset) for name, preset in PRESETS.items()} == published
