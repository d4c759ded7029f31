"""One case: a mutated input, its reader, and how that ends; here or by the command line."""

import dataclasses
import os
from pathlib import Path
import random
import re
import resource
import shutil
import subprocess
import sys
import time
import traceback

from claims import Contradiction, one_line
from command_line import unfolded
from readers import COMMANDS, Reader, READERS

from lunar_rover_sim.base.errors import LunarRoverSimError

LIMIT_S = 5.0          # of processor time; the wall clock belongs to all users of the machine
HANG_S = 120.0         # of wall time: a case that waits for something is killed after it
_WANTED_MEMORY = re.compile('MemoryError|allocate|bad_alloc|out of memory', re.IGNORECASE)
LOG_LINE = re.compile('(WARNING|INFO) lunar_rover_sim')


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
    lines = [line for line in unfolded(ended.stderr).splitlines()
             if line.strip() and not LOG_LINE.match(line)]
    # `bag check` and `dataset verify` say on stdout what is wrong.
    fine = (ended.returncode == 1 and (not lines or len(lines) == 1
                                       and lines[0].startswith('lunar_rover_sim: ')))
    fine = fine or ended.returncode == 0 and not lines
    return None if fine else Outcome(case.number, case.reader, 'cli', f'{" ".join(words)}: status '
                                     f'{ended.returncode}: {ended.stderr[-400:]}',
                                     repeat=case.repeat)
