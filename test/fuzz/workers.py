"""Processes that read cases, one after another, and are replaced when they hang or die."""

from collections.abc import Iterator
import multiprocessing
from multiprocessing.connection import Connection, wait
import os
from pathlib import Path
import resource
import shutil
import signal
import sys
import time
import warnings

from cases import Case, HANG_S, LIMIT_S, LOG_LINE, Outcome, run

from lunar_rover_sim.cli.main import configure_logging

MEMORY = 4 << 30       # address space of a worker, libraries included


def work(pipe: Connection, cases: list[Case], samples: Path, folder: Path) -> None:
    """Read cases and send their outcomes; what the libraries print is kept.

    The system ends the process where a case hangs: by SIGXCPU, or by SIGALRM where it waits.
    """
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _, most_s = resource.getrlimit(resource.RLIMIT_CPU)
    said = folder / 'said'
    with said.open('wb') as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    configure_logging(verbose=False)
    warnings.filterwarnings('always', category=RuntimeWarning)
    for case in cases:
        os.ftruncate(1, 0)
        os.lseek(1, 0, os.SEEK_SET)
        signal.alarm(round(HANG_S))
        until_s = round(time.process_time() + 2.0 * LIMIT_S)
        resource.setrlimit(resource.RLIMIT_CPU, (until_s, most_s))
        outcome = run(case, samples, folder / 'case')
        sys.stdout.flush()
        sys.stderr.flush()
        lines = [line for line in said.read_text(errors='replace').splitlines()
                 if line and not LOG_LINE.match(line)]
        if lines and outcome.kind in ('refused', 'accepted'):
            outcome.kind, outcome.said = 'print', ' | '.join(lines)[:400]
        shutil.rmtree(folder / 'case', ignore_errors=True)
        pipe.send(outcome)


def run_all(cases: list[Case], samples: Path, folder: Path, jobs: int) -> Iterator[Outcome]:
    """Run the cases in `jobs` processes; yield outcomes as they come."""
    fork = multiprocessing.get_context('fork')
    running: dict[Connection, tuple[multiprocessing.Process, list[Case], Path]] = {}

    def start(left: list[Case], where: Path) -> None:
        shutil.rmtree(where, ignore_errors=True)
        where.mkdir()
        here, there = fork.Pipe(duplex=False)
        process = fork.Process(target=work, args=(there, left, samples, where), daemon=True)
        process.start()
        there.close()
        running[here] = process, left, where

    try:
        for k in range(jobs):
            start(cases[k::jobs], folder / f'worker_{k}')
        while running:
            for pipe in wait(list(running)):
                process, left, where = running[pipe]
                try:
                    yield pipe.recv()
                    del left[0]
                except EOFError:
                    del running[pipe]
                    process.join()
                    if left:
                        case, code = left[0], process.exitcode
                        yield Outcome(case.number, case.reader, 'hang' if code in (
                            -signal.SIGALRM, -signal.SIGXCPU) else 'died', f'exit code {code}',
                            repeat=case.repeat)
                        start(left[1:], where)
    finally:
        for process, *_ in running.values():
            process.kill()
