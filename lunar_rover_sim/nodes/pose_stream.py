"""States to another simulator, one after the other: what waits, what is left out, what is told."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import dataclasses
import time
from typing import Protocol

from lunar_rover_sim.base.frames import Array

OVERTAKEN, FAILED, UNANSWERED = 'Overtaken states', 'Refused states', 'Unanswered calls'
_RETRY_S = 1.0
_TELL_S = 60.0


@dataclasses.dataclass(frozen=True)
class BridgedState:
    """One state as another simulator is to show it.

    Attributes:
        poses: Entity → (4, 4) pose in the other simulator's world; the first one is base_link.
        linear_mps, angular_radps: (3,) velocity of base_link, axes of that world.
    """

    stamp_ns: int
    poses: Mapping[str, Array]
    linear_mps: Array
    angular_radps: Array


class PoseTarget(Protocol):
    """The interface of another simulator."""

    @property
    def is_ready(self) -> bool:
        """Whether somebody is there."""

    def send(self, state: BridgedState, done: Callable[[str], None]) -> None:
        """Send one state; call `done` once it is taken, with '', or refused, with the reason."""

    def give_up(self) -> None:
        """Forget the state that was sent last: its `done` is not called any more."""


class PoseStream:
    """Sends one state at a time. Of those that come meanwhile the newest one waits.

    A state that was refused, or not answered, is sent again after a second, unless a newer one has
    come: so the other simulator shows the newest state, however slow it is.

    Args:
        target: The other simulator.
        answer_s: Wall time that an answer may take [s].
        taken: Called with the stamp [ns] of each state that the other simulator has taken.
        lost: Called with the kind and the reason of each loss.
        clock: Returns wall time [s].
    """

    def __init__(self, target: PoseTarget, answer_s: float, taken: Callable[[int], None],
                 lost: Callable[[str, str], None],
                 clock: Callable[[], float] = time.monotonic) -> None:
        self._target = target
        self._answer_s = answer_s
        self._taken, self._lost, self._clock = taken, lost, clock
        self._waiting: BridgedState | None = None
        self._under_way: BridgedState | None = None
        self._sent_s = 0.0
        self._not_before_s = clock()

    def put(self, state: BridgedState) -> None:
        """Take a new state; it replaces the one that waits."""
        if self._waiting is not None:
            self._lost(OVERTAKEN, 'the other simulator is slower than the rate')
        self._waiting = state
        self.advance()

    def advance(self) -> None:
        """Send what waits, if its turn has come; to be called now and then."""
        now_s = self._clock()
        if self._under_way is not None and now_s - self._sent_s > self._answer_s:
            self._target.give_up()
            self._failed(UNANSWERED, f'no answer for {self._answer_s:g} s')
        if (self._waiting is None or self._under_way is not None or now_s < self._not_before_s
                or not self._target.is_ready):
            return
        self._under_way, self._waiting = self._waiting, None
        self._sent_s = now_s
        self._target.send(self._under_way, self._done)

    def _done(self, problem: str) -> None:
        state = self._under_way
        if problem:
            self._failed(FAILED, problem)
        elif state is not None:
            self._under_way = None
            self._taken(state.stamp_ns)
        self.advance()

    def _failed(self, kind: str, reason: str) -> None:
        self._waiting = self._waiting or self._under_way
        self._under_way = None
        self._not_before_s = self._clock() + _RETRY_S
        self._lost(kind, reason)


class LossLog:
    """Tells of losses at once, and then at most once a minute of wall time.

    Args:
        tell: Called with the line.
        clock: Returns wall time [s].
    """

    def __init__(self, tell: Callable[[str], None],
                 clock: Callable[[], float] = time.monotonic) -> None:
        self._tell, self._clock = tell, clock
        self._counts: dict[str, int] = {}
        self._reason = ''
        self._told_s = clock() - _TELL_S

    def add(self, kind: str, reason: str) -> None:
        """Count a loss."""
        self._counts[kind] = self._counts.get(kind, 0) + 1
        self._reason = reason
        self.advance()

    def advance(self) -> None:
        """Tell what is due; to be called now and then."""
        now_s = self._clock()
        if not self._counts or now_s - self._told_s < _TELL_S:
            return
        counts = ', '.join(f'{kind.lower()}: {count}' for kind, count in self._counts.items())
        self._tell(f'{counts} (the last one: {self._reason})')
        self._counts, self._told_s = {}, now_s
