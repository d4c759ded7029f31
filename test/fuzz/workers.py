"""Processes that read cases, one after another, and are replaced when they hang or die."""

from collections.abc import Iterator
import contextlib
import multiprocessing
from multiprocessing.connection import Connection, wait
import os
from pathlib import Path
import resource
import shutil
import sys
import time
import warnings

from cases import Case, HANG_S, LIMIT_S, LOG_LINE, Outcome, run
import psutil

from lunar_rover_sim.cli.main import configure_logging

MEMORY = 4 << 30       # address space of a worker, libraries included


def work(pipe: Connection, samples: Path, folder: Path) -> None:
    """Read the cases that come through the pipe; what the libraries print is kept."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    said = folder / 'said'
    with said.open('wb') as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    configure_logging(verbose=False)
    warnings.filterwarnings('always', category=RuntimeWarning)
    while (case := pipe.recv()) is not None:
        os.ftruncate(1, 0)
        os.lseek(1, 0, os.SEEK_SET)
        outcome = run(case, samples, folder / 'case')
        sys.stdout.flush()
        sys.stderr.flush()
        lines = [line for line in said.read_text(errors='replace').splitlines()
                 if line and not LOG_LINE.match(line)]
        if lines and outcome.kind in ('refused', 'accepted'):
            outcome.kind, outcome.said = 'print', ' | '.join(lines)[:400]
        _remove(folder / 'case')
        pipe.send(outcome)


def _remove(folder: Path) -> None:
    """Remove the files of a case."""
    shutil.rmtree(folder, ignore_errors=True)


class Worker:
    """A process that reads cases; it is replaced when it hangs or dies."""

    def __init__(self, samples: Path, folder: Path) -> None:
        self._samples, self._folder = samples, folder
        self.case: Case | None = None
        self._start()

    def _start(self) -> None:
        _remove(self._folder)
        self._folder.mkdir()
        self.pipe, there = multiprocessing.Pipe()
        self._process = multiprocessing.get_context('fork').Process(
            target=work, args=(there, self._samples, self._folder), daemon=True)
        self._process.start()
        there.close()

    def give(self, case: Case) -> None:
        """Start a case."""
        self._cpu_before_s = 0.0
        self.case, self._since, self._cpu_before_s = case, time.monotonic(), self._cpu_s()
        self.pipe.send(case)

    def _cpu_s(self) -> float:
        """Return the processor time that the case has taken so far."""
        return sum(psutil.Process(self._process.pid).cpu_times()[:2]) - self._cpu_before_s

    def take(self) -> Outcome | None:
        """Return the outcome of the case, if it has ended or must be ended; None otherwise."""
        case = self.case
        assert case is not None
        if self.pipe.poll():
            with contextlib.suppress(EOFError):
                self.case = None
                return self.pipe.recv()
            self._process.join()
            outcome = Outcome(case.number, case.reader, 'died',
                              f'exit code {self._process.exitcode}', repeat=case.repeat)
        elif time.monotonic() - self._since > HANG_S or self._cpu_s() > 2.0 * LIMIT_S:
            outcome = Outcome(case.number, case.reader, 'hang', repeat=case.repeat)
        else:
            return None
        self.stop()
        self._start()
        return outcome

    def stop(self) -> None:
        """End the process."""
        self.case = None
        self._process.kill()
        self._process.join()
        self.pipe.close()


def run_all(cases: list[Case], samples: Path, folder: Path, jobs: int) -> Iterator[Outcome]:
    """Run the cases in workers; yield outcomes as they come."""
    todo = iter(cases)
    workers = [Worker(samples, folder / f'worker_{k}') for k in range(jobs)]
    busy: list[Worker] = []
    try:
        for worker in workers:
            if (case := next(todo, None)) is not None:
                worker.give(case)
                busy.append(worker)
        while busy:
            wait([worker.pipe for worker in busy], timeout=1.0)
            for worker in list(busy):
                outcome = worker.take()
                if outcome is None:
                    continue
                yield outcome
                case = next(todo, None)
                if case is None:
                    busy.remove(worker)
                else:
                    worker.give(case)
    finally:
        for worker in workers:
            worker.stop()
