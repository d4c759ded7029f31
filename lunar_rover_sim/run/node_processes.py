"""The processes of the nodes, started by the launcher, as the runner sees them."""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
import ctypes
import json
import os
from pathlib import Path
import select
import signal
import subprocess
import sys
import time

_PR_SET_PDEATHSIG = 1
_ORPHANS_S = 5.0    # what nodes are given to end without their launcher


class NodeProcess:
    """One node.

    pid: 0 until it has been started; returncode: its exit status, negative for a signal, None
    while it runs
    """

    def __init__(self, launcher: Launcher) -> None:
        self._launcher = launcher
        self.pid = 0
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Return the exit status if the node has ended."""
        self._launcher.listen(0.0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; raise TimeoutError if there is none in time [s]."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while self.poll() is None:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            if left == 0.0:
                raise TimeoutError
            self._launcher.listen(left)
        assert self.returncode is not None
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal, as soon as the node has been started; nothing if it has ended."""
        while self.pid == 0 and self.returncode is None:
            self._launcher.listen(None)
        if self.poll() is None:
            # It may have ended just now, which the launcher has not said yet.
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)


class Launcher:
    """Starts nodes through `nodes.launcher` and hears from it how they end.

    Made early: while the runner reads the scenario, the launcher imports. Context manager.
    folder: that of the run, shown in lists of processes; killed: whether it has ended before the
    nodes, which end with it
    """

    def __init__(self, folder: Path) -> None:
        self.nodes: dict[str, NodeProcess] = {}
        self.killed = False
        # The launcher forks, so it must not have threads; the nodes have no use for those of
        # NumPy's linear algebra either.
        environment = {'OPENBLAS_NUM_THREADS': '1', **os.environ, 'PYTHONUNBUFFERED': '1'}
        environment.pop('ROS_LOCALHOST_ONLY', None)
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'lunar_rover_sim.nodes.launcher', str(folder)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment,
            start_new_session=True, preexec_fn=die_with_parent)
        assert self._process.stdin is not None and self._process.stdout is not None
        self._said, self._pipe = self._process.stdin, self._process.stdout
        self._heard = b''

    def start(self, plans: Sequence[tuple[str, Path, Sequence[str]]],
              environment: dict[str, str]) -> None:
        """Start nodes: (name, log file, arguments) of each; once."""
        self.nodes = {name: NodeProcess(self) for name, _, _ in plans}
        nodes = [[name, str(log), list(arguments)] for name, log, arguments in plans]
        with contextlib.suppress(BrokenPipeError), self._said:
            self._said.write(json.dumps({'environment': environment, 'nodes': nodes}).encode())

    def __enter__(self) -> Launcher:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(BrokenPipeError):
            self._said.close()
        self.listen(0.0)
        if not self.nodes or any(node.returncode is None for node in self.nodes.values()):
            # An error before the start, or a second signal while nodes were being stopped.
            self._process.terminate()
        while not self._pipe.closed:
            self.listen(None)

    def listen(self, timeout: float | None) -> None:
        """Take in what the launcher has said; wait up to `timeout` [s] for it to say something."""
        while not self._pipe.closed and select.select([self._pipe], [], [], timeout)[0]:
            timeout = 0.0
            said = os.read(self._pipe.fileno(), 65536)
            if not said:
                self._pipe.close()
                self._process.wait()
            *lines, self._heard = (self._heard + said).split(b'\n')
            for line in lines:
                what, name, number = line.decode().split()
                if what == 'started':
                    self.nodes[name].pid = int(number)
                else:
                    self.nodes[name].returncode = int(number)
        orphans = [node for node in self.nodes.values() if node.returncode is None]
        if self._pipe.closed and orphans:
            self.killed = True
            self._outlive(orphans)

    def _outlive(self, orphans: list[NodeProcess]) -> None:
        """Wait for those whom the kernel told to end, since the launcher was killed."""
        deadline = time.monotonic() + _ORPHANS_S
        for node in orphans:
            while node.pid and os.path.exists(f'/proc/{node.pid}'):
                if time.monotonic() > deadline:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(node.pid, signal.SIGKILL)
                time.sleep(0.02)
            node.returncode = -signal.SIGTERM


def die_with_parent() -> None:
    """Let the kernel end this process when its parent is killed, so that no orphan runs on."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
