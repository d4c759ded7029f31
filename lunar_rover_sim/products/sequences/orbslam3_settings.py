"""Settings files of ORB-SLAM3, version 1.0.

Its readers require, without documenting it: every real number with a decimal point, whole numbers
(width, height, fps, counts) without one, `Viewer.*` also without a viewer. A pinhole camera
with `Stereo.T_c1_c2` is written for stereo: with the rectified type, the printout of the settings
reads a pointer that was never set. Stereo starts only with more than 500 keypoints in a frame,
hence the large number of features.
"""

from __future__ import annotations

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import nearest
from lunar_rover_sim.products.sequences.sensors import SensorSuite

SENSORS = ('mono', 'stereo', 'stereo-inertial', 'rgbd')
DEPTH_FACTOR = 5000.0  # of 16-bit depth images, per metre, as the TUM data sets have it

_GRAVITY_NOTE = (
    '# ORB-SLAM3 has the gravity of the Earth compiled in: GRAVITY_VALUE, 9.81, in ImuTypes.h.',
    '# It does not read this line; the program for its wheel does. Another build needs the value.')

# Largest distance of a near point, in baselines.
_THRESHOLD_BASELINES = 60.0


def settings(suite: SensorSuite, sensor: str, features: int = 2000) -> str:
    """Return the text of a settings file.

    Args:
        sensor: `mono`, `stereo`, `stereo-inertial` or `rgbd`.
        features: Keypoints per image.

    Raises:
        ConfigError: On an unknown sensor, or where an inertial one has no IMU rate.
    """
    if sensor not in SENSORS:
        raise ConfigError(f'sensor: {sensor!r} is not valid; {nearest(sensor, SENSORS)}')
    if sensor == 'stereo-inertial' and not suite.imu_rate_hz > 0.0:
        raise ConfigError('sensor: stereo-inertial needs an IMU, and there is no signal of one')
    lines = ['%YAML:1.0', '']
    lines += _cameras(suite, sensor)
    lines += _imu(suite) if sensor.endswith('inertial') else []
    lines += ['', f'ORBextractor.nFeatures: {features}', 'ORBextractor.scaleFactor: 1.2',
              'ORBextractor.nLevels: 8', 'ORBextractor.iniThFAST: 20',
              'ORBextractor.minThFAST: 5', '']
    lines += [f'Viewer.{name}: {_real(value)}' for name, value in (
        ('KeyFrameSize', 0.05), ('KeyFrameLineWidth', 1.0), ('GraphLineWidth', 0.9),
        ('PointSize', 2.0), ('CameraSize', 0.08), ('CameraLineWidth', 3.0), ('ViewpointX', 0.0),
        ('ViewpointY', -0.7), ('ViewpointZ', -3.5), ('ViewpointF', 500.0),
        ('imageViewScale', 1.0))]
    return '\n'.join(lines) + '\n'


def _cameras(suite: SensorSuite, sensor: str) -> list[str]:
    lines = ['File.version: "1.0"', '', 'Camera.type: "PinHole"']
    lines += _intrinsics(suite, 'Camera1.')
    if sensor.startswith('stereo'):
        lines += _intrinsics(suite, 'Camera2.')
    lines += ['', f'Camera.width: {suite.width}', f'Camera.height: {suite.height}',
              f'Camera.fps: {max(1, round(suite.frame_rate_hz))}', 'Camera.RGB: 1']
    if sensor != 'mono':
        lines += ['', f'Stereo.ThDepth: {_real(_THRESHOLD_BASELINES)}']
    if sensor.startswith('stereo'):
        lines += _matrix('Stereo.T_c1_c2', suite.T_left_right)
    if sensor == 'rgbd':
        lines += [f'Stereo.b: {_real(suite.baseline_m)}',
                  f'RGBD.DepthMapFactor: {_real(DEPTH_FACTOR)}']
    return lines


def _intrinsics(suite: SensorSuite, prefix: str) -> list[str]:
    values = dict(zip(('fx', 'fy', 'cx', 'cy', 'k1', 'k2', 'p1', 'p2', 'k3'),
                      (*suite.focal_px, *suite.centre_px, *suite.distortion), strict=True))
    if values['k3'] == 0.0:
        del values['k3']
    return [f'{prefix}{name}: {_real(value)}' for name, value in values.items()]


def _imu(suite: SensorSuite) -> list[str]:
    noise = suite.noise
    return ['', *_GRAVITY_NOTE, f'IMU.Gravity: {_real(suite.gravity_mps2)}',
            *_matrix('IMU.T_b_c1', suite.T_imu_left),
            f'IMU.NoiseGyro: {_real(noise.gyro_noise_density)}',
            f'IMU.NoiseAcc: {_real(noise.accel_noise_density)}',
            f'IMU.GyroWalk: {_real(noise.gyro_bias_random_walk)}',
            f'IMU.AccWalk: {_real(noise.accel_bias_random_walk)}',
            f'IMU.Frequency: {_real(suite.imu_rate_hz)}']


def _matrix(name: str, values: Array) -> list[str]:
    rows, columns = values.shape
    numbers = ', '.join(_real(value) for value in values.ravel())
    return [f'{name}: !!opencv-matrix', f'   rows: {rows}', f'   cols: {columns}',
            '   dt: f', f'   data: [{numbers}]']


def _real(value: float) -> str:
    """Return a number with a decimal point, and without rounding noise around 0 and 1."""
    text = f'{0.0 if abs(value) < 1e-15 else value:.12g}'
    mantissa, e, exponent = text.partition('e')
    return (mantissa if '.' in mantissa else mantissa + '.0') + e + exponent
