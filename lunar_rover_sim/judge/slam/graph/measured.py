"""What the graph is given with a pair of images: inertial samples, wheels, sun and stars.

`Collected` makes it of messages.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lunar_rover_sim.bag.messages import header_ns, wxyz, xyz
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, rpy_from_wxyz

_MEMORY_NS = 30_000_000_000     # of inertial samples


class Wheels(NamedTuple):
    """Wheel odometry at the stamp of an image: x, y, yaw (3,) and their covariance (3, 3)."""

    pose: Array
    covariance: Array


class Sun(NamedTuple):
    """A direction to the sun: stamp [ns], (3,) in base axes, and the true one, (3,) in the map."""

    stamp_ns: int
    in_base: Array
    in_map: Array


class Stars(NamedTuple):
    """An attitude: stamp [ns], R_map_base (3, 3), covariance (3, 3) about map axes [rad^2]."""

    stamp_ns: int
    R_map_base: Array
    covariance_rad2: Array


class Inertial(NamedTuple):
    """Samples in base axes: stamps (n,) [ns], rates (n, 3) [rad/s], forces (n, 3) [m/s^2]."""

    stamps_ns: NDArray[np.int64]
    rates_radps: Array
    forces_mps2: Array

    def part(self, first: int, last: int | None = None) -> Inertial:
        """Return the samples from the first to before the last."""
        return Inertial(self.stamps_ns[first:last], self.rates_radps[first:last],
                        self.forces_mps2[first:last])


@dataclasses.dataclass(frozen=True)
class Aids:
    """What comes beside a pair of images; None where nobody measured it.

    Attributes:
        inertial: Samples since the pair before.
        wheels: At the stamp of the pair.
        sun, stars: The newest since the pair before.
    """

    inertial: Inertial | None = None
    wheels: Wheels | None = None
    sun: Sun | None = None
    stars: Stars | None = None


class Up(NamedTuple):
    """Where a mean of the specific force says that up is.

    Attributes:
        force_mps2: (3,) mean, in the axes at the end.
        turn: (3, 3) mean of R_end_sample: what a bias of the samples has become in it.
        time_s: Over which it is a mean.
    """

    force_mps2: Array
    turn: Array
    time_s: float


class WalkingBias:
    """A bias that walks at random, learnt where something else tells what was to be measured.

    Attributes:
        value: (3,) bias.
        covariance: (3, 3) of it.
    """

    def __init__(self, walk: float, first: float) -> None:
        """Begin.

        Args:
            walk: Random walk, units of the bias for each root of a second.
            first: Standard deviation at the start.
        """
        self._walk, self._ns = walk, 0
        self.value, self.covariance = np.zeros(3), first**2 * np.eye(3)

    def walk_to(self, stamp_ns: int) -> None:
        """Take it that time has passed."""
        if self._ns:
            self.covariance += self._walk**2 * (stamp_ns - self._ns) * 1e-9 * np.eye(3)
        self._ns = stamp_ns

    def learn(self, H: Array, off: Array, covariance: Array) -> None:
        """Take by how much a measurement was off (3,), beside `H @ value`, as a Kalman filter."""
        S = H @ self.covariance @ H.T + covariance
        gain = np.linalg.solve(S, H @ self.covariance).T
        self.value = self.value + gain @ off
        self.covariance = self.covariance - gain @ H @ self.covariance


class Turns:
    """Rotations between stamps, and which way is up, from the last inertial samples.

    Attributes:
        bias_radps: (3,) bias of the rates, which is taken off.
    """

    def __init__(self) -> None:
        self._samples = Inertial(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
        self.bias_radps = np.zeros(3)

    def add(self, inertial: Inertial) -> None:
        """Take samples; those that are old are forgotten."""
        before = self._samples
        stamps = np.concatenate([before.stamps_ns, inertial.stamps_ns])
        if not len(stamps):
            return
        self._samples = Inertial(
            stamps, np.concatenate([before.rates_radps, inertial.rates_radps]),
            np.concatenate([before.forces_mps2, inertial.forces_mps2])).part(
                int(np.searchsorted(stamps, stamps[-1] - _MEMORY_NS)))

    def between(self, start_ns: int, end_ns: int) -> Array | None:
        """Return R_start_end (3, 3); None where the samples do not cover the time."""
        if end_ns < start_ns:
            back = self.between(end_ns, start_ns)
            return None if back is None else back.T
        if start_ns == end_ns:
            return np.eye(3)
        within = self._within(start_ns, end_ns)
        if within is None:
            return None
        steps_s = np.diff(within.stamps_ns, prepend=start_ns) * 1e-9
        return _products((within.rates_radps - self.bias_radps) * steps_s[:, None])[-1]

    def up(self, start_ns: int, end_ns: int) -> Up | None:
        """Return the mean specific force; None where the samples do not cover the time."""
        within = self._within(start_ns, end_ns)
        if within is None or end_ns <= start_ns:
            return None
        steps_s = np.diff(within.stamps_ns, append=end_ns) * 1e-9
        # R_end_sample, the last sample first.
        turns = _products(((self.bias_radps - within.rates_radps) * steps_s[:, None])[::-1])
        forces = turns @ within.forces_mps2[::-1, :, None]
        return Up(forces[:, :, 0].mean(axis=0), turns.mean(axis=0), (end_ns - start_ns) * 1e-9)

    def _within(self, start_ns: int, end_ns: int) -> Inertial | None:
        stamps = self._samples.stamps_ns
        first, last = np.searchsorted(stamps, [start_ns, end_ns], side='right')
        most_ns = 1.5 * (end_ns - start_ns) / max(1, last - first)
        if (first == last or stamps[first] - start_ns > most_ns
                or end_ns - stamps[last - 1] > most_ns):
            return None
        return self._samples.part(first, last)


def _products(rotvecs_rad: Array) -> Array:
    """Return (n, 3, 3) rotations: the product of the first, of the first two, and so on."""
    turns = np.asarray(Rotation.from_rotvec(rotvecs_rad).as_matrix())
    apart = 1
    while apart < len(turns):
        turns[apart:] = turns[:-apart] @ turns[apart:]
        apart *= 2
    return turns


AIDS = (topics.IMU_RAW, topics.WHEEL_ODOM, topics.SUN_SENSOR, topics.STAR_TRACKER, topics.SUN)
_PLANE = np.ix_([0, 1, 5], [0, 1, 5])


class Collected:
    """What was measured and not yet taken: messages of a bag or of the graph."""

    def __init__(self, T_base_imu: Array) -> None:
        self._R_base_imu = T_base_imu[:3, :3]
        self._imu: list[tuple[int, Any, Any]] = []
        self._wheels: list[tuple[int, Any]] = []
        self._sun: list[tuple[int, Array]] = []
        self._stars: list[Stars] = []
        self._to_sun: Array | None = None
        self._newest_ns = {topics.IMU_RAW: -1, topics.WHEEL_ODOM: -1}

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample of the IMU or the wheels."""
        return max(self._newest_ns.values())

    def has_until(self, stamp_ns: int) -> bool:
        """Return whether samples of both the IMU and the wheels have come up to a stamp."""
        return min(self._newest_ns.values()) >= stamp_ns

    def add(self, topic: topics.Topic, message: Any) -> None:
        """Take a message."""
        stamp = header_ns(message)
        if topic in self._newest_ns:
            self._newest_ns[topic] = max(self._newest_ns[topic], stamp)
        if topic is topics.SUN:
            self._to_sun = np.array(xyz(message.vector))
            return
        if topic is topics.IMU_RAW:
            self._imu.append((stamp, xyz(message.angular_velocity),
                              xyz(message.linear_acceleration)))
        elif topic is topics.WHEEL_ODOM:
            self._wheels.append((stamp, message.pose))
        elif topic is topics.SUN_SENSOR:
            self._sun.append((stamp, np.array(xyz(message.vector))))
        else:
            self._stars.append(Stars(stamp, matrix_from_wxyz(wxyz(message.orientation)),
                                     np.reshape(message.orientation_covariance, (3, 3))))

    def take(self, stamp_ns: int) -> Aids:
        """Return what was measured up to a stamp, and forget it."""
        imu = [s for s in self._imu if s[0] <= stamp_ns]
        self._imu = self._imu[len(imu):]
        wheels = [s for s in self._wheels if s[0] <= stamp_ns]
        self._wheels = self._wheels[len(wheels):]
        sun = [s for s in self._sun if s[0] <= stamp_ns]
        self._sun = self._sun[len(sun):]
        stars = [s for s in self._stars if s.stamp_ns <= stamp_ns]
        self._stars = self._stars[len(stars):]
        inertial = None
        if imu:
            ns, rates, forces = zip(*imu)
            inertial = Inertial(np.array(ns, np.int64), np.array(rates) @ self._R_base_imu.T,
                                np.array(forces) @ self._R_base_imu.T)
        return Aids(inertial, _wheels(wheels[-1][1]) if wheels else None,
                    Sun(*sun[-1], self._to_sun) if sun and self._to_sun is not None else None,
                    stars[-1] if stars else None)


def _wheels(told: Any) -> Wheels:
    """Return what a geometry_msgs/PoseWithCovariance says of the plane."""
    position, yaw = told.pose.position, rpy_from_wxyz(wxyz(told.pose.orientation))[2]
    return Wheels(np.array([position.x, position.y, yaw]),
                  np.reshape(told.covariance, (6, 6))[_PLANE])
