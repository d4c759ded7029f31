"""What the navigator commands, and what it says of it."""

from __future__ import annotations

import dataclasses
import enum


class Status(str, enum.Enum):
    """What the navigator is doing."""

    IDLE = 'idle'
    WAITING = 'waiting'
    FOLLOWING = 'following'
    LOOKING = 'looking'
    BACKING = 'backing off'
    LETTING_DOWN = 'letting down'   # the body, by standing
    TURNING = 'turning'         # at the goal, to its heading
    ARRIVED = 'arrived'
    FAILED = 'failed'

    @property
    def is_end(self) -> bool:
        """Whether the drive is over."""
        return self in (Status.ARRIVED, Status.FAILED)


class Failure(str, enum.Enum):
    """Why the navigator gives up."""

    BLOCKED = 'blocked'
    STUCK = 'stuck'
    LOST = 'lost'
    TILT = 'tilt'


@dataclasses.dataclass(frozen=True)
class NavigatorCommand:
    """A velocity, and what the navigator is doing.

    Attributes:
        reason: One line for people.
        failure: Why it has given up; None: it has not.
    """

    forward_mps: float
    yaw_rate_radps: float
    status: Status
    reason: str = ''
    failure: Failure | None = None


def still(status: Status, reason: str) -> NavigatorCommand:
    """Return the command to stand."""
    return NavigatorCommand(0.0, 0.0, status, reason)
