"""Checks of the true IMU against odometry, and of the raw IMU against its truth and bias."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim import frames
from lunar_rover_sim.inspection import consistency
from lunar_rover_sim.inspection.report import CheckReport, Status
from lunar_rover_sim.inspection.rover_data import RoverData

# Drift of the noise-free IMU over one second. The samples are exact means; what remains is the
# rounding of their messages, and the mean attitude that stands for the interval.
MAX_ATTITUDE_DRIFT_RAD = 2e-3
MAX_VELOCITY_DRIFT_MPS = 5e-3
# The trapezoidal rule from twist to position misses impacts shorter than an interval.
MAX_POSITION_DRIFT_M = 5e-3
MAX_ATTITUDE_OFFSET_RAD = 1e-6
MAX_NOISE_SIGMAS = 6.0


def imu_and_odometry(rover: RoverData, report: CheckReport) -> None:
    """The noise-free IMU integrates to odometry."""
    position = _vector(rover.scenario.get('rover', 'imu.position_m'))
    rpy = np.radians(_vector(rover.scenario.get('rover', 'imu.rpy_deg')))
    R_base_imu = frames.matrix_from_wxyz(frames.wxyz_from_rpy(*rpy))
    drift = consistency.imu_drift(rover.scan, position,
                                  rover.scenario.number('physics_node', 'gravity_mps2', 1.62))
    if drift is None:
        report.add('imu and odometry', Status.SKIP, 'not both in the bag, or not finite')
        return
    problems = []
    if not drift.attitude_rad <= MAX_ATTITUDE_DRIFT_RAD:
        problems.append(f'angular velocity drifts {drift.attitude_rad:.4f} rad from the '
                        f'attitude within 1 s (valid: {MAX_ATTITUDE_DRIFT_RAD:g})')
    if not drift.velocity_mps <= MAX_VELOCITY_DRIFT_MPS:
        problems.append(f'specific force drifts {drift.velocity_mps:.4f} m/s from the '
                        f'velocity within 1 s (valid: {MAX_VELOCITY_DRIFT_MPS:g})')
    if not drift.position_m <= MAX_POSITION_DRIFT_M:
        problems.append(f'twist drifts {drift.position_m:.4f} m from the position within 1 s '
                        f'(valid: {MAX_POSITION_DRIFT_M:g})')
    offset = consistency.attitude_offset_rad(rover.scan, R_base_imu)
    if offset is not None and offset > MAX_ATTITUDE_OFFSET_RAD:
        problems.append(f'the IMU is turned {offset:.4f} rad from its mount')
    report.verdict('imu and odometry', problems,
                   f'drift in 1 s: {drift.attitude_rad:.1e} rad, {drift.velocity_mps:.1e} m/s, '
                   f'{drift.position_m:.1e} m')


def imu_noise(rover: RoverData, report: CheckReport) -> None:
    """The raw signal is truth, bias and white noise."""
    imperfect = [name for name in ('accel_scale_error', 'gyro_scale_error',
                                   'accel_misalignment_deg', 'gyro_misalignment_deg',
                                   'accel_range_mps2', 'gyro_range_radps')
                 if np.any(rover.scenario.get('physics_node', f'imu.{name}', 0))]
    if imperfect:
        report.add('imu noise', Status.SKIP, f'{", ".join(imperfect)} given')
        return
    offset = consistency.raw_imu_offset(rover.scan)
    if offset is None:
        report.add('imu noise', Status.SKIP, 'raw signal, truth and bias not all in the bag')
        return
    problems = []
    if offset.sigmas > MAX_NOISE_SIGMAS:
        problems.append(f'raw minus truth minus bias is not noise: {offset.worst}, '
                        f'{offset.sigmas:.1f} standard errors from 0')
    report.verdict('imu noise', problems, f'mean within {offset.sigmas:.1f} standard errors')


def _vector(value: object) -> np.ndarray:
    if isinstance(value, (list, tuple)) and len(value) == 3:
        try:
            return np.array([float(v) for v in value])
        except (TypeError, ValueError):
            pass
    return np.zeros(3)
