"""Rigid transforms, quaternions, the length of paths, and axis conventions.

`T_a_b` is a 4x4 matrix that maps points of frame b to frame a. Quaternions are wxyz, unit length;
xyzw appears only where messages and TUM files are written. Frames:

- world (`odom`): x east, y north, z up (ENU), origin at the centre of the fine terrain;
- base (`base_link`): x forward, y left, z up (REP-103), origin at the chassis centre;
- leg (`<leg>_link`): at the axle, turned about y with the leg;
- LiDAR (`lidar_link`): at its optical centre, x ahead, y left, z up;
- camera (`stereo_*_link`): at the lens, x along the optical axis, y left, z up (REP-103);
- optical (`*_optical_frame`): x right, y down, z forward (REP-103);
- GL camera: x right, y up, z backward.
"""

from __future__ import annotations

from collections.abc import Iterable
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

ODOM_FRAME = 'odom'
BASE_FRAME = 'base_link'
FOOTPRINT_FRAME = 'base_footprint'
IMU_FRAME = 'imu_link'
LIDAR_FRAME = 'lidar_link'
LEFT_CAMERA_FRAME = 'stereo_left_link'
RIGHT_CAMERA_FRAME = 'stereo_right_link'
LEFT_OPTICAL_FRAME = 'stereo_left_optical_frame'
RIGHT_OPTICAL_FRAME = 'stereo_right_optical_frame'
WHEEL_ODOM_FRAME = 'wheel_odom'
CHASE_OPTICAL_FRAME = 'chase_optical_frame'
# Of the true pose where `odom` and `base_link` belong to an estimator.
TRUE_ODOM_FRAME = 'ground_truth/odom'
TRUE_BASE_FRAME = 'ground_truth/base_link'

# Columns are the optical axes written in body axes: right = -y, down = -z, forward = +x.
R_BODY_OPTICAL: Array = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_IDENTITY = np.eye(4)


def leg_frame(leg: str) -> str:
    """Return the frame of a leg, which turns with it about the axle."""
    return f'{leg}_link'


