"""What tells the attitude of the rover besides images: gyroscope, gravity, sun and stars.

The biases of accelerometers and gyroscope walk at random. They are learnt where stars, or images,
tell what was to be measured.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.frames import Array, se3
from lunar_rover_sim.judge.slam.graph.measured import (Aids, Inertial, Stars, Sun, Turns, Up,
                                                       WalkingBias)
from lunar_rover_sim.judge.slam.graph.pose_graph import gate, PoseGraph

EXACT = 1e-5            # standard deviation of what is a choice of the frame [m], [rad]
_GYRO_RAD = 5e-4        # error of a turn by the gyroscope, for each root of a second
# Standard deviations of biases at the start; of a turn by images, what all images have in common;
# how far two attitudes by stars are apart that tell the bias of the gyroscope.
_FIRST_ACCEL_MPS2, _FIRST_GYRO_RADPS = 0.01, 3e-4
_IMAGES_RAD, _STARS_NS = 5e-4, 15_000_000_000
# Gravity is a mean over some seconds, in which a step counts little. The speed changes by so much
# between their ends, and so much of tilt stays.
_UP_NS = 8_000_000_000
_SPEED_CHANGE_MPS, _TILT_RAD = 0.2, math.radians(0.3)
_LEAST_UP_S = 1.0
_ALIKE = 8.0                    # means in a row that an attitude remembers have one bias
# Errors of a sun sensor stay for long: more than its standard deviation for each single factor.
_SUN_RAD, _STARS_RAD = math.radians(0.4), math.radians(0.06)


class Attitude:
    """Turns the rover by its gyroscope, and holds its attitude in a graph.

    Args:
        gravity_mps2: That the accelerometers feel.
        accel_walk: Random walk of their bias [m/s^3/sqrt(Hz)]; 0: they have none.
        gyro_walk: That of the gyroscope [rad/s^2/sqrt(Hz)].
    """

    def __init__(self, gravity_mps2: float, accel_walk: float, gyro_walk: float) -> None:
        self._gravity_mps2, self._turns = gravity_mps2, Turns()
        self._accel_bias = WalkingBias(accel_walk, _FIRST_ACCEL_MPS2 if accel_walk else 0.0)
        self._gyro_bias = WalkingBias(gyro_walk, _FIRST_GYRO_RADPS)
        self._sun: Sun | None = None
        self._stars: Stars | None = None
        self._R_map_sky: Array | None = None    # None: not known yet
        self._before: Stars | None = None       # by which the bias of the gyroscope is learnt next
        self._told_ns = 0       # when stars told the attitude last
        self._up_ns = 0         # of the last factor of gravity or the stars

    def take(self, aids: Aids) -> None:
        """Take what was measured."""
        if aids.inertial is not None:
            self._turns.add(aids.inertial)
        self._sun, self._stars = aids.sun or self._sun, aids.stars or self._stars

    def begin(self, graph: PoseGraph, stamp_ns: int, inertial: Inertial | None) -> bool:
        """Hold the first pose of a graph, key 0, of a rover that stands; its place is the origin.

        Args:
            inertial: Samples up to it.

        Returns:
            Whether the heading is known; else x of the map is where the rover looks.
        """
        self._up_ns = stamp_ns
        begin_ns = stamp_ns if inertial is None or not len(inertial.stamps_ns) \
            else int(inertial.stamps_ns[0]) - 1
        up = self._turns.up(begin_ns, stamp_ns)
        z = np.array([0.0, 0.0, 1.0]) if up is None else (
            up.force_mps2 / np.linalg.norm(up.force_mps2))
        x = np.array([1.0, 0.0, 0.0]) - z[0] * z
        x /= np.linalg.norm(x)
        R = np.array([x, np.cross(z, x), z])        # R_map_base: rows are the map's axes in base
        # Without gravity the map is as the rover stands.
        tilt = 10.0 * EXACT if up is None else math.hypot(
            _TILT_RAD, _FIRST_ACCEL_MPS2 / self._gravity_mps2)
        sigma = np.array([tilt, tilt, EXACT])
        self._R_map_sky = np.eye(3)
        # Without gravity the sun tells no heading.
        sun = None if up is None else self._sun_at(stamp_ns)
        stars = self._stars_at(stamp_ns)
        self._sun = self._stars = None
        if stars is not None:
            R, sigma[:] = stars[0], math.radians(1.0)
        elif sun is not None:
            here, there = R @ sun[0], sun[1]
            yaw = math.atan2(there[1], there[0]) - math.atan2(here[1], here[0])
            R, sigma[2] = Rotation.from_euler('Z', yaw).as_matrix() @ R, math.radians(30.0)
        covariance = EXACT**2 * np.eye(6)
        covariance[:3, :3] = R.T @ np.diag(sigma**2) @ R
        T = se3(R, np.zeros(3))
        graph.add(0, T)
        graph.prior(0, T, covariance)
        if stars is not None:
            graph.attitude(0, *stars)
        elif sun is not None:
            graph.direction(0, sun[1], sun[0], _SUN_RAD)
        else:
            self._R_map_sky = None
        return self._R_map_sky is not None

    def turn(self, start_ns: int, end_ns: int) -> tuple[Array, Array] | None:
        """Return R_start_end (3, 3) by the gyroscope and its covariance; None without samples.

        A bias turns the rover the same way all the time: what it adds to the variance grows with
        the time since stars told the attitude.
        """
        R = self._turns.between(start_ns, end_ns)
        if R is None:
            return None
        dt, gone = (end_ns - start_ns) * 1e-9, max(0.0, (start_ns - self._told_ns) * 1e-9)
        return R, (_GYRO_RAD**2 * dt * np.eye(3)
                   + self._gyro_bias.covariance * (2.0 * gone + dt) * dt)

    def learn_by_images(self, start_ns: int, end_ns: int, told: Array, covariance: Array) -> None:
        """Learn the bias of the gyroscope by R_start_end (3, 3) of images."""
        self._walk_to(end_ns)
        turn = self._turns.between(start_ns, end_ns)
        if turn is not None:
            self._learn_turn(told, turn, covariance + _IMAGES_RAD**2 * np.eye(3),
                             (end_ns - start_ns) * 1e-9)

    def hold(self, graph: PoseGraph, key: int, stamp_ns: int, R_map_base: Array,
             covariance: Array) -> set[str]:
        """Hold the attitude of a keyframe by stars or gravity, and the sun.

        Args:
            R_map_base: (3, 3) as it is believed, with its covariance (3, 3) in base axes.

        Returns:
            Which of `sun` and `stars` contradict it: they are left out.
        """
        refused = set()
        if self._R_map_sky is None:
            self._find_sky(stamp_ns, R_map_base)
        stars = self._stars_at(stamp_ns)
        self._walk_to(stamp_ns)
        if stars is not None:
            error = Rotation.from_matrix(R_map_base.T @ stars[0]).as_rotvec()
            if error @ np.linalg.solve(covariance + stars[1], error) > gate(3):
                refused.add('stars')
                stars = None
            else:
                graph.attitude(key, *stars)
                self._told_ns = stamp_ns
                self._learn_by_stars()
        up = self._up(stamp_ns, stars is not None)
        if up is not None and stars is not None:
            self._learn_force(up, *stars)
        elif up is not None:
            left = up.turn @ self._accel_bias.covariance @ up.turn.T
            graph.direction(key, np.array([0.0, 0.0, 1.0]), self._force(up), math.sqrt(
                _TILT_RAD**2 + (self._speed_variance(up) + _ALIKE * float(
                    np.linalg.eigvalsh(left)[-1])) / self._gravity_mps2**2))
        sun = self._sun_at(stamp_ns)
        if sun is not None:
            error = np.cross(R_map_base.T @ sun[1], sun[0])
            # About the direction itself it tells nothing: that part of the error is 0.
            S = covariance + _SUN_RAD**2 * np.eye(3)
            if error @ np.linalg.solve(S, error) > gate(2):
                refused.add('sun')
            else:
                graph.direction(key, sun[1], sun[0], _SUN_RAD)
        self._sun = self._stars = None
        return refused

    # Gravity

    def _up(self, stamp_ns: int, has_stars: bool) -> Up | None:
        """Return which way is up, if it is time for it or stars tell what it should be."""
        if not has_stars and stamp_ns - self._up_ns < _UP_NS:
            return None
        up = self._turns.up(max(self._up_ns, stamp_ns - _UP_NS), stamp_ns)
        self._up_ns = stamp_ns
        if up is None or up.time_s < _LEAST_UP_S or not (
                0.5 < np.linalg.norm(up.force_mps2) / self._gravity_mps2 < 2.0):
            return None
        return up

    def _force(self, up: Up) -> Array:
        return up.force_mps2 - up.turn @ self._accel_bias.value

    @staticmethod
    def _speed_variance(up: Up) -> float:
        return (_SPEED_CHANGE_MPS / up.time_s)**2

    # Biases

    def _walk_to(self, stamp_ns: int) -> None:
        self._accel_bias.walk_to(stamp_ns)
        self._gyro_bias.walk_to(stamp_ns)

    def _learn_force(self, up: Up, R_map_base: Array, covariance: Array) -> None:
        variance = self._speed_variance(up) + self._gravity_mps2**2 * float(
            np.linalg.eigvalsh(covariance)[-1])
        self._accel_bias.learn(up.turn, self._force(up) - self._gravity_mps2 * R_map_base[2],
                               variance * np.eye(3))

    def _learn_by_stars(self) -> None:
        """Learn the bias of the gyroscope by two attitudes that stars told."""
        stars, before = self._stars, self._before
        assert stars is not None
        if before is not None and stars.stamp_ns - before.stamp_ns < _STARS_NS:
            return
        self._before = stars
        turn = None if before is None else self._turns.between(before.stamp_ns, stars.stamp_ns)
        if before is None or turn is None:
            return
        R = stars.R_map_base
        self._learn_turn(before.R_map_base.T @ R, turn,
                         R.T @ (before.covariance_rad2 + stars.covariance_rad2) @ R,
                         (stars.stamp_ns - before.stamp_ns) * 1e-9)

    def _learn_turn(self, told: Array, by_gyro: Array, covariance: Array, time_s: float) -> None:
        """Learn the bias of the gyroscope by a turn (3, 3) that something else told."""
        self._gyro_bias.learn(
            time_s * np.eye(3), Rotation.from_matrix(told.T @ by_gyro).as_rotvec(),
            covariance + _GYRO_RAD**2 * time_s * np.eye(3))
        self._turns.bias_radps = self._gyro_bias.value

    # Sun and stars

    def _find_sky(self, stamp_ns: int, R_map_base: Array) -> None:
        """Take the turn about z of a map that began without sun and stars, once they are seen."""
        self._R_map_sky = np.eye(3)
        sun, stars = self._sun_at(stamp_ns), self._stars_at(stamp_ns)
        if stars is not None:
            R = R_map_base @ stars[0].T
            yaw = math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
        elif sun is not None:
            here, there = R_map_base @ sun[0], sun[1]
            yaw = math.atan2(here[1], here[0]) - math.atan2(there[1], there[0])
        else:
            self._R_map_sky = None
            return
        self._R_map_sky = np.asarray(Rotation.from_euler('Z', yaw).as_matrix())

    def _sun_at(self, stamp_ns: int) -> tuple[Array, Array] | None:
        """Return the direction to the sun in base axes at a stamp, and that in the map."""
        if self._sun is None or self._R_map_sky is None:
            return None
        turn = self._turns.between(stamp_ns, self._sun.stamp_ns)
        return None if turn is None else (turn @ self._sun.in_base,
                                          self._R_map_sky @ self._sun.in_map)

    def _stars_at(self, stamp_ns: int) -> tuple[Array, Array] | None:
        """Return R_map_base at a stamp and its covariance (3, 3) in base axes."""
        if self._stars is None or self._R_map_sky is None:
            return None
        turn = self._turns.between(self._stars.stamp_ns, stamp_ns)
        if turn is None:
            return None
        R = self._stars.R_map_base @ turn
        return (self._R_map_sky @ R,
                R.T @ self._stars.covariance_rad2 @ R + _STARS_RAD**2 * np.eye(3))
