"""Mutation testing: draw random small changes of the domain code, and see which the tests notice.

    python test/mutation/mutants.py draw RESULTS.csv --number 200 --seed 1
    python test/mutation/mutants.py test RESULTS.csv [--jobs 2] [--again]

`draw` picks places in the rooms of `tests_of_modules.yaml` at random, each with one change by an
operator of Cosmic Ray: another operator, comparison, sign, constant, boolean or loop. `test` makes
each change in a copy of the working tree, runs the tests of its module there until one fails, and
writes the outcome into the same file: killed, timeout (killed by being endless) or survived.
Stopped, it continues where it was. `--again` tests the survivors with the present tests: a change
is found by the text of its line, so that other lines may move meanwhile.
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
import csv
import dataclasses
import fnmatch
import itertools
import os
import pathlib
import queue
import random
import shutil
import signal
import subprocess
import sys
import tempfile

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
import cosmic_ray.plugins
import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
PACKAGE = 'lunar_rover_sim'
CONFIG = pathlib.Path(__file__).with_name('tests_of_modules.yaml')
# Changes that make sense for the types at hand: a shifted float would only raise a TypeError.
ARITHMETIC, COMPARISONS = 'Add Sub Mul Div FloorDiv Mod Pow', 'Eq NotEq Lt LtE Gt GtE'
OPERATORS = {f'core/Replace{kind}Operator_{one}_{other}'
             for kind, names in (('Binary', ARITHMETIC), ('Binary', 'BitAnd BitOr BitXor'),
                                 ('Comparison', COMPARISONS), ('Comparison', 'Is IsNot'),
                                 ('Unary', 'UAdd USub'))
             for one in names.split() for other in names.split() if one != other}
OPERATORS |= {f'core/{name}' for name in (
    'AddNot', 'NumberReplacer', 'ReplaceAndWithOr', 'ReplaceBreakWithContinue',
    'ReplaceContinueWithBreak', 'ReplaceFalseWithTrue', 'ReplaceOrWithAnd',
    'ReplaceTrueWithFalse', 'ReplaceUnaryOperator_Delete_Not',
    'ReplaceUnaryOperator_Delete_USub', 'ZeroIterationForLoop')}


@dataclasses.dataclass
class Mutant:
    """One changed line of one module, and what the tests said of it."""

    module: str
    line: int
    before: str
    after: str
    outcome: str = ''


def rules() -> list[tuple[str, list[str]]]:
    """Return (pattern of modules, their tests) in the order in which they are tried."""
    return list(yaml.safe_load(CONFIG.read_text(encoding='utf-8')).items())


def tests_of(module: str) -> list[str]:
    """Return the test files of a module: those of the first pattern that matches it."""
    return next(tests for pattern, tests in rules() if fnmatch.fnmatch(module, pattern))


def modules() -> list[str]:
    """Return the modules that have tests here, relative to the package."""
    everything = sorted(path.relative_to(ROOT / PACKAGE).as_posix()
                        for path in (ROOT / PACKAGE).rglob('*.py'))
    return [name for name in everything if not name.endswith('__init__.py')
            and any(fnmatch.fnmatch(name, pattern) for pattern, _ in rules())]


def places(module: str) -> Iterator[list[tuple[str, str, int]]]:
    """Yield, for every place that can be changed, its (module, operator, occurrence)."""
    code = (ROOT / PACKAGE / module).read_text(encoding='utf-8')
    nodes = list(ast_nodes(get_ast(code)))
    unseen = lines_without_behaviour(code)
    found: dict[tuple[int, int], list[tuple[str, str, int]]] = {}
    for name in sorted(OPERATORS.intersection(cosmic_ray.plugins.operator_names())):
        operator = cosmic_ray.plugins.get_operator(name)()
        positions = [start for node in nodes for start, _ in operator.mutation_positions(node)]
        for occurrence, start in enumerate(positions):
            if not any(first <= start < last for first, last in unseen):
                found.setdefault(start, []).append((module, name, occurrence))
    yield from found.values()


def change(module: str, operator: str, occurrence: int) -> Mutant | None:
    """Return a mutant; None where more than a line changes."""
    code = (ROOT / PACKAGE / module).read_text(encoding='utf-8')
    changed = mutate_code(code, cosmic_ray.plugins.get_operator(operator)(), occurrence)
    before, after = code.splitlines(), changed.splitlines()
    differ = [i for i, lines in enumerate(zip(before, after)) if lines[0] != lines[1]]
    if len(before) != len(after) or len(differ) != 1:
        return None
    return Mutant(module, differ[0] + 1, before[differ[0]], after[differ[0]])


def lines_without_behaviour(code: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return spans (from, to) of (line, column) that are not worth a change.

    Annotations are never evaluated; what stands in `raise` or in a call of the logger is text.
    """
    nodes: list[ast.AST | None] = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, (ast.AnnAssign, ast.arg)):
            nodes.append(node.annotation)
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            nodes.append(node.returns)
        elif isinstance(node, ast.Raise) or (
                isinstance(node, ast.Call) and ast.unparse(node.func).startswith('logger.')):
            nodes.append(node)
    return [((node.lineno, node.col_offset),    # type: ignore[attr-defined]
             (node.end_lineno, node.end_col_offset))     # type: ignore[attr-defined]
            for node in nodes if node is not None]


def draw(number: int, seed: int) -> list[Mutant]:
    """Return a random sample: every place is as likely, and so is every change of a place."""
    rng = random.Random(seed)
    everywhere = [place for module in modules() for place in places(module)]
    rng.shuffle(everywhere)
    mutants = (change(*rng.choice(place)) for place in everywhere)
    return list(itertools.islice(filter(None, mutants), number))


