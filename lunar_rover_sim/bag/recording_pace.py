"""How fast a recording went: simulated time over wall time."""

from __future__ import annotations

from contextlib import suppress
import math
import time

from lunar_rover_sim.bag.reader import Bag, information

REAL_TIME_FACTOR = 'real_time_factor'   # key in custom_data of metadata.yaml


def recorded_factor(bag: Bag) -> float | None:
    """Return the real-time factor of a recording; None where its metadata does not say."""
    # A bag may be a single file, and its metadata another tool's.
    with suppress(OSError, LookupError, TypeError, ValueError):
        factor = float(information(bag.path)['custom_data'][REAL_TIME_FACTOR])
        return factor if math.isfinite(factor) and factor > 0.0 else None
    return None


class RecordingPace:
    """Measures the real-time factor of a recording while it goes on.

    It counts from the moment when bag time first moves on: what nodes do before their first step,
    such as building a world, is not part of it. A time that starts anew goes on counting.
    """

    def __init__(self) -> None:
        self._newest_ns = self._advanced_ns = 0
        self._start_s: float | None = None
        self._end_s = 0.0

    def note(self, newest_ns: int) -> None:
        """Take the newest bag time [ns] at this moment."""
        if newest_ns > self._newest_ns:
            self._end_s = time.monotonic()
            if self._start_s is None:
                self._start_s = self._end_s
            else:
                self._advanced_ns += newest_ns - self._newest_ns
        self._newest_ns = newest_ns

    @property
    def real_time_factor(self) -> float | None:
        """Simulated time over wall time so far; None before bag time has moved on twice."""
        if self._start_s is None or self._end_s <= self._start_s:
            return None
        return self._advanced_ns / 1e9 / (self._end_s - self._start_s)
