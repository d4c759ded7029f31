"""Poses for map and navigator from estimators that do not give the whole pose in `odom`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.frames import Array, inverse, matrix_from_wxyz, se3, wxyz_from_rpy

_LEVEL_S = 4.0      # over which the accelerometer levels the gyroscope: several steps
JUMP_M = 0.5        # a pose that moves by more at once is elsewhere, as where a place is found
_NEAR_M, _NEAR_RAD = 0.5, 0.35      # from what the wheels say; farther away is another map


class AnchoredPoses:
    """Poses of a SLAM program in maps of its own, anchored in the world.

    A rover knows where it starts. Afterwards the estimate counts. A program that has lost its
    track begins another map, somewhere, and may find back into an earlier one: wheels say where
    the rover is meanwhile, and which map a pose is of. A loop that is closed moves the poses of
    one map, which is followed.
    """

    def __init__(self, T_base_sensor: ArrayLike) -> None:
        """Take poses of a sensor that is mounted at T_base_sensor (4, 4)."""
        self._T_sensor_base = inverse(T_base_sensor)
        self.restart()

    def restart(self) -> None:
        """Anchor anew with the next pose."""
        self._maps: list[Array] = []                    # (4, 4) T_world_map of each
        self._map = 0
        self._last: tuple[Array, Array] | None = None   # the last pose, and that of the wheels
        self._lost = False

    @property
    def is_anchored(self) -> bool:
        """Whether a pose has been anchored."""
        return bool(self._maps)

    @property
    def maps(self) -> int:
        """Number of maps that have been begun."""
        return len(self._maps)

    def lose(self) -> None:
        """Take note that the program has lost its track."""
        self._lost = True

    def base(self, T_map_sensor: ArrayLike, T_wheels: ArrayLike,
             T_world_base: ArrayLike | None = None) -> Array:
        """Return T_world_base (4, 4) of a pose.

        Args:
            T_map_sensor: (4, 4) of the estimate.
            T_wheels: (4, 4) pose of the base by wheels and IMU at that time.
            T_world_base: (4, 4) start of the rover, needed for the first pose only.
        """
        T_map_base = np.asarray(T_map_sensor, float) @ self._T_sensor_base
        wheels = np.asarray(T_wheels, float)
        if self._last is None:
            self._maps = [np.asarray(T_world_base, float) @ inverse(T_map_base)]
        else:
            before, wheels_before = self._last
            expected = before @ inverse(wheels_before) @ wheels
            far = [_farness(expected, T_world_map @ T_map_base) for T_world_map in self._maps]
            if far[self._map] > 1.0:
                if min(far) <= 1.0:
                    self._map = int(np.argmin(far))
                elif self._lost:
                    self._map = len(self._maps)
                    self._maps.append(expected @ inverse(T_map_base))
        self._lost = False
        pose = self._maps[self._map] @ T_map_base
        self._last = pose, wheels
        return pose


def _farness(expected: Array, pose: Array) -> float:
    """Return how far a pose (4, 4) is from another one; up to 1 they can be the same."""
    cosine = 0.5 * (float(np.trace(expected[:3, :3].T @ pose[:3, :3])) - 1.0)
    return max(float(np.linalg.norm(expected[:3, 3] - pose[:3, 3])) / _NEAR_M,
               math.acos(min(max(cosine, -1.0), 1.0)) / _NEAR_RAD)


class LevelledWheels:
    """Dead reckoning: the way by the wheels, all angles by the IMU.

    Legs slip most where they turn, so the heading of the wheels walks off; that of the gyroscope
    does so by its bias only. The accelerometer levels pitch and roll slowly (complementary
    filter). Height follows from the way and its pitch.
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin anew."""
        self._roll = self._pitch = self._yaw = 0.0
        self._imu_ns: int | None = None
        self._position: Array | None = None     # (3,) in the world
        self._before: Array = np.zeros(3)       # last pose of the wheels

    def add_imu(self, stamp_ns: int, rate_radps: ArrayLike, force_mps2: ArrayLike) -> None:
        """Take a sample: rates (3,) and specific force (3,), base axes."""
        rate, force = np.asarray(rate_radps, float), np.asarray(force_mps2, float)
        if not (np.isfinite(rate).all() and np.isfinite(force).all()):
            return
        roll = math.atan2(force[1], force[2])
        pitch = math.atan2(-force[0], math.hypot(force[1], force[2]))
        if self._imu_ns is None:
            self._roll, self._pitch = roll, pitch
        else:
            dt = (stamp_ns - self._imu_ns) * 1e-9
            share = min(max(dt / _LEVEL_S, 0.0), 1.0)
            c, s = math.cos(self._roll), math.sin(self._roll)
            tangent = math.tan(max(-1.4, min(1.4, self._pitch)))
            about = s * rate[1] + c * rate[2]
            self._yaw += dt * about * math.hypot(1.0, tangent)      # 1 / cos pitch
            self._roll += dt * (rate[0] + tangent * about)
            self._pitch += dt * (c * rate[1] - s * rate[2])
            self._roll += share * math.remainder(roll - self._roll, 2.0 * math.pi)
            self._pitch += share * (pitch - self._pitch)
        self._imu_ns = stamp_ns

    def base(self, xy_yaw: ArrayLike, T_world_base: ArrayLike | None = None) -> Array:
        """Return T_world_base (4, 4) at a pose (3,) of the odometry: x, y [m] and yaw [rad].

        Args:
            T_world_base: (4, 4) start of the rover, needed for the first pose only.
        """
        pose = np.asarray(xy_yaw, float)
        if self._position is None:
            T = np.asarray(T_world_base, float)
            self._yaw = math.atan2(T[1, 0], T[0, 0])
            self._position, self._before = T[:3, 3].copy(), pose
        step = pose[:2] - self._before[:2]
        # The heading of a step is the mean of those at its ends.
        heading = 0.5 * (self._before[2] + pose[2])
        along = step[0] * math.cos(heading) + step[1] * math.sin(heading)
        self._before = pose
        R = np.asarray(matrix_from_wxyz(wxyz_from_rpy(self._roll, self._pitch, self._yaw)))
        self._position = self._position + along * R[:, 0]
        return se3(R, self._position)
