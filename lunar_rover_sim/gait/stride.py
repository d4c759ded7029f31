"""Strides: the settings of the gait into which a calibration maps a velocity."""

from __future__ import annotations

import dataclasses

MAX_DUTY_OFFSET = 0.2
_OFFSET_ALONE = 0.4   # up to this turn, the duty offset alone turns the rover
_OFFSET_HELD = 0.6    # it is held up to this share of the rest, past the reversal of the sweep


@dataclasses.dataclass(frozen=True)
class Stride:
    """The settings of the gait that make one velocity.

    Attributes:
        phase_rate_hz: Cycles per second of all legs, >= 0.
        duty_offset: Added to the duty factor on the left, taken from it on the right; positive
            turns left, because the left feet then move more slowly and stand longer.
        left_sweep, right_sweep: Factor on the foot width of that side, -1 to 1; the sign is the
            direction in which its legs turn.
    """

    phase_rate_hz: float = 0.0
    duty_offset: float = 0.0
    left_sweep: float = 1.0
    right_sweep: float = 1.0

    @classmethod
    def turning(cls, phase_rate_hz: float, turn: float) -> Stride:
        """Return the forward stride of one turn: 0 straight on, 1 left on the spot, -1 right.

        The duty offset alone, up to `MAX_DUTY_OFFSET`, makes wide curves. In tighter ones the
        inner side shortens its sweep and then reverses it, and at last the offset returns to 0:
        on the spot both sides do the same in opposite directions.
        """
        amount = abs(turn)
        beyond = max(0.0, (amount - _OFFSET_ALONE) / (1.0 - _OFFSET_ALONE))
        offset = MAX_DUTY_OFFSET * min(amount / _OFFSET_ALONE, 1.0,
                                       (1.0 - beyond) / (1.0 - _OFFSET_HELD))
        inner = 1.0 - 2.0 * beyond
        if turn < 0.0:
            return cls(phase_rate_hz, -offset, 1.0, inner)
        return cls(phase_rate_hz, offset, inner, 1.0)

    @property
    def stands(self) -> bool:
        """Whether no leg moves."""
        return self.phase_rate_hz == 0.0

    def reversed(self) -> Stride:
        """Return the same motion backward.

        The speed changes its sign and, since the same side still moves less, so does the yaw rate.
        """
        return dataclasses.replace(self, left_sweep=-self.left_sweep,
                                   right_sweep=-self.right_sweep)


STAND = Stride()
