"""Reports of a node to the supervisor of its run: ready, waiting, compiling, or ending.

The supervisor gives each node a pipe, whose number is in an environment variable. The node writes
a line of JSON for each state. Its log says the same for people.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys

VARIABLE = 'LUNAR_ROVER_STATE_FD'
READY, WAITING, FATAL, ON_THE_WAY = 'ready', 'waiting', 'fatal', 'on the way'
COMPILING, COMPILED = 'compiling', 'compiled'
PUBLISHERS, ANSWERS = 'publishers', 'answers'
_MOST_BYTES = 4000      # a pipe takes so many at once or none (PIPE_BUF)


@dataclasses.dataclass(frozen=True)
class NodeState:
    """One state.

    Attributes:
        state: READY, WAITING, COMPILING, COMPILED, FATAL or ON_THE_WAY.
        text: The words for people.
        awaits: What is waited for, PUBLISHERS or ANSWERS; '' where nothing is missing.
        at_ns: Simulated time at which time stands still for it [ns]; -1 where none does.
        driven_m, left_m: ON_THE_WAY: how far the rover has come, and how far it is to its goal.
    """

    state: str
    text: str = ''
    awaits: str = ''
    at_ns: int = -1
    driven_m: float = 0.0
    left_m: float = 0.0


def is_supervised() -> bool:
    """Return whether this process is a node of a run, which decides how long it may wait."""
    return VARIABLE in os.environ


def tell(state: NodeState) -> None:
    """Tell a state, if somebody supervises this process and still listens."""
    if not is_supervised():
        return
    line = json.dumps(dataclasses.asdict(state)).encode()
    if len(line) > _MOST_BYTES:
        line = json.dumps({'state': state.state, 'text': state.text[:300]}).encode()
    try:
        number = int(os.environ[VARIABLE])
        os.set_inheritable(number, False)   # not for programs that the node starts
        os.write(number, line + b'\n')
    except (OSError, ValueError):
        pass    # the supervisor has gone, or reads no more: the node's log has the words


def fail(error: object) -> None:
    """Print why this process ends, in one line, and tell it."""
    print(f'FATAL {error}', file=sys.stderr, flush=True)
    tell(NodeState(FATAL, str(error)))


class StateReader:
    """The supervisor's end of the pipe of one node.

    Attributes:
        told: The states so far, after `read`, but for ON_THE_WAY and compilation.
        compiles: Whether it compiles at this moment.
        way: The newest state ON_THE_WAY; None before the first.
    """

    def __init__(self) -> None:
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._reader, False)
        os.set_blocking(self._writer, False)
        self._rest = b''
        self.told: list[NodeState] = []
        self.compiles = False
        self.way: NodeState | None = None

    @property
    def writer(self) -> int:
        """The number of the node's end, to be passed on to its process."""
        return self._writer

    def started(self) -> None:
        """Close the node's end here, once its process has it."""
        os.close(self._writer)

    def read(self) -> list[NodeState]:
        """Return all states told so far."""
        while True:
            try:
                chunk = os.read(self._reader, 1 << 16)
            except BlockingIOError:
                break
            if not chunk:
                break
            *lines, self._rest = (self._rest + chunk).split(b'\n')
            for line in lines:
                state = NodeState(**json.loads(line))
                if state.state == ON_THE_WAY:
                    self.way = state
                elif state.state in (COMPILING, COMPILED):
                    self.compiles = state.state == COMPILING
                else:
                    self.told.append(state)
        return self.told

    def close(self) -> None:
        """Close the pipe."""
        os.close(self._reader)
