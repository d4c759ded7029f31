"""The sun over simulated time: it stands still, or it follows its date in small steps.

All that depends on the sun asks here, so that pictures, sensors and topics have one sun. The steps
are equal in time, such that the sun never moves by more than `sun.step_deg` in one of them: the
sun of a time depends on that time alone, not on what was asked before.
"""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.illumination.config import SunConfig
from lunar_rover_sim.illumination.dates import LAST, parse_date, shown
from lunar_rover_sim.illumination.sun_of_date import sun_after
from lunar_rover_sim.seconds import NS_PER_S

# The fastest that the sun goes over the Moon's sky; it is 0.5050 at the slowest.
_FASTEST_DEG_PER_H = 0.511
_NS_PER_H = 3600 * NS_PER_S


class SunPath:
    """The sun at each time of a run.

    Attributes:
        moves: Whether it moves at all.
    """

    def __init__(self, sun: SunConfig) -> None:
        """Prepare; sun: at time 0, as `sun_of_date` returned it."""
        self._sun = sun
        self.moves = bool(sun.date) and sun.rate > 0.0
        self._period_ns = 0
        if self.moves:
            self._period_ns = max(1, int(sun.step_deg / _FASTEST_DEG_PER_H / sun.rate * _NS_PER_H))

    def step(self, stamp_ns: int) -> int:
        """Return the number of the step that a time is in; a sun that stands still has only 0."""
        return stamp_ns // self._period_ns if self.moves else 0

    def start_ns(self, step: int) -> int:
        """Return the time from which the sun of a step holds [ns]."""
        return step * self._period_ns

    def of_step(self, step: int) -> SunConfig:
        """Return the sun of a step; its date is that of the start of the step.

        A sun below -1 deg, where it lights nothing, is returned at -1 deg.

        Raises:
            ConfigError: After the last date of the series.
        """
        if step == 0:
            return self._sun
        return sun_after(self._sun, 1e-9 * self.start_ns(step) * self._sun.rate)


def check_last_date(sun: SunConfig, duration_s: float) -> None:
    """Raise ConfigError if a run ends after the last date of the series."""
    if not sun.date or not np.isfinite(duration_s):
        return
    left_s = float((LAST - parse_date('sun.date', sun.date)) / np.timedelta64(1, 's'))
    if sun.rate * duration_s > left_s:
        raise ConfigError(f'sun.rate: {sun.rate:g} is not valid with a duration of {duration_s:g} '
                          f's from {sun.date}; valid is <= {left_s / duration_s:.4g}, so that the '
                          f'run ends before {shown(LAST)}')
