"""A body that rears up on soft ground, where legs dig in as it turns, and how it is let down.

Legs that only stand do not let it down: on rough ground it went on from 28 to 46 degrees, and once
over. What raised it is undone while it is up; then it stands. It reads no clock.
"""

from __future__ import annotations

import math

from lunar_rover_sim.base.seconds import NS_PER_S

_LASTING_NS = 600_000_000       # a step rocks the body: a tilt that counts lasts longer
_LET_DOWN_NS = NS_PER_S // 2    # from the time at which it was last up
_UNDO_SHARE = 0.7               # of the velocity at which it reared up
_FURTHER_DEG = 8.0              # than where it began to back off: its legs dig in
_MEAN_S = 2.0                   # a few steps, over which the mean tilt is that of the ground


class Rearing:
    """Notices that the body tilts too far, and says what lets it down.

    Attributes:
        mean_deg: Mean tilt of the last steps: about that of the ground.
    """

    def __init__(self, limit_deg: float, now_ns: int) -> None:
        """Begin with a level body.

        Args:
            limit_deg: Tilt that it must not pass.
        """
        self._limit_deg = self._bound_deg = limit_deg
        self.mean_deg = self._tilt_deg = 0.0
        self._is_up = False
        self._noted_ns = self._level_ns = self._until_ns = now_ns
        self._undo = 0.0, 0.0

    def note_tilt(self, now_ns: int, tilt_deg: float) -> None:
        """Take note of a tilt [deg]."""
        part = 1.0 - math.exp(-(now_ns - self._noted_ns) * 1e-9 / _MEAN_S)
        self.mean_deg += part * (tilt_deg - self.mean_deg)
        if tilt_deg < self._limit_deg - _FURTHER_DEG:
            self._bound_deg = self._limit_deg
        self._tilt_deg = tilt_deg
        self._noted_ns, self._is_up = now_ns, tilt_deg > self._bound_deg
        if not self._is_up:
            self._level_ns = now_ns
        elif not self.lasts(now_ns):
            self._until_ns = now_ns + _LET_DOWN_NS

    def note_motion(self, forward_mps: float, yaw_rate_radps: float) -> None:
        """Take note of a velocity that is commanded, unless it lets the body down."""
        if forward_mps or yaw_rate_radps:
            self._undo = -_UNDO_SHARE * forward_mps, -_UNDO_SHARE * yaw_rate_radps

    def let_down(self, now_ns: int) -> tuple[float, float] | None:
        """Return the velocity [m/s, rad/s] that lets the body down; None where it is not up."""
        if now_ns >= self._until_ns:
            return None
        return self._undo if self._is_up else (0.0, 0.0)

    def lasts(self, now_ns: int) -> bool:
        """Return whether the tilt is beyond the limit for longer than a step rocks the body."""
        return now_ns - self._level_ns >= _LASTING_NS

    def end(self, now_ns: int) -> None:
        """Let it down no more, unless it rises further: something else is done about it.

        On the rim of a crater it is the ground that tilts. Backing off from there was undone, time
        and again, until the body rolled over.
        """
        self._until_ns = now_ns
        self._bound_deg = max(self._limit_deg, self._tilt_deg + _FURTHER_DEG)

    def begin_anew(self, now_ns: int) -> None:
        """Count the time of a tilt from now on, against the limit."""
        self._level_ns, self._bound_deg = now_ns, self._limit_deg
