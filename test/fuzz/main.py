"""Reads mutated files and judges how that ends; a small share of it is a test of pytest.

    python test/fuzz/main.py [--cases 2000] [--seed 1] [--only READER] [-o FOLDER] [--cli 100]
    python test/fuzz/main.py --case 1234 [--seed 1] [--keep FOLDER]

Case N of a seed is always the same reader, file and mutation, so that `--case N` repeats it, with
its traceback; --keep keeps its files. Readers and what must hold of what they accept are in
`readers.py`. A case fails where it ends in a traceback, takes more than LIMIT_S of processor
time or does not end, wants more memory than MEMORY, kills the process, prints what is not a line
of the package, or contradicts the documentation. --cli also gives refused inputs to the real
command line: status 1 and one line.

Prints each failure with the command that repeats it, and a table; writes fuzz.json and fuzz.md
into FOLDER; exits with 1 if any case failed.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
import contextlib
import dataclasses
import json
import multiprocessing
from multiprocessing.connection import Connection, wait
import os
from pathlib import Path
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings

import psutil

sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[:2]]

from readers import COMMANDS, Contradiction, one_line, Reader, READERS  # noqa: E402

from lunar_rover_sim.cli.main import configure_logging  # noqa: E402
from lunar_rover_sim.errors import LunarRoverSimError  # noqa: E402

LIMIT_S = 5.0          # of processor time; the wall clock belongs to all users of the machine
HANG_S = 120.0         # of wall time: a case that waits for something is killed after it
MEMORY = 4 << 30       # address space of a worker, libraries included
_WANTED_MEMORY = re.compile('MemoryError|allocate|bad_alloc|out of memory', re.IGNORECASE)
_LOG_LINE = re.compile('(WARNING|INFO) lunar_rover_sim')
FAILED = ('traceback', 'hang', 'slow', 'memory', 'died', 'print', 'contradiction', 'cli')


@dataclasses.dataclass(frozen=True)
class Case:
    """A case, drawn from seed and number."""

    seed: int
    number: int
    only: str = ''

    @property
    def rng(self) -> random.Random:
        """A generator for what comes after the choice of the reader."""
        return random.Random(f'{self.seed}/{self.number}')

    @property
    def reader(self) -> str:
        """The name of its reader."""
        names = [name for name, reader in READERS.items() for _ in range(reader.weight)]
        return self.only or random.Random(f'reader {self.seed}/{self.number}').choice(names)

    @property
    def repeat(self) -> str:
        """The command line that repeats it."""
        return (f'python test/fuzz/main.py --seed {self.seed} --case {self.number}'
                + (f' --only {self.only}' if self.only else ''))


@dataclasses.dataclass
class Outcome:
    """How a case ended: 'accepted', 'refused', or one of FAILED."""

    number: int
    reader: str
    kind: str
    said: str = ''
    file: str = ''
    cpu_s: float = 0.0
    repeat: str = ''


def prepare(case: Case, samples: Path, folder: Path) -> tuple[Path, random.Random]:
    """Copy the sample of a case into a new folder and mutate one of its files; return that."""
    reader, rng = READERS[case.reader], case.rng
    shutil.copytree(samples / case.reader, folder)
    pattern = rng.choice([p for p in sorted(reader.mutate) if list(folder.glob(p))])
    file = rng.choice(sorted(folder.glob(pattern)))
    if rng.random() < 0.04:
        _no_file(rng, file)
    else:
        file.write_bytes(reader.mutate[pattern](rng, file.read_bytes()))
    return file, rng


def _no_file(rng: random.Random, file: Path) -> None:
    """Put something else in the place of a file, or nothing."""
    file.unlink()
    action = rng.randrange(6)
    if action == 0:
        os.mkfifo(file)
    elif action == 1:
        file.mkdir()
    elif action == 2:
        file.symlink_to(file.name)
    elif action == 3:
        file.symlink_to('/dev/zero')
    elif action == 4:
        file.symlink_to('/proc/self/mem')


def run(case: Case, samples: Path, folder: Path, loud: bool = False) -> Outcome:
    """Prepare and read a case in this process."""
    reader: Reader = READERS[case.reader]
    file, rng = prepare(case, samples, folder)
    outcome = Outcome(case.number, case.reader, 'accepted', repeat=case.repeat,
                      file=str(file.relative_to(folder)))
    start = time.process_time()
    try:
        reader.read(folder, samples / case.reader, file, rng)
    except LunarRoverSimError as error:
        outcome.kind, outcome.said = 'refused', str(error)
        try:
            one_line(error)
        except Contradiction as unreadable:
            outcome.kind, outcome.said = 'contradiction', str(unreadable)
    except Contradiction as error:
        outcome.kind, outcome.said = 'contradiction', str(error)
    except BaseException as error:  # whatever it is, it is what this program looks for
        outcome.kind = 'memory' if isinstance(error, MemoryError) else 'traceback'
        frames = [f'{Path(f.filename).name}:{f.lineno}' for f in
                  traceback.extract_tb(error.__traceback__)][-4:]
        outcome.said = f'{type(error).__name__}: {str(error)[:200]} ({" < ".join(frames[::-1])})'
        if loud:
            traceback.print_exc()
    outcome.cpu_s = time.process_time() - start
    if outcome.kind in ('refused', 'traceback') and _WANTED_MEMORY.search(outcome.said):
        outcome.kind = 'memory'
    elif outcome.kind in ('refused', 'accepted') and outcome.cpu_s > LIMIT_S:
        outcome.kind, outcome.said = 'slow', f'{outcome.cpu_s:.1f} s: {outcome.said}'
    return outcome


def make_samples(folder: Path, only: str = '') -> None:
    """Write the valid inputs; reading them unmutated must accept them."""
    for name, reader in READERS.items():
        if only in ('', name):
            (folder / name).mkdir()
            reader.make(folder / name)


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
                 if line and not _LOG_LINE.match(line)]
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


def _limit_processor_time() -> None:
    """Give this process what a case may take, and as much for the start of Python."""
    resource.setrlimit(resource.RLIMIT_CPU, (int(2.0 * LIMIT_S),) * 2)


def run_by_command_line(case: Case, samples: Path, folder: Path) -> Outcome | None:
    """Give the input of a refused case to the command line; return a failure, or None."""
    file, _ = prepare(case, samples, folder)
    words = COMMANDS[case.reader].format(file=file, folder=folder, new=folder / 'new').split()
    try:
        ended = subprocess.run([sys.executable, '-m', 'lunar_rover_sim.cli.main', *words],
                               capture_output=True, text=True, errors='replace',
                               timeout=5.0 * HANG_S, preexec_fn=_limit_processor_time)
    except subprocess.TimeoutExpired:
        return Outcome(case.number, case.reader, 'cli', f'{words}: hangs', repeat=case.repeat)
    lines = [line for line in ended.stderr.splitlines()
             if line.strip() and not _LOG_LINE.match(line)]
    # `bag check` and `dataset verify` say on stdout what is wrong.
    fine = (ended.returncode == 1 and (not lines or len(lines) == 1
                                       and lines[0].startswith('lunar_rover_sim: ')))
    fine = fine or ended.returncode == 0 and not lines
    return None if fine else Outcome(case.number, case.reader, 'cli', f'{" ".join(words)}: status '
                                     f'{ended.returncode}: {ended.stderr[-400:]}',
                                     repeat=case.repeat)


def table(outcomes: list[Outcome], seed: int, took_s: float) -> str:
    """Return what came of the cases, as Markdown."""
    failed = [o for o in outcomes if o.kind in FAILED]
    slowest = max(outcomes, key=lambda o: o.cpu_s)
    lines = [f'{len(outcomes)} cases, seed {seed}, {took_s:.0f} s: {len(failed)} failed; the '
             f'slowest took {slowest.cpu_s:.2f} s of processor time ({slowest.reader}).', '',
             '| reader | cases | accepted | refused | failed |', '|---|---|---|---|---|']
    for name in READERS:
        of = Counter(o.kind for o in outcomes if o.reader == name)
        bad = ', '.join(f'{of[kind]} {kind}' for kind in FAILED if of[kind])
        if of:
            lines.append(f'| {name} | {of.total()} | {of["accepted"]} | {of["refused"]} | '
                         f'{bad or 0} |')
    return '\n'.join(lines)


def main() -> int:
    """Run, report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--cases', type=int, default=2000)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--only', default='', choices=('', *READERS), metavar='READER')
    parser.add_argument('--jobs', type=int, default=2)
    parser.add_argument('--cli', type=int, default=0, metavar='N',
                        help='also give N refused inputs to the command line')
    parser.add_argument('--case', type=int, metavar='N', help='one case, in this process')
    parser.add_argument('--keep', type=Path, metavar='FOLDER', help='for the files of --case')
    parser.add_argument('-o', '--output', type=Path, metavar='FOLDER')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix='fuzz_') as text:
        folder = Path(text)
        os.environ['LUNAR_ROVER_SIM_CACHE'] = str(folder / 'cache')
        (folder / 'samples').mkdir()
        if args.case is not None:
            case = Case(args.seed, args.case, args.only)
            make_samples(folder / 'samples', case.reader)
            print(run(case, folder / 'samples', args.keep or folder / 'case', loud=True))
            return 0
        make_samples(folder / 'samples', args.only)
        start = time.monotonic()
        cases = [Case(args.seed, k, args.only) for k in range(args.cases)]
        outcomes = []
        for outcome in run_all(cases, folder / 'samples', folder, args.jobs):
            outcomes.append(outcome)
            if outcome.kind in FAILED:
                print(f'{outcome.kind}: {outcome.reader} {outcome.file}: {outcome.said}\n'
                      f'  {outcome.repeat}', flush=True)
        refused = [cases[o.number] for o in outcomes
                   if o.kind == 'refused' and o.reader in COMMANDS]
        random.Random(args.seed).shuffle(refused)
        for case in refused[:args.cli]:
            failure = run_by_command_line(case, folder / 'samples', folder / 'cli')
            _remove(folder / 'cli')
            if failure is not None:
                outcomes.append(failure)
                print(f'cli: {failure.said}\n  {failure.repeat}', flush=True)
        summary = table(outcomes, args.seed, time.monotonic() - start)
    print(summary)
    if args.output is not None:
        args.output.mkdir(parents=True, exist_ok=True)
        (args.output / 'fuzz.md').write_text(summary + '\n')
        (args.output / 'fuzz.json').write_text(json.dumps(
            [dataclasses.asdict(o) for o in outcomes], indent=1) + '\n')
    return int(any(o.kind in FAILED for o in outcomes))


if __name__ == '__main__':
    raise SystemExit(main())
