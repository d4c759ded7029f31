"""Mutation testing: draw random small changes of the domain code, and see which the tests notice.

    python test/mutation/mutants.py draw RESULTS.csv --number 200 --seed 1
    python test/mutation/mutants.py measure LINES.json [TESTS …]
    python test/mutation/mutants.py test RESULTS.csv LINES.json [--jobs 2] [--again]

`draw` picks places in the rooms at random, each with one change by an operator of Cosmic Ray:
another operator, comparison, sign, constant, boolean or loop. `measure` finds which tests execute
which lines. `test` makes each change, runs the tests that execute it until one fails, and writes
the outcome into the same file: killed, endless (which counts as killed) or survived. Stopped, both
continue where they were. `--again` tests the survivors with the present tests: a change is found
by the text of its line, so that other lines may move meanwhile.
"""

import argparse
from collections.abc import Callable
import os
import pathlib
import sys
import tempfile

from executed import Executed, is_compiled, is_in_function, quickest
from forked import (Chosen, forked, load_libraries, OPTIONS, outcome_of, PACKAGE, ROOT,
                    run_collecting, Server, Tree)
import pytest
from sample import modules, Mutant, read, ROOMS, write

MOST_S = 3600.0     # of CPU time of a file of tests
# Not test/regression: a stored number notices any change of it, right or wrong.
TESTS = [*(f'test/{room}' for room in ROOMS), 'test/cli', 'test/files', 'test/inspection',
         'test/lidar', 'test/rendering', 'test/sequences', 'test/slam', 'test/usd',
         'test/test_default_values.py', 'test/test_frames.py', 'test/test_parameter_ranges.py',
         'test/test_python_api.py', 'test/test_values.py']


def applied(mutant: Mutant, code: str) -> str | None:
    """Return the code with the change; None where the line is no more."""
    lines = code.split('\n')
    found = [i for i, line in enumerate(lines) if line == mutant.before]
    if not found:
        return None
    lines[min(found, key=lambda i: abs(i + 1 - mutant.line))] = mutant.after
    return '\n'.join(lines)


def lots_of(mutant: Mutant, code: str, executed: Executed, limit_s: float) -> list[list[str]]:
    """Return the tests of a mutant: those of its room, then all others.

    Tests of the room execute the changed statement; of the others, those of other statements of
    the module count too, for lines whose result is kept somewhere. For what is computed at import
    count the tests that look at all rooms.
    """
    room = mutant.module.partition('/')[0]
    direct = executed.of_line(mutant.module, mutant.line, code)
    if not is_in_function(mutant.line, code):
        direct |= {test for test in executed.seconds if test.startswith('test/test_')}
    near = {test for test in direct if test.startswith((f'test/{room}/', 'test/test_'))}
    others = (direct | executed.of_module(mutant.module)) - near
    lots = [quickest(tests, executed.seconds, limit_s) for tests in (near, others)]
    return [lot for lot in lots if lot]


def measure(path: pathlib.Path, jobs: int, tests: list[str]) -> None:
    """Run the tests unchanged, file by file, and write which lines each executes.

    tests: files or folders to measure anew; of none, all that were not measured yet
    """
    import measuring  # needs coverage, as no other command does

    load_libraries()
    executed = Executed.load(path) if path.exists() else Executed({}, {})
    found = {file.relative_to(ROOT).as_posix() for name in tests or TESTS
             for file in ((ROOT / name).rglob('test_*.py') if (ROOT / name).is_dir()
                          else [ROOT / name])}
    todo = sorted(found if tests else found - executed.files())
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        tree = Tree(folder)
        running: dict[int, str] = {}

        def run(file: str, lines: pathlib.Path) -> int:
            tree.enter()
            return pytest.main([*OPTIONS, '-m', 'not ros', file],
                               plugins=[measuring.Measuring(tree.folder / PACKAGE, lines)])

        while todo or running:
            while todo and len(running) < jobs:
                file = todo.pop(0)
                lines = folder / file.replace('/', '-')
                pid = forked(lambda: run(file, lines), MOST_S, lines.with_suffix('.log'))
                running[pid] = file
            pid, status = os.wait()
            outcome_of(pid, status)     # ends what it has left running
            file = running.pop(pid)
            lines = folder / file.replace('/', '-')
            if lines.exists():
                executed = executed.updated(Executed.of_process(lines))
                executed.save(path)
            print(f'{file}: {"measured" if lines.exists() else "ended without a result"}',
                  flush=True)
    print(f'{len(executed.seconds)} tests, {sum(executed.seconds.values()):.0f} s of CPU time')


