"""Running a program as a child process: output logged, time bounded, nothing left running."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
import dataclasses
import os
from pathlib import Path
import shlex
import shutil
import signal
import subprocess
import threading
import time
from typing import BinaryIO

import psutil

from lunar_rover_sim.base.errors import ConfigError, ProcessError

_POLL_S = 0.1
_TAIL_LINES = 5
_MOST_LINE = 400
_MOST_CHUNK = 1 << 16    # of a line that does not end [bytes]
_READER_S = 3.0          # time for the last output to arrive in the log

Echo = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class Ended:
    """How a program ended.

    Attributes:
        status: Exit status, negative for a signal.
        wall_s: How long it ran [s].
        tail: The last lines of its log.
        timed_out, interrupted: Why it was ended from here.
    """

    status: int
    wall_s: float
    tail: tuple[str, ...] = ()
    timed_out: bool = False
    interrupted: bool = False

    @property
    def words(self) -> str:
        """How the program ended, as text; empty if it succeeded."""
        if self.interrupted:
            return 'was interrupted'
        if self.timed_out:
            return f'was ended after {self.wall_s:.0f} s'
        if self.status < 0:
            return f'crashed with {signal_name(-self.status)}'
        return f'ended with status {self.status}' if self.status else ''

    @property
    def last_line(self) -> str:
        """The last line of the output, without the name of this program before it."""
        line = self.tail[-1].strip() if self.tail else ''
        return line.removeprefix('lunar_rover_sim: ')[:_MOST_LINE]

    @property
    def error(self) -> str:
        """Why the program failed, in one line: what it said itself, if it ended by itself."""
        by_itself = self.status > 0 and not (self.timed_out or self.interrupted)
        return self.last_line if by_itself and self.last_line else self.words


def program_words(command: str, name: str = 'command') -> list[str]:
    """Return a program and its arguments; raise ConfigError if there are none.

    Args:
        command: A line of a shell.
        name: Of the option or the parameter.
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ConfigError(f'{name}: {command!r} is not valid: {error}') from None
    if not words:
        raise ConfigError(f'{name}: {command!r} is not valid; valid is a program that speaks the '
                          'protocol, and its arguments')
    return words


def executable(path: str | Path) -> Path:
    """Return the absolute path of a program; raise ProcessError if it cannot be run.

    Args:
        path: A Path is a file, or else a program on PATH; text is what a shell makes of it.
    """
    # A Path has lost the './' of a file in this folder; a shell looks for words on PATH alone.
    file = shutil.which(path.absolute()) if isinstance(path, Path) else None
    found = file or shutil.which(str(path))
    if found is None:
        what = 'cannot be executed' if Path(path).exists() else 'there is no such program'
        raise ProcessError(f'{path}: {what}')
    return Path(found).absolute()


def dies_with_parent(command: Sequence[str]) -> list[str]:
    """Return the command, prefixed so that the kernel sends it SIGTERM when its parent is killed.

    The parent is the *thread* that starts the command: it must live as long as the command. The
    prefix is `setpriv` of util-linux; without it the command is returned as it is.
    """
    setpriv = shutil.which('setpriv')
    return [*([setpriv, '--pdeathsig', 'TERM', '--'] if setpriv else []), *command]


def run_program(command: Sequence[str | Path], log: Path, timeout_s: float, *,
                folder: Path | None = None, echo: Echo | None = None, grace_s: float = 3.0,
                stop: Callable[[], bool] = lambda: False) -> Ended:
    """Run a program with its output in `log`, for at most `timeout_s` [s]; return how it ended.

    The program runs in `folder` (default: the current one) and in a process group of its own.
    `echo` is called, in a thread, with every line of the output. After its time, once `stop()` is
    true, or when this process receives SIGTERM (as long as this is the main thread), the group
    receives SIGTERM, and `grace_s` [s] later it and all descendants are killed. Raises
    ProcessError if the program cannot be started.
    """
    words = [str(executable(command[0])), *(str(word) for word in command[1:])]
    tail: deque[str] = deque(maxlen=_TAIL_LINES)
    timed_out = interrupted = False
    start = time.monotonic()
    try:
        file = log.open('wb', buffering=0)
    except OSError as error:
        raise ProcessError(f'{log}: cannot be written: {error.strerror}') from None
    with file, _sigterm_deferred() as terminated:
        try:
            process = subprocess.Popen(dies_with_parent(words), cwd=folder,
                                       stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                       stderr=subprocess.STDOUT, start_new_session=True)
        except OSError as error:
            raise ProcessError(f'{command[0]}: cannot be started: {error.strerror}') from None
        reader = threading.Thread(target=_copy_output, args=(process, file, tail, echo),
                                  daemon=True)
        reader.start()
        try:
            while process.poll() is None:
                timed_out = time.monotonic() - start > timeout_s
                interrupted = terminated.is_set() or stop()
                if timed_out or interrupted:
                    break
                with suppress(subprocess.TimeoutExpired):
                    process.wait(_POLL_S)
        finally:
            end_group(process, grace_s)
            reader.join(_READER_S)
    return Ended(process.returncode, time.monotonic() - start, tuple(tail), timed_out, interrupted)


@contextmanager
def _sigterm_deferred() -> Iterator[threading.Event]:
    """Yield an event that SIGTERM sets; deliver the signal when the context ends.

    Outside of the main thread, signals cannot be handled, and the event stays unset.
    """
    received = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    before = signal.signal(signal.SIGTERM, lambda *_: received.set())
    try:
        yield received
    finally:
        signal.signal(signal.SIGTERM, before)
        if received.is_set():
            signal.raise_signal(signal.SIGTERM)


def _copy_output(process: subprocess.Popen[bytes], file: BinaryIO, tail: deque[str],
                 echo: Echo | None) -> None:
    assert process.stdout is not None
    with process.stdout as output:
        while chunk := output.readline(_MOST_CHUNK):
            with suppress(OSError):     # a full disk: the program must not wait for a reader
                file.write(chunk)
            line = chunk.decode('utf-8', 'replace').rstrip()
            if line:
                tail.append(line)
            if echo is not None:
                echo(line)


def end_group(process: subprocess.Popen[bytes], grace_s: float) -> None:
    """End a program that leads a process group, and everything that it started.

    Args:
        grace_s: Time between SIGTERM and SIGKILL [s].
    """
    # Descendants in sessions of their own can be found only while their parents live.
    family = _descendants(process.pid) if process.poll() is None else []
    _signal_group(process.pid, signal.SIGTERM)
    with suppress(subprocess.TimeoutExpired):
        process.wait(grace_s)
    _signal_group(process.pid, signal.SIGKILL)
    process.wait()
    for descendant in family:
        with suppress(psutil.NoSuchProcess):
            descendant.kill()


def _descendants(pid: int) -> list[psutil.Process]:
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []


def _signal_group(pid: int, number: signal.Signals) -> None:
    """Send a signal to a process group, which outlives its leader while it has members."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, number)


def signal_name(number: int) -> str:
    """Return the name of a signal, SIGKILL of 9."""
    try:
        return signal.Signals(number).name
    except ValueError:      # a real-time signal
        return f'signal {number}'
