"""Supervision of a run: until physics has finished, or a node dies, or time stands still."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import time

from lunar_rover_sim.errors import GraphError
from lunar_rover_sim.run.lockstep import STARTED_NS
from lunar_rover_sim.run.node_processes import Looks, NodeProcesses
from lunar_rover_sim.run.plan import awaits_others
from lunar_rover_sim.run.ros_domain import ClockReader
from lunar_rover_sim.run.scenario import Scenario

_POLL_S = 0.1
# physics_node names the participant that it waits for before the supervisor names physics_node. It
# begins to wait once it has started itself, which takes seconds.
_SILENCE_MARGIN_S, _START_MARGIN_S = 1.0, 30.0
# Limit where time stands still and no node works: they wait for each other. A node that draws
# for a minute, or that gets a tenth of a core, works.
_IDLE_S = 6.5
# Time that physics has to leave after its last state.
_LEAVE_S = 15.0


@dataclasses.dataclass(frozen=True)
class Limits:
    """Wall times without progress of the clock after which physics counts as hung [s].

    silence_s: during the run; start_s: in its first simulated second, where time waits for the
        slowest node to start; None where time may stand still (paused, real time)
    idle_s: during the run, where no node works or one is suspended; others: whether programs take
        part that the run has not started, whose work cannot be seen
    end_ns: simulated time at which physics finishes [ns]; 0 for never
    timeout_s: wall time after which the run is stopped as failed; None for never
    """

    silence_s: float | None
    start_s: float | None
    end_ns: int
    timeout_s: float | None = None
    idle_s: float = _IDLE_S
    others: bool = False

    @classmethod
    def of(cls, scenario: Scenario, timeout_s: float | None = None) -> Limits:
        """Return the limits of a resolved scenario."""
        wait, end_ns = scenario.physics_node.wait, round(scenario.run.duration_s * 1e9)
        if not scenario.shared.lockstep:
            return cls(None, None, end_ns, timeout_s)
        idle_s = _IDLE_S if wait.silence_s > _IDLE_S else wait.silence_s + _SILENCE_MARGIN_S
        return cls(wait.silence_s + _SILENCE_MARGIN_S, wait.start_s + _START_MARGIN_S, end_ns,
                   timeout_s, idle_s, awaits_others(scenario))

    def silence_limit_s(self, now_ns: int, suspended: bool, idle: bool) -> float | None:
        """Return how long the clock may stand still at `now_ns`; None for ever."""
        limit_s = self.silence_s
        if limit_s is not None:
            if suspended or (idle and not self.others and now_ns > STARTED_NS):
                limit_s = self.idle_s
            elif now_ns <= STARTED_NS:
                limit_s = self.start_s
        if limit_s is not None and 0 < self.end_ns <= now_ns:
            limit_s += _LEAVE_S
        return limit_s


def supervise(nodes: NodeProcesses, clock: ClockReader, limits: Limits,
              on_progress: Callable[[int], None], should_stop: Callable[[], bool],
              on_warning: Callable[[str], None] = lambda _text: None) -> bool:
    """Return True when physics has finished, False when `should_stop` says so.

    on_progress: called about ten times a second with the simulated time [ns]
    on_warning: called with a line where a node is suspended, which says when the run ends
    Raises GraphError when a node dies, time stands still, or the run takes too long.
    """
    start = last_progress = time.monotonic()
    last_ns, suspended = 0, list[str]()
    looks = Looks()     # since time stands still
    while True:
        if nodes.has_finished():
            on_progress(max(clock.now_ns(), limits.end_ns))
            return True
        if should_stop():
            return False
        clock.check()
        now_ns, now_suspended = clock.now_ns(), nodes.suspended()
        # A node that is suspended gets the same time as one that is silent.
        new = [name for name in now_suspended if name not in suspended]
        if new and limits.silence_s is not None:
            on_warning(f'{new[0]} is stopped (SIGSTOP): the run ends in {limits.idle_s:g} s '
                       'unless it goes on')
        if now_ns != last_ns or now_suspended != suspended:
            last_ns, suspended, last_progress = now_ns, now_suspended, time.monotonic()
            looks = Looks()
        else:
            looks.add(nodes.at_work())
        limit_s = limits.silence_limit_s(now_ns, bool(suspended), looks.idle)
        if limit_s is not None and time.monotonic() - last_progress > limit_s:
            raise GraphError(_describe_silence(nodes, suspended, limit_s, now_ns))
        if limits.timeout_s is not None and time.monotonic() - start > limits.timeout_s:
            raise GraphError(f'the run was not done within {limits.timeout_s:g} s')
        nodes.measure()
        on_progress(now_ns)
        time.sleep(_POLL_S)


def _describe_silence(nodes: NodeProcesses, suspended: list[str], limit_s: float,
                      now_ns: int) -> str:
    """Return why time stands still: a node has failed, or is stopped, late or silent."""
    fatal = nodes.fatal_error()
    if fatal is not None:
        return fatal
    at = f'at {now_ns / 1e9:.3f} s of simulated time'
    if suspended:
        return f'{suspended[0]} is stopped (SIGSTOP) {at} (log: {nodes.log(suspended[0])})'
    late = nodes.unstarted()
    if late:
        return f'not started within {limit_s:g} s: {late}'
    return nodes.silent_participant(now_ns) or (
        f'physics_node has been silent for {limit_s:g} s {at} '
        f'(log: {nodes.log("physics_node")})')
