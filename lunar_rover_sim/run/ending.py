"""What follows when the nodes of a launched run end: which one is stopped next, what has failed.

The launch file asks it and acts; `NodeProcesses` does the same for processes of its own.
"""

from __future__ import annotations

from collections.abc import Collection
import dataclasses

from lunar_rover_sim.run.plan import STOP_ORDER

RECORDER = 'recorder_node'


@dataclasses.dataclass(frozen=True)
class Step:
    """What follows when a node has ended; '' is nothing.

    stop: the node to be stopped next
    lost: how a node ended, if the run goes on without it
    failure: why the run has failed; then all nodes are to be stopped
    mark: why the bag is to be marked as failed: no recorder can add to it any more
    """

    stop: str = ''
    lost: str = ''
    failure: str = ''
    mark: str = ''


class Ending:
    """The end of one run: its nodes are stopped one by one, the recorder last."""

    def __init__(self, nodes: Collection[str], may_fail: Collection[str] = ()) -> None:
        """Take the names of all nodes, and of those without which the run goes on."""
        self._running = [name for name in STOP_ORDER if name in nodes]
        self._may_fail = may_fail
        self._stopping = False
        self._failure = ''

    def after(self, name: str, status: int, shutting_down: bool = False) -> Step:
        """Return what follows when a node has ended with a status.

        Status 0 is that of physics at its end, and of every node after a signal: each ends the
        run, but for those without which it goes on. Once the run ends, a node that it can do
        without may fail as well; the others are stopped all the same.
        shutting_down: somebody else stops all nodes, by Ctrl-C or after a failure
        """
        self._running.remove(name)
        described = f'{name} has ended with status {status}'
        if name in self._may_fail:
            if not (self._stopping or shutting_down):
                return Step(lost=f'{described}; the run goes on')
        elif status != 0 and not shutting_down:
            self._failure = f'the run failed: {described}'
        mark = '' if RECORDER in self._running else self._failure
        if shutting_down:
            return Step(mark=mark)
        if self._failure:
            return Step(failure=described, mark=mark)
        self._stopping = True
        return Step(stop=self._running[0] if self._running else '')
