"""Motions with covariances: (turn, shift) (6,) in the axes of their end, T Exp(turn, shift)."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.frames import Array, inverse, se3
from lunar_rover_sim.judge.slam.graph.measured import Wheels
from lunar_rover_sim.judge.slam.graph.pose_graph import adjoint

_WHEELS_UP_M, _WHEELS_TILT_RAD = 0.03, 0.3


def composed(T: Array, P: Array, relative: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the pose T relative, and its covariance, in its own axes."""
    A = adjoint(inverse(relative))
    return T @ relative, A @ P @ A.T + covariance


def difference(first: Array, second: Array) -> Array:
    """Return (turn, shift) (6,) of second^-1 first, in the axes of the end."""
    D = inverse(second) @ first
    return np.concatenate([Rotation.from_matrix(D[:3, :3]).as_rotvec(), D[:3, 3]])


def fused(T: Array, P: Array, other: Array, other_covariance: Array) -> tuple[Array, Array]:
    """Return the mean of two measurements of one motion, weighted by their covariances."""
    gain = P @ np.linalg.inv(P + other_covariance)
    move = gain @ difference(other, T)
    step = se3(Rotation.from_rotvec(move[:3]).as_matrix(), move[3:])
    covariance = P - gain @ P
    return T @ step, 0.5 * (covariance + covariance.T)


def rolled(before: Wheels, now: Wheels) -> tuple[Array, Array]:
    """Return the motion of the base by the wheels, and its covariance (turn, shift)."""
    x, y, yaw = now.pose - before.pose
    c, s = math.cos(before.pose[2]), math.sin(before.pose[2])
    T = se3(Rotation.from_euler('Z', yaw).as_matrix(), [c * x + s * y, c * y - s * x, 0.0])
    F = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    added = now.covariance - F @ before.covariance @ F.T
    c, s = math.cos(now.pose[2]), math.sin(now.pose[2])
    turned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    added = turned @ added @ turned.T
    # A difference of large covariances: rounding, or odometry of another model, may leave
    # variances below 0.
    variances, axes = np.linalg.eigh(0.5 * (added + added.T))
    added = axes @ np.diag(np.abs(variances)) @ axes.T
    way = math.hypot(x, y)
    covariance = np.diag([_WHEELS_TILT_RAD**2] * 2 + [0.0] * 3
                         + [_WHEELS_UP_M**2 + (0.2 * way)**2])
    order = [3, 4, 2]
    covariance[np.ix_(order, order)] += added + np.diag([1e-6, 1e-6, 1e-6])
    return T, covariance
