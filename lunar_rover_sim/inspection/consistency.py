"""Consistency of the IMU in a bag with its odometry.

The bag's IMU samples are means over the interval that ends at their stamp, and the specific force
is that of the IMU's origin. With R the attitude, v the velocity of the IMU and g gravity, one
interval h must give

    R_k = R_{k-1} exp(h w_k),    v_k = v_{k-1} + h (R_{k-1/2} f_k + g)

with R_{k-1/2} halfway between both attitudes. The residuals are added up over windows of one
second. The result is the drift of an inertial navigation that starts from the true state.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from lunar_rover_sim import topics
from lunar_rover_sim.inspection.bag_scan import BagScan

WINDOW_S = 1.0


@dataclasses.dataclass(frozen=True)
class Drift:
    """Largest drift over one second: attitude [rad], velocity [m/s], position [m]."""

    attitude_rad: float
    velocity_mps: float
    position_m: float


@dataclasses.dataclass(frozen=True)
class NoiseOffset:
    """Mean of raw minus truth minus bias, in its own standard errors (largest axis)."""

    sigmas: float
    worst: str


def _rotation(quat_wxyz: np.ndarray) -> Rotation:
    return Rotation.from_quat(quat_wxyz[:, [1, 2, 3, 0]])


def imu_drift(scan: BagScan, imu_position_m: np.ndarray, gravity_mps2: float) -> Drift | None:
    """Return how far the true IMU signal drifts from odometry; None where there is too little.

    imu_position_m: (3,) origin of the IMU in base_link.
    """
    odom_ns, odom = scan.signal(scan.truth)
    imu_ns, imu = scan.signal(topics.IMU_TRUTH)
    stamps, at_odom, at_imu = np.intersect1d(odom_ns, imu_ns, return_indices=True)
    if len(stamps) < 3:
        return None
    odom, imu = odom[at_odom], imu[at_imu]
    if not (np.isfinite(odom).all() and np.isfinite(imu).all()):
        return None
    if (np.linalg.norm(odom[:, 3:7], axis=1) < 0.5).any() or \
            (np.linalg.norm(imu[:, 6:10], axis=1) < 0.5).any():
        return None
    step_s = np.diff(stamps) * 1e-9
    whole = step_s < 1.5 * np.median(step_s)  # an interval with a gap is not judged
    base, body = _rotation(odom[:, 3:7]), _rotation(imu[:, 6:10])
    turn = (body[:-1].inv() * body[1:]).as_rotvec()
    rate = imu[1:, 0:3]
    attitude = ((Rotation.from_rotvec(-rate * step_s[:, None]))
                * Rotation.from_rotvec(turn)).as_rotvec()
    velocity = base.apply(odom[:, 7:10] + np.cross(odom[:, 10:13], imu_position_m))
    middle = body[:-1] * Rotation.from_rotvec(0.5 * turn)
    gain = (middle.apply(imu[1:, 3:6]) - [0.0, 0.0, gravity_mps2]) * step_s[:, None]
    change = np.diff(velocity, axis=0) - gain
    base_velocity = base.apply(odom[:, 7:10])
    moved = (np.diff(odom[:, 0:3], axis=0)
             - 0.5 * (base_velocity[1:] + base_velocity[:-1]) * step_s[:, None])
    starts_s = (stamps[:-1] - stamps[0]) * 1e-9
    window = (starts_s // WINDOW_S).astype(int)
    drifts = []
    for residual in (attitude, change, moved):
        total = np.zeros((window[-1] + 1, 3))
        np.add.at(total, window[whole], residual[whole])
        drifts.append(np.linalg.norm(total, axis=1))
    return Drift(*(float(drift.max()) for drift in drifts))


def attitude_offset_rad(scan: BagScan, R_base_imu: np.ndarray) -> float | None:
    """Return the largest angle between the IMU's true orientation and that of odometry."""
    odom_ns, odom = scan.signal(scan.truth)
    imu_ns, imu = scan.signal(topics.IMU_TRUTH)
    stamps, at_odom, at_imu = np.intersect1d(odom_ns, imu_ns, return_indices=True)
    if not len(stamps):
        return None
    quats = np.hstack([odom[at_odom, 3:7], imu[at_imu, 6:10]])
    if not np.isfinite(quats).all() or (np.abs(quats).max(axis=0) == 0.0).all():
        return None
    if (np.linalg.norm(quats[:, :4], axis=1) < 0.5).any() or \
            (np.linalg.norm(quats[:, 4:], axis=1) < 0.5).any():
        return None
    expected = _rotation(quats[:, :4]) * Rotation.from_matrix(R_base_imu)
    return float((expected.inv() * _rotation(quats[:, 4:])).magnitude().max())


def raw_imu_offset(scan: BagScan) -> NoiseOffset | None:
    """Return the mean of raw minus truth minus bias; None where not all of them are recorded."""
    stamps = None
    for topic in (topics.IMU_RAW, topics.IMU_TRUTH, topics.IMU_BIAS):
        ns, values = scan.signal(topic)
        if not len(ns) or len(np.unique(ns)) != len(ns) or not np.isfinite(values).all():
            return None
        stamps = ns if stamps is None else np.intersect1d(stamps, ns)
    assert stamps is not None
    if len(stamps) < 10:
        return None
    parts = []
    for topic in (topics.IMU_RAW, topics.IMU_TRUTH, topics.IMU_BIAS):
        ns, values = scan.signal(topic)
        parts.append(values[np.searchsorted(ns, stamps), :6])
    noise = parts[0] - parts[1] - parts[2]
    error = noise.std(axis=0) / np.sqrt(len(noise)) + 1e-6
    sigmas = np.abs(noise.mean(axis=0)) / error
    axis = int(np.argmax(sigmas))
    name = ('angular velocity', 'specific force')[axis // 3] + ' ' + 'xyz'[axis % 3]
    return NoiseOffset(float(sigmas[axis]), f'{name}: mean {noise[:, axis].mean():.4g}')
