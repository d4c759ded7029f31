"""The frames of the rover: the mounts of its sensors, its legs, its footprint."""

from __future__ import annotations

import math

import numpy as np

from lunar_rover_sim.base import frames
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, R_BODY_OPTICAL, se3, wxyz_from_rpy
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


def bounds_m(rover: RoverDescription) -> tuple[Array, Array]:
    """Return the lower and the upper corner (3,) [m], base axes, of a box around the rover.

    It holds the chassis, the legs at any joint angle, and the cameras.
    """
    chassis, legs = rover.chassis, rover.legs
    half = 0.5 * np.array([chassis.length_m, chassis.width_m, chassis.height_m])
    across = max(legs.spoke_radius_m, legs.tip_radius_m)
    reach = np.array([legs.spoke_length_m, across, legs.spoke_length_m])
    axles = np.array(legs.axle_positions_m())
    corners = np.concatenate([[-half, half], axles - reach, axles + reach,
                              [T[:3, 3] for T in camera_poses(rover)]])
    return corners.min(axis=0), corners.max(axis=0)


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


class MovingFrames:
    """All frames that move: the content of tf.

    Attributes:
        pairs: (parent, child) of each.
    """

    def __init__(self, rover: RoverDescription, pose: tuple[str, str] | None) -> None:
        """Take parent and child of the pose of base_link.

        None leaves it out, and the footprint. A child other than base_link has no footprint.
        """
        base = frames.BASE_FRAME
        self.pairs = [(base, frames.leg_frame(leg)) for leg in rover.legs.names]
        self._footprint = None
        self._has_pose = pose is not None
        if pose is not None:
            self.pairs.append(pose)
            if pose[1] == base:
                self.pairs.append((base, frames.FOOTPRINT_FRAME))
                self._footprint = Footprint(rover)

    def at(self, T_world_base: Array, T_base_leg: Array) -> list[Array]:
        """Return (4, 4) T_parent_child of each, of (4, 4) base_link and (legs, 4, 4) legs."""
        found = list(T_base_leg)
        if self._has_pose:
            found.append(T_world_base)
        if self._footprint is not None:
            found.append(self._footprint.pose(T_world_base[:3, :3], T_base_leg))
        return found


class Footprint:
    """base_footprint: no roll, no pitch, the yaw of base_link.

    The origin lies vertically below (above) that of base_link, at the height of the lowest point
    of the spheres at the tips of the spokes.
    """

    def __init__(self, rover: RoverDescription) -> None:
        legs = rover.legs
        self._radius_m = legs.tip_radius_m
        self._tips_m = (legs.spoke_length_m - legs.tip_radius_m) * np.array(
            legs.spoke_directions())

    def pose(self, R_world_base: Array, T_base_leg: Array) -> Array:
        """Return T_base_footprint (4, 4), of (3, 3) base_link and (legs, 4, 4) legs."""
        legs = T_base_leg[:, None]
        places = frames.rotated(legs[..., :3, :3], self._tips_m) + legs[..., :3, 3]
        height_m = float(frames.rotated(R_world_base, places)[..., 2].min()) - self._radius_m
        x, y = (R_world_base[:2, 0] / math.hypot(*R_world_base[:2, 0])).tolist()
        axes = np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]])
        return se3(frames.rotated(R_world_base.T, axes).T, R_world_base[2] * height_m)