def se3(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Return the (4, 4) transform of a (3, 3) rotation and a (3,) translation [m]."""
    transform = _IDENTITY.copy()
    transform[:3, :3] = rotation
    transform[:3, 3] = translation
    return transform


def inverse(T_a_b: ArrayLike) -> Array:
    """Return T_b_a of a rigid (4, 4) T_a_b."""
    matrix = np.asarray(T_a_b, dtype=float)
    rotation = matrix[:3, :3].T
    return se3(rotation, -rotation @ matrix[:3, 3])


def rotated(rotation: Array, vectors: Array) -> Array:
    """Return (..., 3) vectors, each multiplied by its rotation of (..., 3, 3).

    Its sums have one order. Products of matrices are those of BLAS, which rounds by the processor.
    """
    return (vectors[..., :1] * rotation[..., 0] + vectors[..., 1:2] * rotation[..., 1]
            + vectors[..., 2:] * rotation[..., 2])


def length(vector: Iterable[float]) -> float:
    """Return the length of a vector, by the same rounding on every processor.

    NumPy's norm is a product of BLAS, whose sums have another order on each processor.
    """
    return math.sqrt(sum(v * v for v in vector))


def matrix_from_wxyz(quat_wxyz: ArrayLike) -> Array:
    """Return the (..., 3, 3) rotation matrix of (..., 4) unit quaternions."""
    # Two transpositions take a fifth of the time of np.moveaxis and np.stack for one quaternion.
    w, x, y, z = np.asarray(quat_wxyz, dtype=float).T
    columns = [
        [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
        [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
        [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.ascontiguousarray(np.array(columns).T)


def matrix_from_rotvec(rotvec_rad: ArrayLike) -> Array:
    """Return the (3, 3) rotation by the length of a (3,) vector [rad] about its direction."""
    vector = np.asarray(rotvec_rad, dtype=float)
    half = 0.5 * length(vector.tolist())
    scale = math.sin(half) / (2.0 * half) if half > 0.0 else 0.5
    return matrix_from_wxyz([math.cos(half), *(scale * vector)])


def wxyz_from_matrix(rotation: ArrayLike) -> Array:
    """Return the (4,) unit quaternion, w >= 0, of a (3, 3) rotation (Shepperd, 1978)."""
    # Floats: for one matrix they take half of the time of arrays.
    (m00, m01, m02), (m10, m11, m12), (m20, m21, m22) = np.asarray(rotation, dtype=float).tolist()
    diagonal = m00 + m11 + m22, m00, m11, m22
    k = diagonal.index(max(diagonal))
    if k == 0:
        quat = 1 + diagonal[0], m21 - m12, m02 - m20, m10 - m01
    elif k == 1:
        quat = m21 - m12, 1 + m00 - m11 - m22, m01 + m10, m02 + m20
    elif k == 2:
        quat = m02 - m20, m01 + m10, 1 - m00 + m11 - m22, m12 + m21
    else:
        quat = m10 - m01, m02 + m20, m12 + m21, 1 - m00 - m11 + m22
    norm = length(quat)
    return np.array(quat) / (-norm if quat[0] < 0.0 else norm)


def wxyz_from_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """Return the (4,) quaternion of fixed-axis roll, pitch, yaw [rad] (REP-103, URDF `rpy`)."""
    cr, sr = np.cos(roll_rad / 2), np.sin(roll_rad / 2)
    cp, sp = np.cos(pitch_rad / 2), np.sin(pitch_rad / 2)
    cy, sy = np.cos(yaw_rad / 2), np.sin(yaw_rad / 2)
    return np.array([cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy,
                     cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy])


def product_wxyz(first: ArrayLike, second: ArrayLike) -> Array:
    """Return the (4,) or (n, 4) quaternions of the rotations that apply `second`, then `first`."""
    w, x, y, z = np.asarray(first, dtype=float).T
    a, b, c, d = np.asarray(second, dtype=float).T
    return np.array([w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
                     w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a]).T


def rpy_from_wxyz(quat_wxyz: ArrayLike) -> Array:
    """Return (..., 3) fixed-axis roll, pitch, yaw [rad]; positive pitch is nose down."""
    w, x, y, z = np.moveaxis(np.asarray(quat_wxyz, dtype=float), -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def tilt_deg(attitude: ArrayLike) -> Array:
    """Return the angle between the z axes of a body and of the world [deg].

    Args:
        attitude: Rotations of the body in the world, shape (..., 3, 3), or quaternions wxyz,
            shape (..., 4).

    Returns:
        Angles, shape (...); 180 where an attitude is not finite, so that it passes no bound.
    """
    given = np.asarray(attitude, dtype=float)
    up = (given[..., 2, 2] if given.shape[-2:] == (3, 3)
          else 1.0 - 2.0 * (given[..., 1]**2 + given[..., 2]**2))
    return np.degrees(np.arccos(np.clip(np.where(np.isfinite(up), up, -1.0), -1.0, 1.0)))


def distance_along(points_m: ArrayLike) -> Array:
    """Return the (n,) distance travelled [m] at each of (n, 2 or 3) points, 0 at the first."""
    points = np.asarray(points_m, dtype=float)
    distance = np.zeros(len(points))
    np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1), out=distance[1:])
    return distance


def path_length(points_m: ArrayLike) -> float:
    """Return the length [m] of the path through (n, 2) or (n, 3) points; 0 of fewer than two."""
    steps = np.diff(np.asarray(points_m, dtype=float), axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def sun_direction(azimuth_deg: float, elevation_deg: float) -> Array:
    """Return the (3,) unit vector to the sun or another body in the sky, world frame.

    Azimuth is counted from x (east) towards y (north), as yaw is; elevation from the horizontal.
    """
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
                     np.sin(elevation)])
