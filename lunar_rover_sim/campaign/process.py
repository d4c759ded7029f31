"""Child processes that never outlive whoever started them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses
import os
from pathlib import Path
import signal
import subprocess
import time

from lunar_rover_sim.run.child_process import dies_with_parent

_POLL_S = 0.1
_MOST_LINE = 400


@dataclasses.dataclass(frozen=True)
class Ended:
    """How a process ended: its status (negative: the signal), wall time [s], last line it wrote.

    reason: why it was stopped by us, or ''.
    """

    status: int
    wall_s: float
    said: str
    reason: str = ''

    @property
    def words(self) -> str:
        """Return how it ended, in words; '' where it ended well."""
        if self.reason:
            return self.reason
        if self.status == 0:
            return ''
        if self.status < 0:
            return f'ended with {signal.Signals(-self.status).name}'
        return self.said or f'ended with status {self.status}'


def run(command: Sequence[str], log: Path, timeout_s: float, grace_s: float,
        stopped: Callable[[], bool] = lambda: False) -> Ended:
    """Run a command with its output in `log`; return how it ended.

    After `timeout_s`, or once `stopped()`, it is told to end (SIGTERM) and killed with all its
    group `grace_s` later. It is told to end too when this process is killed.
    """
    start = time.monotonic()
    reason = ''
    with log.open('ab') as output:
        process = subprocess.Popen(dies_with_parent(command), stdin=subprocess.DEVNULL,
                                   stdout=output, stderr=subprocess.STDOUT,
                                   start_new_session=True)
        try:
            while process.poll() is None:
                if stopped():
                    reason = 'was interrupted'
                elif time.monotonic() - start > timeout_s:
                    reason = f'was not done within {timeout_s:g} s'
                if reason:
                    break
                time.sleep(_POLL_S)
        finally:
            _end(process, grace_s)
    return Ended(process.returncode, time.monotonic() - start, last_line(log), reason)


def last_line(log: Path) -> str:
    """Return the last line of a log, without the name of the program before it."""
    try:
        with log.open('rb') as file:
            file.seek(max(0, log.stat().st_size - 4096))
            lines = file.read().decode('utf-8', 'replace').splitlines()
    except OSError:
        return ''
    said = [line.strip() for line in lines if line.strip()]
    return said[-1].removeprefix('lunar_rover_sim: ')[:_MOST_LINE] if said else ''


def _end(process: subprocess.Popen[bytes], grace_s: float) -> None:
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(grace_s)
        except subprocess.TimeoutExpired:
            pass
    try:
        # Whoever of its group is left: it had its time.
        os.killpg(process.pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        pass
    process.wait()
