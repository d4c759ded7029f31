"""Velocity profiles: timed velocities."""

from __future__ import annotations

import bisect

from lunar_rover_sim.path_following.config import DriveConfig


class VelocityProfile:
    """Velocities that begin at their times and hold, or ramp, until the next; the last holds.

    The profile is done at the time of its last velocity, if that is zero.
    """

    def __init__(self, config: DriveConfig) -> None:
        self._times_s = config.profile_times_s
        self._velocities = tuple(zip(config.profile_forward_mps, config.profile_yaw_rate_radps))
        self._ramp = config.profile_ramp

    def at(self, time_s: float) -> tuple[float, float]:
        """Return forward velocity [m/s] and yaw rate [rad/s] at a time [s] of the drive."""
        k = bisect.bisect_right(self._times_s, time_s) - 1
        if k < 0:
            return 0.0, 0.0
        forward, yaw = self._velocities[k]
        if self._ramp and k + 1 < len(self._times_s):
            x = (time_s - self._times_s[k]) / (self._times_s[k + 1] - self._times_s[k])
            next_forward, next_yaw = self._velocities[k + 1]
            return forward + x * (next_forward - forward), yaw + x * (next_yaw - yaw)
        return forward, yaw

    def done(self, time_s: float) -> bool:
        """Return whether the rover only stands from this time on."""
        return self._velocities[-1] == (0.0, 0.0) and time_s >= self._times_s[-1]
