"""A pytest plugin that writes which lines each test executes, and how long it takes.

Lines that a fixture of a wider scope executes count for all tests that use it. Caches of functions
are emptied before each test, so that what they hold counts for every test that needs it.
"""

from collections.abc import Generator
import json
import os
import pathlib
import sys
import time

import coverage
import pytest


def cpu_s() -> float:
    """Return the CPU time of this process and of its finished children [s]."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


class Measuring:
    """Lines, times and outcomes of the tests of this process.

    package: whose lines count
    path: where they are written in the end
    """

    def __init__(self, package: pathlib.Path, path: pathlib.Path) -> None:
        self.package, self.path = package, path
        self.coverage = coverage.Coverage(data_file=None, config_file=False,
                                          include=[f'{package}/*'])
        self.coverage.start()
        self.context = ''
        self.tests: dict[str, tuple[float, list[str]]] = {}     # CPU time [s], names of fixtures
        self.fixtures: dict[str, float] = {}                    # CPU time [s]
        self.failed: set[str] = set()
        self.apart_s = 0.0      # spent in fixtures since the test began

    def switch(self, context: str) -> str:
        """Let lines count for a test or a fixture from here on; return what they counted for."""
        before, self.context = self.context, context
        self.coverage.switch_context(context)
        return before

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Measure one test."""
        for name, module in list(sys.modules.items()):
            if name.startswith(f'{self.package.name}.'):
                for value in vars(module).values():
                    if callable(getattr(value, 'cache_clear', None)):
                        value.cache_clear()
        self.switch(item.nodeid)
        self.apart_s, begin_s = 0.0, cpu_s()
        result = yield
        names = list(item.fixturenames)     # type: ignore[attr-defined]
        self.tests[item.nodeid] = (cpu_s() - begin_s - self.apart_s, names)
        self.switch('')
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef
                             ) -> Generator[None, object, object]:
        """Measure a fixture that several tests share, apart from the test that needs it first."""
        if fixturedef.scope == 'function':
            return (yield)
        key = f'{fixturedef.baseid}::{fixturedef.argname}'
        before, begin_s, apart_s = self.switch(key), cpu_s(), self.apart_s
        try:
            return (yield)
        finally:
            spent_s = cpu_s() - begin_s
            # Fixtures that it needs have begun before it; what they spent is theirs.
            self.fixtures[key] = spent_s - (self.apart_s - apart_s)
            self.apart_s = apart_s + spent_s
            self.switch(before)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the names of tests that do not pass."""
        if not report.passed:
            self.failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        """Write what was measured."""
        self.coverage.stop()
        data = self.coverage.get_data()
        names = [*self.tests, *self.fixtures]
        place = {name: i for i, name in enumerate(names)}
        lines = {pathlib.Path(file).relative_to(self.package).as_posix(): {
            line: [place[context] for context in contexts if context]
            for line, contexts in data.contexts_by_lineno(file).items()}
            for file in data.measured_files()}
        self.path.write_text(json.dumps({'tests': self.tests, 'fixtures': self.fixtures,
                                         'failed': sorted(self.failed), 'names': names,
                                         'lines': lines}))