class Judge:
    """Tests the mutants of a file by several processes at a time, and writes what comes out."""

    def __init__(self, path: pathlib.Path, executed: Executed, jobs: int, limit_s: float,
                 folder: pathlib.Path) -> None:
        self.path, self.executed, self.jobs, self.limit_s = path, executed, jobs, limit_s
        self.folder = folder
        self.sample = read(path)

    def chosen(self, tests: list[str], slot: int, module: str,
               to_the_end: bool = False) -> Chosen:
        """Return the tests for a process; worlds are kept unless their building is changed."""
        worlds = None if module.startswith('world/') else self.folder / 'worlds'
        return Chosen(tests, self.executed.seconds, self.folder / f'failures-{slot}', worlds,
                      to_the_end)

    def cpu_s(self, tests: list[str]) -> float:
        """Return the CPU time after which a process with these tests is endless.

        Of it 40 s are for imports and for what Numba compiles anew.
        """
        return 3.0 * sum(self.executed.seconds[name] for name in tests) + 40.0

    def judge(self, todo: list[Mutant], run: Callable[[Mutant, str, Chosen, int], int],
              original: Callable[[str], str]) -> None:
        """Test mutants. `run` runs tests of one, with its code, in one of the slots."""
        free, running = list(range(self.jobs)), {}

        def begin(mutant: Mutant, code: str, lots: list[list[str]], slot: int) -> None:
            chosen = self.chosen(lots[0], slot, mutant.module)
            pid = forked(lambda: run(mutant, code, chosen, slot), self.cpu_s(lots[0]),
                         self.folder / f'log-{slot}')
            running[pid] = mutant, code, lots[1:], slot

        todo = list(todo)
        while todo or running:
            while todo and free:
                mutant = todo.pop(0)
                before = original(mutant.module)
                code = applied(mutant, before)
                lots = lots_of(mutant, before, self.executed, self.limit_s)
                if code is None or not lots:
                    self.write(mutant, 'gone' if code is None else 'survived')
                else:
                    begin(mutant, code, lots, free.pop())
            if running:
                pid, status = os.wait()
                mutant, code, lots, slot = running.pop(pid)
                outcome = outcome_of(pid, status)
                if outcome == 'survived' and lots:
                    begin(mutant, code, lots, slot)
                    continue
                names = (self.folder / f'failures-{slot}').read_text(encoding='utf-8')
                self.write(mutant, outcome, names.partition('\n')[0])
                free.append(slot)

    def write(self, mutant: Mutant, outcome: str, by: str = '') -> None:
        """Write an outcome, also into the file."""
        mutant.outcome, mutant.by = outcome, by
        write(self.path, self.sample)
        print(f'{outcome:8} {mutant.module}:{mutant.line}: {mutant.after.strip()}  {by}',
              file=sys.__stderr__, flush=True)

    def withdraw(self, run: Callable[[Chosen], int]) -> None:
        """Take back what tests have noticed that fail without any change too."""
        blamed = sorted({m.by for m in self.sample if m.by in self.executed.seconds})
        chosen = self.chosen(blamed, 0, '', to_the_end=True)
        os.waitpid(forked(lambda: run(chosen), self.cpu_s(blamed), self.folder / 'log-0'), 0)
        wrong = set((self.folder / 'failures-0').read_text(encoding='utf-8').splitlines())
        for mutant in self.sample:
            if mutant.by in wrong:
                self.write(mutant, '')
        if wrong:
            print('fail without any change:', *sorted(wrong), file=sys.__stderr__)


