"""Motion of the sensor during a scan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.frames import Array, se3
from lunar_rover_sim.rover.pose import leg_values, Posed


class ScanMotion:
    """Poses of base_link over a scan.

    Args:
        times_s: (k,) since its start, ascending, k >= 2.
        T_world_base: (k, 4, 4). Between them positions are interpolated linearly and orientations
            along great arcs; before the first and after the last the pose stands.
        joint_angle_rad: (k, legs) in the order of the rover's legs, which may be left out: then
            legs are where no beam meets them.
    """

    def __init__(self, times_s: Sequence[float] | Array, T_world_base: Sequence[Array],
                 joint_angle_rad: Sequence[Array] | Array | None = None) -> None:
        self._times_s = np.asarray(times_s, float)
        self._angle_rad = None if joint_angle_rad is None else np.asarray(joint_angle_rad, float)
        poses = np.asarray(T_world_base, float)
        self._position_m = poses[:, :3, 3]
        # From one pose to the next it turns about one axis: Rodrigues' formula,
        # R (1 + sin a K + (1 - cos a) K K) with K u = axis x u.
        R = self._R = poses[:-1, :3, :3]
        turn = Rotation.from_matrix(R.transpose(0, 2, 1) @ poses[1:, :3, :3]).as_rotvec()
        self._turn_rad = np.linalg.norm(turn, axis=1)
        axis = turn / np.maximum(self._turn_rad, 1e-12)[:, None]
        K = -np.cross(axis[:, None, :], np.eye(3))
        self._R_K, self._R_K_K = R @ K, R @ K @ K

    @classmethod
    def of(cls, state: Posed, duration_s: float, legs: int) -> ScanMotion:
        """Return the motion of a rover that keeps its velocities for some time [s].

        Args:
            legs: How many it has.
        """
        # Poses of a constant twist lie on a screw; short chords are close to it.
        times = np.linspace(0.0, duration_s, 33)
        rate, velocity = state.angular_velocity_radps, state.linear_velocity_mps
        turn = Rotation.from_rotvec(np.outer(times, rate)).as_matrix()
        # Velocity is constant in the axes of the body, which turn: the trapezoidal rule.
        along = turn @ np.asarray(velocity, float)
        step = times[1]
        moved = np.zeros((len(times), 3))
        moved[1:] = np.cumsum(0.5 * step * (along[1:] + along[:-1]), axis=0)
        start = np.asarray(state.T_world_base, float)
        angles = leg_values(state.joint_angle_rad, legs) + np.outer(
            times, leg_values(state.joint_velocity_radps, legs))
        return cls(times, [start @ se3(R, p) for R, p in zip(turn, moved)], angles)

    def joint_angles(self, times_s: Array) -> Array | None:
        """Return (m, 4) leg angles [rad] at (m,) times [s], None where they are not known."""
        if self._angle_rad is None:
            return None
        return np.stack([np.interp(times_s, self._times_s, angle)
                         for angle in self._angle_rad.T], axis=-1)

    def at(self, times_s: Array) -> tuple[Array, Array]:
        """Return (m, 3, 3) rotations and (m, 3) positions of base_link at (m,) times [s]."""
        known = self._times_s
        times = np.clip(times_s, known[0], known[-1])
        position = np.stack([np.interp(times, known, axis) for axis in self._position_m.T],
                            axis=-1)
        k = np.clip(np.searchsorted(known, times, side='right') - 1, 0, len(known) - 2)
        angle = self._turn_rad[k] * (times - known[k]) / (known[k + 1] - known[k])
        R = (self._R[k] + np.sin(angle)[:, None, None] * self._R_K[k]
             + (1.0 - np.cos(angle))[:, None, None] * self._R_K_K[k])
        return R, position
