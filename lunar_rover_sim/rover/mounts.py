"""The mounts of the sensors: their poses in base_link."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim import frames
from lunar_rover_sim.frames import Array, matrix_from_wxyz, R_BODY_OPTICAL, se3, wxyz_from_rpy
from lunar_rover_sim.rover.description import RoverDescription

MAST_RADIUS_M = 0.008   # of the pole that carries the cameras


def imu_pose(rover: RoverDescription) -> Array:
    """Return T_base_imu (4, 4)."""
    return se3(matrix_from_wxyz(wxyz_from_rpy(*np.radians(rover.imu.rpy_deg))),
               rover.imu.position_m)


def lidar_pose(rover: RoverDescription) -> Array:
    """Return T_base_lidar (4, 4): x ahead, z up."""
    return se3(matrix_from_wxyz(wxyz_from_rpy(*np.radians(rover.lidar.rpy_deg))),
               rover.lidar.position_m)


def camera_poses(rover: RoverDescription) -> tuple[Array, Array]:
    """Return T_base_camera (4, 4) of left and right camera: x along the optical axis, y left."""
    tilt = matrix_from_wxyz(wxyz_from_rpy(0.0, np.radians(rover.stereo.pitch_deg), 0.0))
    centre = np.array(rover.stereo.position_m)
    half = 0.5 * rover.stereo.baseline_m * tilt[:, 1]
    return se3(tilt, centre + half), se3(tilt, centre - half)


def optical_poses(rover: RoverDescription) -> tuple[Array, Array]:
    """Return T_base_optical (4, 4) of left and right camera: z along the optical axis, x right."""
    left, right = camera_poses(rover)
    turn = se3(R_BODY_OPTICAL, np.zeros(3))
    return left @ turn, right @ turn


def fixed_frames(rover: RoverDescription) -> tuple[tuple[str, str, Array], ...]:
    """Return (parent, child, (4, 4) T_parent_child) of all frames that do not move on base_link.

    URDF and tf_static are both made from them.
    """
    left, right = camera_poses(rover)
    turn = se3(R_BODY_OPTICAL, np.zeros(3))
    return ((frames.BASE_FRAME, frames.IMU_FRAME, imu_pose(rover)),
            (frames.BASE_FRAME, frames.LIDAR_FRAME, lidar_pose(rover)),
            (frames.BASE_FRAME, frames.LEFT_CAMERA_FRAME, left),
            (frames.LEFT_CAMERA_FRAME, frames.LEFT_OPTICAL_FRAME, turn),
            (frames.BASE_FRAME, frames.RIGHT_CAMERA_FRAME, right),
            (frames.RIGHT_CAMERA_FRAME, frames.RIGHT_OPTICAL_FRAME, turn))
