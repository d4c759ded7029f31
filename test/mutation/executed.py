"""Which tests execute a line of the package, as `measuring.py` has found."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable
import dataclasses
import functools
import json
import pathlib

from forked import PACKAGE, ROOT


@dataclasses.dataclass
class Executed:
    """Tests with their CPU times [s], and by module and line those that execute it."""

    seconds: dict[str, float]
    lines: dict[str, dict[int, set[str]]]

    @classmethod
    def of_process(cls, path: pathlib.Path) -> Executed:
        """Return what a process that ran tests has written; tests that failed are left out."""
        part = json.loads(path.read_text(encoding='utf-8'))
        fixtures: dict[str, float] = part['fixtures']
        users: dict[str, set[str]] = defaultdict(set)   # of a fixture
        seconds: dict[str, float] = {}
        for test, (own_s, names) in part['tests'].items():
            if test in part['failed']:
                continue
            keys = [key for key in fixtures for base, _, name in [key.rpartition('::')]
                    if name in names and test.startswith(base)]
            seconds[test] = own_s + sum(fixtures[key] for key in keys)
            for key in keys:
                users[key].add(test)
        lines: dict[str, dict[int, set[str]]] = {}
        for module, found in part['lines'].items():
            of_module = lines.setdefault(module, {})
            for line, contexts in found.items():
                tests = of_module.setdefault(int(line), set())
                for context in (part['names'][place] for place in contexts):
                    tests |= users[context] if context in fixtures else {context}
                tests.intersection_update(seconds)
        return cls(seconds, lines)

    def files(self) -> set[str]:
        """Return the files of tests that were measured."""
        return set(map(_file, self.seconds))

    def updated(self, newer: Executed) -> Executed:
        """Return this with the files of tests replaced that were measured anew."""
        files = newer.files()
        seconds = {test: spent_s for test, spent_s in self.seconds.items()
                   if _file(test) not in files} | newer.seconds
        lines: dict[str, dict[int, set[str]]] = {}
        for module in self.lines.keys() | newer.lines.keys():
            old, new = self.lines.get(module, {}), newer.lines.get(module, {})
            lines[module] = {
                line: {test for test in old.get(line, set()) if _file(test) not in files}
                | new.get(line, set())
                for line in old.keys() | new.keys()}
        return Executed(seconds, lines)

    def save(self, path: pathlib.Path) -> None:
        """Write it as JSON, in which tests are named once, at once or not at all."""
        place = {test: i for i, test in enumerate(self.seconds)}
        partial = path.with_suffix('.partial')
        partial.write_text(json.dumps({'seconds': self.seconds, 'lines': {
            module: {line: sorted(place[test] for test in tests)
                     for line, tests in found.items()}
            for module, found in self.lines.items()}}), encoding='utf-8')
        partial.replace(path)

    @classmethod
    def load(cls, path: pathlib.Path) -> Executed:
        """Read what `save` wrote."""
        document = json.loads(path.read_text(encoding='utf-8'))
        tests = list(document['seconds'])
        return cls(document['seconds'], {
            module: {int(line): {tests[i] for i in places} for line, places in found.items()}
            for module, found in document['lines'].items()})

    def of_module(self, module: str) -> set[str]:
        """Return the tests that execute anything of a module after it was imported."""
        return set().union(*self.lines.get(module, {}).values())

    def of_line(self, module: str, line: int, code: str) -> set[str]:
        """Return the tests that execute the statement of a line.

        Constants, defaults and declarations are executed when the module is imported: for them
        count all tests of the module. What a compiled function executes is not seen: for it count
        all tests of the modules, and in the files of tests, that import the module.
        """
        span = _statement(ast.parse(code), line)
        if span is None:
            return self.of_module(module)
        if is_compiled(line, code):
            others = (other for other in self.lines     # which have lines of templates, too
                      if other.endswith('.py') and _imports(f'{PACKAGE}/{other}', module))
            files = {file for file in self.files() if _imports(file, module)}
            return set().union(*map(self.of_module, others),
                               (test for test in self.seconds if _file(test) in files))
        found = self.lines.get(module, {})
        return set().union(*(found.get(number, set()) for number in span))


def is_in_function(line: int, code: str) -> bool:
    """Return whether a line is executed when a function is called, not at import."""
    return _statement(ast.parse(code), line) is not None


def is_compiled(line: int, code: str) -> bool:
    """Return whether a line is in a function that Numba compiles."""
    return any(isinstance(node, ast.FunctionDef) and node.lineno <= line <= node.end_lineno
               and {'compiled', 'vectorised', 'inlined'}.intersection(
                   map(ast.unparse, node.decorator_list)) for node in ast.walk(ast.parse(code)))


def _file(test: str) -> str:
    """Return the file of a test."""
    return test.partition('::')[0]


@functools.cache
def _imported(file: str) -> set[str]:
    """Return the dotted names that a file imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse((ROOT / file).read_text(encoding='utf-8'))):
        if isinstance(node, ast.ImportFrom):
            names |= {f'{node.module}', *(f'{node.module}.{alias.name}' for alias in node.names)}
    return names


def _imports(file: str, module: str) -> bool:
    """Return whether a file imports a module of the package."""
    return f'{PACKAGE}.{module.removesuffix(".py").replace("/", ".")}' in _imported(file)


def _statement(tree: ast.Module, line: int) -> range | None:
    """Return the lines of the statement at a line in a function, without its body; else None."""
    best: range | None = None
    for function in ast.walk(tree):
        if not isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        for top in function.body:
            for node in ast.walk(top):
                if not isinstance(node, ast.stmt):
                    continue
                body = getattr(node, 'body', None)
                end = body[0].lineno - 1 if body else node.end_lineno or node.lineno
                span = range(node.lineno, max(end, node.lineno) + 1)
                if line in span and (best is None or len(span) < len(best)):
                    best = span
    return best


def quickest(tests: Iterable[str], seconds: dict[str, float], limit_s: float) -> list[str]:
    """Return the quickest tests whose CPU times sum up to a limit, at least one."""
    chosen: list[str] = []
    for test in sorted(tests, key=lambda name: (seconds[name], name)):
        limit_s -= seconds[test]
        if chosen and limit_s < 0.0:
            break
        chosen.append(test)
    return chosen
