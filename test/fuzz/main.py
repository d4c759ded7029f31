"""Reads mutated files and judges how that ends; a small share of it is a test of pytest.

    python test/fuzz/main.py [--cases 2000] [--seed 1] [--only READER] [--cli 100]
    python test/fuzz/main.py --case 1234 [--seed 1] [--keep FOLDER]

Case N of a seed is always the same reader, file and mutation, so that `--case N` repeats it, with
its traceback; --keep keeps its files. Readers and what must hold of what they accept are in
`readers.py`. A case fails where it ends in a traceback, takes more than LIMIT_S of processor
time or does not end, wants more memory than MEMORY, kills the process, prints what is not a line
of the package, or contradicts the documentation. --cli also gives refused inputs to the real
command line: status 1 and one line.

Prints each failure with the command that repeats it, and a table; exits with 1 if any case failed.
"""

import argparse
from collections import Counter
import os
from pathlib import Path
import random
import sys
import tempfile
import time

sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[:2]]

from cases import Case, make_samples, Outcome, run, run_by_command_line  # noqa: E402
from readers import COMMANDS, READERS  # noqa: E402
from workers import run_all  # noqa: E402

FAILED = ('traceback', 'hang', 'slow', 'memory', 'died', 'print', 'contradiction', 'cli')


def table(outcomes: list[Outcome], seed: int, took_s: float) -> str:
    """Return what came of the cases, as Markdown."""
    slowest = max(outcomes, key=lambda o: o.cpu_s)
    lines = [f'{len(outcomes)} cases, seed {seed}, {took_s:.0f} s: '
             f'{sum(o.kind in FAILED for o in outcomes)} failed; the slowest took '
             f'{slowest.cpu_s:.2f} s of processor time ({slowest.reader}).', '',
             '| reader | cases | accepted | refused | failed |', '|---|---|---|---|---|']
    for name in READERS:
        of = Counter(o.kind for o in outcomes if o.reader == name)
        bad = ', '.join(f'{of[kind]} {kind}' for kind in FAILED if of[kind])
        if of:
            lines.append(f'| {name} | {of.total()} | {of["accepted"]} | {of["refused"]} | '
                         f'{bad or 0} |')
    return '\n'.join(lines)


def tried(args: argparse.Namespace, folder: Path) -> list[Outcome]:
    """Read the cases, and print each failure at once."""
    make_samples(folder / 'samples', args.only)
    outcomes: list[Outcome] = []

    def add(outcome: Outcome) -> None:
        outcomes.append(outcome)
        if outcome.kind in FAILED:
            print(f'{outcome.kind}: {outcome.reader} {outcome.file}: {outcome.said}\n'
                  f'  {outcome.repeat}', flush=True)

    cases = [Case(args.seed, k, args.only) for k in range(args.cases)]
    for outcome in run_all(cases, folder / 'samples', folder, args.jobs):
        add(outcome)
    refused = [cases[o.number] for o in outcomes if o.kind == 'refused' and o.reader in COMMANDS]
    for case in random.Random(args.seed).sample(refused, min(args.cli, len(refused))):
        failure = run_by_command_line(case, folder / 'samples', folder / f'cli_{case.number}')
        if failure is not None:
            add(failure)
    return outcomes


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
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix='fuzz_') as text:
        folder, start = Path(text), time.monotonic()
        os.environ['LUNAR_ROVER_SIM_CACHE'] = str(folder / 'cache')
        (folder / 'samples').mkdir()
        if args.case is not None:
            case = Case(args.seed, args.case, args.only)
            make_samples(folder / 'samples', case.reader)
            print(run(case, folder / 'samples', args.keep or folder / 'case', loud=True))
            return 0
        outcomes = tried(args, folder)
    print(table(outcomes, args.seed, time.monotonic() - start))
    return int(any(o.kind in FAILED for o in outcomes))


if __name__ == '__main__':
    raise SystemExit(main())