class Tree:
    """A copy of the working tree, in which one module at a time is changed."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.folder = folder
        self.output = ''    # of the newest run of tests
        listed = subprocess.run(['git', 'ls-files', '-z', '-co', '--exclude-standard'], cwd=ROOT,
                                check=True, capture_output=True, text=True).stdout
        for name in filter(None, listed.split('\0')):
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / name, folder / name)
        # Compiled files are checked by content: times are too coarse for quick changes.
        subprocess.run([sys.executable, '-m', 'compileall', '-q', '--invalidation-mode',
                        'checked-hash', PACKAGE], cwd=folder, check=True)

    def judge(self, mutant: Mutant, timeout_s: float) -> str:
        """Return what the tests say of a mutant; 'gone' where its line is no more."""
        path = self.folder / PACKAGE / mutant.module
        original = path.read_text(encoding='utf-8')
        lines = original.split('\n')
        found = [i for i, line in enumerate(lines) if line == mutant.before]
        if not found:
            return 'gone'
        lines[min(found, key=lambda i: abs(i + 1 - mutant.line))] = mutant.after
        path.write_text('\n'.join(lines), encoding='utf-8')
        try:
            return self.run(tests_of(mutant.module), timeout_s)
        finally:
            path.write_text(original, encoding='utf-8')

    def run(self, tests: list[str], timeout_s: float) -> str:
        """Return whether tests pass ('survived'), fail ('killed') or take too long."""
        environment = {**os.environ, 'PYTHONPATH': str(self.folder),
                       'PYTHONDONTWRITEBYTECODE': '1'}
        process = subprocess.Popen(
            ['nice', '-n', '10', sys.executable, '-m', 'pytest', '-x', '-q', '--no-header',
             '-p', 'no:cacheprovider', *tests], cwd=self.folder, env=environment,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True)
        try:
            output, _ = process.communicate(timeout=timeout_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            self.output = 'timeout'
            return 'timeout'
        # 0: all passed; 1: one failed; 2: the change cannot be imported. Others: a fault of ours.
        if process.returncode not in (0, 1, 2):
            raise RuntimeError(f'pytest {" ".join(tests)}: {output[-2000:]}')
        self.output = output
        return 'survived' if process.returncode == 0 else 'killed'


def write(path: pathlib.Path, sample: list[Mutant]) -> None:
    """Write the sample with its outcomes."""
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.DictWriter(file, [field.name for field in dataclasses.fields(Mutant)])
        writer.writeheader()
        writer.writerows(dataclasses.asdict(mutant) for mutant in sample)


def read(path: pathlib.Path) -> list[Mutant]:
    """Read what `write` wrote."""
    with path.open(newline='', encoding='utf-8') as file:
        return [Mutant(row['module'], int(row['line']), row['before'], row['after'],
                       row['outcome']) for row in csv.DictReader(file)]


def test(path: pathlib.Path, jobs: int, again: bool, timeout_s: float, clean: bool) -> None:
    """Test the mutants of a file that have no outcome yet, or those that survived."""
    sample = read(path)
    todo = [m for m in sample if m.outcome in (('survived',) if again else ('',))]
    with tempfile.TemporaryDirectory() as folder:
        trees: queue.SimpleQueue[Tree] = queue.SimpleQueue()
        for job in range(jobs):
            trees.put(Tree(pathlib.Path(folder) / str(job)))

        def judge(mutant: Mutant) -> None:
            tree = trees.get()
            try:
                mutant.outcome = tree.judge(mutant, timeout_s)
            finally:
                trees.put(tree)
            write(path, sample)
            print(f'{mutant.outcome:8} {mutant.module}:{mutant.line}: {mutant.after.strip()}',
                  flush=True)

        # The whole suite must pass before a failure means anything.
        tree = trees.get()
        for tests in sorted({tuple(tests_of(m.module)) for m in todo}) if clean else ():
            if tree.run(list(tests), 10.0 * timeout_s) != 'survived':
                sys.exit(f'{" ".join(tests)}: fails without any change\n{tree.output[-2000:]}')
        trees.put(tree)
        with ThreadPoolExecutor(jobs) as pool:
            list(pool.map(judge, todo))


def summarise(sample: list[Mutant]) -> None:
    """Print the counts, and every survivor as a difference."""
    killed = sum(mutant.outcome in ('killed', 'timeout') for mutant in sample)
    survivors = [mutant for mutant in sample if mutant.outcome == 'survived']
    print(f'{killed} of {killed + len(survivors)} mutants killed')
    for mutant in survivors:
        print(f'{mutant.module}:{mutant.line}\n  - {mutant.before.strip()}'
              f'\n  + {mutant.after.strip()}')


def main() -> None:
    """Run one of the commands."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest='command', required=True)
    drawing = commands.add_parser('draw', help='draw a random sample')
    testing = commands.add_parser('test', help='run the tests on a sample')
    for command in (drawing, testing):
        command.add_argument('results', type=pathlib.Path)
    drawing.add_argument('--number', type=int, default=200)
    drawing.add_argument('--seed', type=int, default=1)
    testing.add_argument('--jobs', type=int, default=1)
    testing.add_argument('--again', action='store_true', help='test the survivors once more')
    testing.add_argument('--unchecked', action='store_true',
                         help='do not run the tests without any change first')
    testing.add_argument('--timeout', type=float, default=120.0, metavar='S')
    args = parser.parse_args()
    if args.command == 'draw':
        write(args.results, draw(args.number, args.seed))
    else:
        test(args.results, args.jobs, args.again, args.timeout, not args.unchecked)
        summarise(read(args.results))


if __name__ == '__main__':
    main()
