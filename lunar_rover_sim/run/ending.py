"""The end of a run as a state machine.

Two drivers follow it: `node_processes.NodeProcesses`, which waits for processes, and the launch
file, which is told of their ends by events.
"""

from __future__ import annotations

from collections.abc import Collection
import dataclasses
import signal

from lunar_rover_sim.run.plan import STOP_ORDER

RECORDER = 'recorder_node'
# Statuses of a node that has done its work. SIGALRM ends one that DDS keeps from leaving
# (`nodes.node_main.bound_leaving`).
DONE = (0, -signal.SIGALRM)


@dataclasses.dataclass(frozen=True)
class Step:
    """What follows when a node has ended; empty is nothing.

    Attributes:
        stop: The nodes to be stopped now.
        lost: How a node ended, if the run goes on without it.
        failure: How a node ended that should not have; the run has failed.
        mark: Why the bag is to be marked as failed: no recorder can add to it any more.
    """

    stop: tuple[str, ...] = ()
    lost: str = ''
    failure: str = ''
    mark: str = ''


class Ending:
    """Who is stopped when, what has failed, and when the bag is marked.

    While time goes on, nodes are stopped one after the other in `STOP_ORDER`. Once physics has
    ended or the run has failed, all others are stopped at once. The recorder is always the last.
    """

    def __init__(self, nodes: Collection[str], may_fail: Collection[str] = (),
                 by_physics: bool = False) -> None:
        """Take the nodes of a run.

        Args:
            nodes: Their names.
            may_fail: Those without which the run goes on.
            by_physics: Only physics ends the run well. Else any node does that a signal has ended.
        """
        self._running = [name for name in STOP_ORDER if name in nodes]
        self._asked: set[str] = set()
        self._may_fail = may_fail
        self._by_physics = by_physics
        self._stopping = self._at_once = False
        self._failure = ''

    def begin(self, failure: str = '', at_once: bool = False) -> Step:
        """Return whom to stop first, for a driver that stops nodes from here on.

        Args:
            failure: Why the run has failed; '' if it has not.
            at_once: Nobody but the recorder has work left.
        """
        self._stopping = True
        self._asked.clear()
        self._failure = self._failure or failure
        self._at_once = self._at_once or at_once
        return Step(self._next())

    def after(self, name: str, described: str, done: bool, shutting_down: bool = False) -> Step:
        """Return what follows when a node has ended.

        Args:
            name: The node.
            described: How it ended, in words.
            done: Whether it had nothing left undone, as after a signal.
            shutting_down: Somebody else stops all nodes, by Ctrl-C or after a failure.
        """
        self._running.remove(name)
        expected = self._stopping or name == 'physics_node' or not self._by_physics
        lost = failure = ''
        if not shutting_down and not (done and expected and name not in self._may_fail):
            if name not in self._may_fail:
                failure = described
                self._failure = self._failure or described
            elif not (done and self._stopping):
                lost = f'{described}; the run goes on'
        if shutting_down or (failure and not self._stopping):
            return Step(failure=failure, mark=self._mark())
        if lost and not self._stopping:
            return Step(lost=lost)
        self._stopping = True
        return Step(self._next(), lost, failure, self._mark())

    def _next(self) -> tuple[str, ...]:
        """Return the nodes that are to be stopped now and were not asked before."""
        others = [name for name in self._running if name != RECORDER]
        if not (self._at_once or self._failure or 'physics_node' not in self._running):
            others = others[:1]
        new = [name for name in others or self._running if name not in self._asked]
        self._asked.update(new)
        return tuple(new)

    def _mark(self) -> str:
        if RECORDER in self._running or not self._failure:
            return ''
        return f'the run failed: {self._failure}'
