"""A stride: what the four legs are asked to do, as a calibration answers a velocity."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Stride:
    """The settings of the gait that make one velocity.

    phase_rate_hz: cycles per second of all legs, >= 0
    duty_offset: added to the duty factor on the left, taken from it on the right; positive turns
        left, because the left feet then move more slowly and stand longer
    left_sweep, right_sweep: factor on the foot width of that side, -1 to 1; the sign is the
        direction in which its legs turn
    """

    phase_rate_hz: float = 0.0
    duty_offset: float = 0.0
    left_sweep: float = 1.0
    right_sweep: float = 1.0

    @property
    def stands(self) -> bool:
        """Whether nothing moves."""
        return self.phase_rate_hz == 0.0


STAND = Stride()
