"""What the sensors beside the images said since the pair before, from their messages."""

from __future__ import annotations

from typing import Any

import numpy as np

from lunar_rover_sim.bag.messages import header_ns, wxyz, xyz
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, rpy_from_wxyz
from lunar_rover_sim.judge.slam.graph.measured import Aids, Inertial, Stars, Sun, Wheels

AIDS = (topics.IMU_RAW, topics.WHEEL_ODOM, topics.SUN_SENSOR, topics.STAR_TRACKER, topics.SUN)
_PLANE = np.ix_([0, 1, 5], [0, 1, 5])


class Collected:
    """What was measured and not yet taken: messages of a bag or of the graph."""

    def __init__(self, T_base_imu: Array) -> None:
        self._R_base_imu = T_base_imu[:3, :3]
        self._imu: list[tuple[int, Any, Any]] = []
        self._wheels: list[tuple[int, Wheels]] = []
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
            pose = message.pose.pose
            yaw = rpy_from_wxyz(wxyz(pose.orientation))[2]
            self._wheels.append((stamp, Wheels(
                np.array([pose.position.x, pose.position.y, yaw]),
                np.reshape(message.pose.covariance, (6, 6))[_PLANE])))
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
        return Aids(inertial, wheels[-1][1] if wheels else None,
                    Sun(*sun[-1], self._to_sun) if sun and self._to_sun is not None else None,
                    stars[-1] if stars else None)
