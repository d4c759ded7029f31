"""Simulated time that follows the wall clock, and what is said where it cannot."""

from __future__ import annotations

import time
from typing import Any

# Wall times: the first report comes early, for short runs.
_FIRST_REPORT_S, _REPORT_S = 5.0, 60.0


class WallPace:
    """How much simulated time is due by the wall clock at a real-time factor.

    most_periods: what may be made up for at once; what is more is given up, and reported once a
        minute with the factor that was reached in the mean since the last report
    """

    def __init__(self, factor: float, period_ns: int, most_periods: int, logger: Any) -> None:
        self._factor = factor
        self._period_ns = period_ns
        self._most = most_periods
        self._logger = logger
        self._given_up_s = 0.0
        self._report_due_s = _FIRST_REPORT_S
        self.restart(0)

    def restart(self, now_ns: int) -> None:
        """Count from simulated time `now_ns` [ns] and the present wall time on."""
        self._wall_s, self._start_ns = time.monotonic(), now_ns
        self._report_wall_s, self._report_ns = self._wall_s, now_ns

    def due_periods(self, now_ns: int) -> int:
        """Return how many periods are due at simulated time `now_ns` [ns]."""
        wall_s = time.monotonic()
        due_ns = self._start_ns + round((wall_s - self._wall_s) * 1e9 * self._factor)
        behind = (due_ns - now_ns) // self._period_ns
        if behind <= self._most:
            return behind
        self._given_up_s += behind * self._period_ns / 1e9
        self._wall_s, self._start_ns = wall_s, now_ns
        elapsed_s = wall_s - self._report_wall_s
        if elapsed_s >= self._report_due_s:
            reached = (now_ns - self._report_ns) / 1e9 / elapsed_s
            self._logger.warning(
                f'real_time_factor {self._factor:g} is not reached: {reached:.2f} in the mean of '
                f'{elapsed_s:.0f} s, {self._given_up_s:.1f} s given up so far')
            self._report_wall_s, self._report_ns = wall_s, now_ns
            self._report_due_s = _REPORT_S
        return 1
