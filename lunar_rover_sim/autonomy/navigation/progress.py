"""Whether the rover gets on: it moves, and it comes nearer to its goal. It reads no clock."""

from __future__ import annotations

from collections import deque
import math

from lunar_rover_sim.base.frames import Array

STUCK_M = 0.12              # least motion within the time after which it is stuck
_METRES_PER_RADIAN = 0.3    # weight of turning, where motion is looked at
_CHECK_NS = 100_000_000
_NEARER_M = 0.3             # progress to the goal that counts
_RECOVERED_M = 1.0          # nearer by this, earlier recoveries do not count any more


class Progress:
    """Notices that the rover is stuck, or comes no nearer to its goal.

    Attributes:
        heading_rad: Of the newest pose of which it has taken note.
        recoveries: How often it has recovered without coming nearer since.
        best_m: What was left of the way where least was left.
    """

    def __init__(self, stuck_time_s: float, now_ns: int) -> None:
        """Begin.

        Args:
            stuck_time_s: Without motion for so long, it is stuck.
        """
        self._stuck_ns = stuck_time_s * 1e9
        self._history: deque[tuple[int, float, float, float]] = deque()
        self._turned, self.heading_rad = 0.0, 0.0
        self.begin_anew(now_ns)

    def begin_anew(self, now_ns: int) -> None:
        """Count recoveries, and what is left of the way, from now on."""
        self.recoveries = 0
        self.best_m, self._best_ns, self._recovered_m = math.inf, now_ns, math.inf

    def wait(self, now_ns: int) -> None:
        """Count the time without progress from now on."""
        self._best_ns = now_ns

    def stand(self) -> None:
        """Count the time without motion anew: it stands because it was told to."""
        self._history.clear()

    def note_motion(self, now_ns: int, position: Array, heading_rad: float) -> None:
        """Take note of a pose, ten times a second at most."""
        if self._history and now_ns - self._history[-1][0] < _CHECK_NS:
            return
        self._turned += math.remainder(heading_rad - self.heading_rad, 2.0 * math.pi)
        self.heading_rad = heading_rad
        self._history.append((now_ns, position[0], position[1], self._turned))
        while len(self._history) > 1 and now_ns - self._history[1][0] >= self._stuck_ns:
            self._history.popleft()

    @property
    def is_stuck(self) -> bool:
        """Whether it has neither moved nor turned for too long."""
        first, last = self._history[0], self._history[-1]
        if last[0] - first[0] < self._stuck_ns:
            return False
        moved = max(math.hypot(last[1] - x, last[2] - y)
                    + _METRES_PER_RADIAN * abs(last[3] - turned)
                    for _, x, y, turned in self._history)
        return moved < STUCK_M

    def note_left(self, now_ns: int, left_m: float) -> float:
        """Take note of what is left of the way; return since when it is not less [s]."""
        if left_m < self.best_m - _NEARER_M:
            self.best_m, self._best_ns = left_m, now_ns
        if left_m < self._recovered_m - _RECOVERED_M:
            self._recovered_m, self.recoveries = left_m, 0
        return (now_ns - self._best_ns) * 1e-9
