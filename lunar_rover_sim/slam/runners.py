"""Running somebody else's program: log kept and shown, time bounded, nothing left behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
import dataclasses
import os
from pathlib import Path
import shutil
import signal
import subprocess
import threading
import time

from lunar_rover_sim.errors import EvaluationError

_GRACE_S = 3.0
_TAIL_LINES = 5

Echo = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class Exit:
    """How a program ended.

    code: exit status, negative for a signal; timed_out: it was ended after its time;
    wall_s: how long it ran; tail: the last lines of its log
    """

    code: int
    timed_out: bool
    wall_s: float
    tail: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """What happened, for people; empty where all went well."""
        if self.timed_out:
            return f'was ended after {self.wall_s:.0f} s'
        if self.code < 0:
            with suppress(ValueError):
                return f'crashed with {signal.Signals(-self.code).name}'
        if self.code:
            return f'ended with status {self.code}'
        return ''


def executable(path: str | Path) -> Path:
    """Return the absolute path of a program; raise EvaluationError where it cannot be run."""
    found = shutil.which(str(path))
    if found is None:
        what = 'cannot be executed' if Path(path).exists() else 'there is no such program'
        raise EvaluationError(f'{path}: {what}')
    return Path(found).absolute()


def run_program(command: Sequence[str | Path], folder: Path, log: Path, timeout_s: float,
                echo: Echo | None = None, grace_s: float = _GRACE_S) -> Exit:
    """Run a program in `folder` with its output in `log`, for at most `timeout_s` [s].

    echo is called with every line of the output. The program gets a session of its own, which is
    ended as a whole, `grace_s` [s] after it was asked to end, also where this process is told to
    end. Raises EvaluationError where it cannot be started.
    """
    if not timeout_s > 0.0:
        raise EvaluationError(f'timeout: {timeout_s:g} is not valid; valid is > 0 [s]')
    start = time.monotonic()
    tail: list[str] = []
    timed_out = False
    with _terminable() as arm:
        try:
            process = subprocess.Popen([str(word) for word in command], cwd=folder,
                                       stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                       stderr=subprocess.STDOUT, start_new_session=True)
        except OSError as error:
            raise EvaluationError(
                f'{command[0]}: cannot be started: {error.strerror}') from None
        reader = threading.Thread(target=_copy, args=(process, log, tail, echo), daemon=True)
        reader.start()
        try:
            arm()
            process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            timed_out = True
        finally:
            _end(process, grace_s)
            reader.join(_GRACE_S)
    return Exit(process.returncode, timed_out, time.monotonic() - start, tuple(tail))


@contextmanager
def _terminable() -> Iterator[Callable[[], None]]:
    """Let SIGTERM unwind this process, which would leave the program's session alone otherwise.

    Not before the function that this gives is called: the program must be known by then.
    """
    told: list[int] = []
    armed = False

    def leave(number: int, _frame: object) -> None:
        told.append(number)
        if armed:
            raise SystemExit(128 + number)

    def arm() -> None:
        nonlocal armed
        armed = True
        if told:
            raise SystemExit(128 + told[0])

    if threading.current_thread() is not threading.main_thread():
        yield arm
        return
    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield arm
    finally:
        signal.signal(signal.SIGTERM, before)


def _copy(process: subprocess.Popen[bytes], log: Path, tail: list[str],
          echo: Echo | None) -> None:
    assert process.stdout is not None
    with log.open('wb', buffering=0) as file, process.stdout as output:
        for raw in output:
            file.write(raw)
            line = raw.decode('utf-8', 'replace').rstrip()
            if line:
                tail.append(line)
                del tail[:-_TAIL_LINES]
            if echo is not None:
                echo(line)


def _end(process: subprocess.Popen[bytes], grace_s: float) -> None:
    """End the program and whatever it started: politely, then not."""
    for number, patience_s in ((signal.SIGTERM, grace_s), (signal.SIGKILL, None)):
        # The group outlives its leader as long as somebody is in it.
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(patience_s)