def test(path: pathlib.Path, executed: Executed, jobs: int, limit_s: float, again: bool) -> None:
    """Test the mutants of a file that have no outcome yet, or those that survived."""
    load_libraries()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        unchanged = Tree(folder / 'unchanged')
        originals = {module: unchanged.path(module).read_text(encoding='utf-8')
                     for module in modules()}

        def serve(server: Server) -> None:
            judge = Judge(path, executed, jobs, limit_s, folder)
            judge.judge([m for m in judge.sample if not m.outcome
                         and is_in_function(m.line, originals[m.module])
                         and not is_compiled(m.line, originals[m.module])],
                        lambda mutant, code, chosen, _: server.run_changed(mutant.module, code,
                                                                           chosen),
                        originals.__getitem__)

        if not again:
            pid = os.fork()
            if not pid:
                Server(unchanged, serve).run(sorted(executed.files()))
            os.waitpid(pid, 0)
        judge = Judge(path, executed, jobs, limit_s, folder)
        trees = [Tree(folder / str(slot), unchanged) for slot in range(jobs)]

        def run(module: str, code: str, chosen: Chosen, slot: int) -> int:
            for name, text in originals.items():
                if trees[slot].path(name).read_text(encoding='utf-8') != text:
                    trees[slot].copy(name, unchanged)
            if code != originals[module]:
                trees[slot].path(module).write_text(code, encoding='utf-8')
            return run_collecting(trees[slot], chosen)

        judge.judge([m for m in judge.sample if m.outcome in (('survived',) if again else ('',))],
                    lambda mutant, *others: run(mutant.module, *others), originals.__getitem__)
        first = modules()[0]
        judge.withdraw(lambda chosen: run(first, originals[first], chosen, 0))


def summarise(sample: list[Mutant]) -> None:
    """Print the counts, and every survivor as a difference."""
    killed = sum(mutant.outcome in ('killed', 'endless') for mutant in sample)
    survivors = [mutant for mutant in sample if mutant.outcome == 'survived']
    print(f'{killed} of {killed + len(survivors)} mutants killed')
    for mutant in survivors:
        print(f'{mutant.module}:{mutant.line}\n  - {mutant.before.strip()}'
              f'\n  + {mutant.after.strip()}')


def main() -> None:
    """Run one of the commands."""
    def path(name: str) -> pathlib.Path:
        return pathlib.Path(name).resolve()     # the processes change the folder

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest='command', required=True)
    drawing = commands.add_parser('draw', help='draw a random sample')
    measuring_ = commands.add_parser('measure', help='find which tests execute which lines')
    testing = commands.add_parser('test', help='run the tests on a sample')
    for command in (drawing, testing):
        command.add_argument('results', type=path)
    drawing.add_argument('--number', type=int, default=200)
    drawing.add_argument('--seed', type=int, default=1)
    for command in (measuring_, testing):
        command.add_argument('lines', type=path)
        command.add_argument('--jobs', type=int, default=2)
    measuring_.add_argument('tests', nargs='*', help='files and folders to measure anew; by '
                            'default those of the rooms, and what looks at all of them, of which '
                            'nothing is measured yet')
    testing.add_argument('--again', action='store_true', help='test the survivors once more')
    testing.add_argument('--limit', type=float, default=15.0, metavar='S',
                         help='CPU time of the tests of each mutant')
    args = parser.parse_args()
    if args.command == 'draw':
        from drawing import draw  # needs Cosmic Ray, as no other command does

        write(args.results, draw(args.number, args.seed))
    elif args.command == 'measure':
        measure(args.lines, args.jobs, args.tests)
    else:
        test(args.results, Executed.load(args.lines), args.jobs, args.limit, args.again)
        summarise(read(args.results))


if __name__ == '__main__':
    main()
