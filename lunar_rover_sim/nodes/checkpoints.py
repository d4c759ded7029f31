"""Checkpoints of the nodes of a run in lockstep: written where the graph is at rest, and read.

At a checkpoint physics holds time until every awaited topic has answered. What else is under way
then is messages that nobody awaits. So each node waits until it has received nothing for some
rounds of its executor and its readers have acknowledged all that it has sent; then it writes its
state. The recorder is the last one: it has then received what all others have sent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
import time
from typing import Any, TYPE_CHECKING

from rclpy.duration import Duration

from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.base.files.state_file import load_state, save_state
from lunar_rover_sim.run import checkpoint
from lunar_rover_sim.run.checkpoint import Checkpoint
from lunar_rover_sim.run.shared_config import NodeConfig

if TYPE_CHECKING:
    from lunar_rover_sim.nodes.node_main import GraphNode

_LOOK_S = 0.05
_ROUNDS = 4         # without a message, after which a node is at rest
_ACKNOWLEDGED_S = 1.0       # wall time that readers may take, of which some may have left
PHYSICS, RECORDER = 'physics_node', 'recorder_node'


def saved_state(config: NodeConfig, name: str) -> tuple[int, Any] | None:
    """Return the time [ns] and the state of a node with which its run goes on; None: at 0."""
    if not config.resume_from:
        return None
    found = Checkpoint(Path(config.resume_from))
    return found.time_ns, load_state(found.part(name))


def acknowledged(node: GraphNode) -> None:
    """Wait until the readers of a node have received all that it has sent."""
    for publisher in node.publishers:
        publisher.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGED_S))


class StateWriter:
    """Writes the state of a node where physics has begun a checkpoint."""

    def __init__(self, node: GraphNode, folder: Path) -> None:
        """Look for checkpoints under way in a folder."""
        self._node, self._folder = node, folder
        self._received = self._rounds = 0
        node.create_timer(_LOOK_S, self._look)

    def _look(self) -> None:
        begun = checkpoint.under_way(self._folder)
        if begun is None or begun.part(self._node.get_name()).exists():
            self._rounds = 0
            return
        if self._received != self._node.received or not self._node.is_at_rest(begun):
            self._received, self._rounds = self._node.received, 0
            return
        self._rounds += 1
        if self._rounds >= _ROUNDS:
            acknowledged(self._node)
            save_state(begun.part(self._node.get_name()), self._node.state())


class Barrier:
    """Holds time at checkpoints until all nodes have written their states: for physics."""

    def __init__(self, node: GraphNode, folder: Path, period_ns: int, nodes: Sequence[str],
                 limit_s: float, on_done: Callable[[], None]) -> None:
        """Take none where there is no period.

        Args:
            folder: Of all checkpoints.
            nodes: Those that write their states, with this one.
            limit_s: Wall time without a new state, after which the run fails.
            on_done: Called when time may go on.
        """
        self._node, self._folder, self._period_ns = node, folder, period_ns
        self._others = [name for name in nodes if name not in (PHYSICS, RECORDER)]
        self._recorder = [name for name in nodes if name == RECORDER]
        self._limit_s, self._on_done = limit_s, on_done
        self._done_ns = 0
        self._begun: Checkpoint | None = None
        self._missing: list[str] = []
        self._since_s = 0.0
        if period_ns:
            node.create_timer(_LOOK_S, self._look)

    def holds(self, now_ns: int) -> bool:
        """Return whether time may not go on from here."""
        return bool(self._period_ns) and now_ns > self._done_ns and now_ns % self._period_ns == 0

    def begin(self, now_ns: int) -> None:
        """Begin a checkpoint, if that has not been done: all awaited topics have answered."""
        if self._begun is None:
            acknowledged(self._node)
            self._begun = checkpoint.begin(self._folder, now_ns)
            self._since_s = time.monotonic()

    @property
    def is_under_way(self) -> bool:
        """Whether nodes are about to write."""
        return self._begun is not None

    def resume(self, time_ns: int) -> None:
        """Go on at a checkpoint [ns]."""
        self._done_ns = time_ns

    def restart(self) -> None:
        """Begin at time 0 again: the checkpoints so far are of another time."""
        self._done_ns, self._begun = 0, None
        if self._period_ns:
            checkpoint.clear(self._folder)

    def _look(self) -> None:
        begun = self._begun
        if begun is None:
            return
        missing = begun.missing(self._others)
        if not missing:
            own = begun.part(PHYSICS)
            if not own.exists():
                save_state(own, self._node.state())
            missing = begun.missing(self._recorder)
        if missing:
            self._wait_for(missing, begun)
            return
        checkpoint.seal(begun)
        self._done_ns, self._begun = begun.time_ns, None
        self._on_done()

    def _wait_for(self, missing: list[str], begun: Checkpoint) -> None:
        now_s = time.monotonic()
        if missing != self._missing:
            self._missing, self._since_s = missing, now_s
        elif now_s - self._since_s > self._limit_s:
            raise GraphError(f'checkpoint at {begun.time_ns / 1e9:.3f} s: no state of '
                             f'{", ".join(missing)}, {self._limit_s:g} s so far')
