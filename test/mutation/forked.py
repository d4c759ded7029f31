"""Tests of changed code in forked processes.

`Server` collects the tests once; each process that it forks exchanges the code of the changed
functions and runs only the tests that it is told to. What is computed when a module is imported
(constants, defaults, declarations) and what Numba compiles cannot be exchanged so: `Tree` changes
the file in a copy of the working tree, and a process that has loaded libraries only runs the tests
from there.

Limits count CPU time, so that a busy machine does not let a test fail.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
import gc
import importlib
import os
import pathlib
import resource
import shutil
import signal
import subprocess
import sys
from types import CodeType, FunctionType
from typing import NoReturn

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
PACKAGE = 'lunar_rover_sim'
LIBRARIES = ('cv2', 'jinja2', 'matplotlib.figure', 'mcap.reader', 'moderngl', 'mujoco', 'numba',
             'numpy', 'PIL.Image', 'psutil', 'rasterio', 'rich.progress', 'rosbags.highlevel',
             'rosbags.rosbag2', 'scipy.interpolate', 'scipy.ndimage', 'scipy.optimize',
             'scipy.signal', 'scipy.spatial.transform', 'scipy.stats', 'trimesh', 'yaml')
OPTIONS = ['-q', '--no-header', '--capture=sys', '-p', 'no:cacheprovider', '-p', 'no:xdist']
_MOST_BYTES = 8 << 30       # of memory; a change may ask for any amount
_WALL_FACTOR = 30           # a process that does nothing for so many times its limit hangs
_QUICK_S = 0.1


def load_libraries() -> None:
    """Import what the package and its tests import of others; forked processes share it."""
    os.environ['OPENBLAS_NUM_THREADS'] = '1'
    for name in LIBRARIES:
        importlib.import_module(name)


class Tree:
    """A copy of the working tree, in which one module at a time is changed.

    folder: where it is made
    other: a tree to copy in place of the working tree
    """

    def __init__(self, folder: pathlib.Path, other: Tree | None = None) -> None:
        self.folder = folder / 'tree'
        self.temporary = folder / 'temporary'
        self.temporary.mkdir(parents=True)
        if other is not None:
            shutil.copytree(other.folder, self.folder)
            return
        listed = subprocess.run(['git', 'ls-files', '-z', '-co', '--exclude-standard'], cwd=ROOT,
                                check=True, capture_output=True, text=True).stdout
        # What Numba has compiled holds for a file of the same time.
        kept = (path.relative_to(ROOT) for path in (ROOT / PACKAGE).rglob('*.nb[ci]'))
        for name in (*filter(None, listed.split('\0')), *kept):
            if (ROOT / name).is_file():
                (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, self.folder / name)
        # Compiled files are checked by content: times are too coarse for quick changes.
        subprocess.run([sys.executable, '-m', 'compileall', '-q', '--invalidation-mode',
                        'checked-hash', PACKAGE], cwd=self.folder, check=True)

    def path(self, module: str) -> pathlib.Path:
        """Return the file of a module."""
        return self.folder / PACKAGE / module

    def copy(self, module: str, other: Tree) -> None:
        """Take a module, and what Numba has compiled of it, from another tree."""
        path = other.path(module)
        for file in (path, *path.parent.glob(f'__pycache__/{path.stem}.*.nb[ci]')):
            shutil.copy2(file, self.folder / file.relative_to(other.folder))

    def enter(self) -> None:
        """Let this process, and those that it starts, import package and tests from here."""
        os.chdir(self.folder)
        os.environ.update(PYTHONPATH=str(self.folder), PYTEST_DEBUG_TEMPROOT=str(self.temporary))
        sys.path.insert(0, str(self.folder))


def forked(run: Callable[[], int], limit_s: float, log: pathlib.Path) -> int:
    """Run a function in a new process; return its id. Its result is the exit status.

    limit_s: CPU time after which the process is ended
    """
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        return pid
    status = 3
    try:
        os.setsid()
        output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s) + 1, int(limit_s) + 3))
        resource.setrlimit(resource.RLIMIT_DATA, (_MOST_BYTES, _MOST_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.alarm(int(_WALL_FACTOR * limit_s) + 60)
        status = run()
    finally:
        os._exit(status)


def outcome_of(pid: int, status: int) -> str:
    """End what a finished process has left running; return what its status means."""
    try:
        os.killpg(pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        pass
    code = os.waitstatus_to_exitcode(status)
    if code == -signal.SIGALRM:
        return 'hung'       # it waited for something; nothing is known
    if code in (-signal.SIGXCPU, -signal.SIGKILL):
        return 'endless'
    # 0: all passed. Others: a test failed, the package cannot be imported, or it crashed.
    return 'survived' if code == 0 else 'killed'


class Chosen:
    """What a process runs: the chosen tests, until one fails or to the end.

    failures: where the names of tests that fail are written
    worlds: where worlds of earlier processes are kept, or None
    """

    def __init__(self, tests: list[str], seconds: dict[str, float], failures: pathlib.Path,
                 worlds: pathlib.Path | None, to_the_end: bool = False) -> None:
        self.tests, self.seconds, self.failures = set(tests), seconds, failures
        self.worlds, self.to_the_end = worlds, to_the_end
        failures.write_text('')

    def of(self, items: list[pytest.Item]) -> list[pytest.Item]:
        """Return the chosen ones: quick ones first, the others file by file."""
        items = [item for item in items if item.nodeid in self.tests]
        slowest: dict[pathlib.Path, float] = {}
        for item in items:
            slowest[item.path] = max(slowest.get(item.path, 0.0), self.seconds[item.nodeid])

        def order(item: pytest.Item) -> tuple[bool, float, str, float]:
            own_s = self.seconds[item.nodeid]
            return own_s > _QUICK_S, slowest[item.path], str(item.path), own_s

        return sorted(items, key=order)

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Choose and sort."""
        items[:] = self.of(items)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef
                             ) -> Generator[None, object, object]:
        """Let the tests find the worlds of earlier processes."""
        result = yield
        if fixturedef.argname == 'world_cache' and self.worlds is not None:
            os.environ['LUNAR_ROVER_SIM_CACHE'] = str(self.worlds)
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """End with the first failure."""
        if report.failed:
            with self.failures.open('a', encoding='utf-8') as file:
                file.write(f'{report.nodeid}\n')
            if not self.to_the_end:
                os._exit(1)


def run_collecting(tree: Tree, chosen: Chosen) -> int:
    """Run the tests of a tree in this process, which has not imported the package."""
    tree.enter()
    status = pytest.main([*OPTIONS, *sorted({test.partition('::')[0] for test in chosen.tests})],
                         plugins=[chosen])
    return 0 if status == pytest.ExitCode.NO_TESTS_COLLECTED else int(status)


class Server:
    """A plugin that calls a function, with itself, in place of running the collected tests."""

    def __init__(self, tree: Tree, serve: Callable[[Server], None]) -> None:
        self.tree, self.serve = tree, serve
        self.items: list[pytest.Item] = []
        self.functions: dict[str, list[FunctionType]] = {}      # by file

    def run(self, tests: list[str]) -> NoReturn:
        """Collect the tests and serve; this process ends with it."""
        self.tree.enter()
        os._exit(int(pytest.main([*OPTIONS, *tests], plugins=[self])))

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Serve."""
        self.items = list(session.items)
        gc.unfreeze()       # by conftest; frozen objects are not among those that follow
        for function in gc.get_objects():
            if isinstance(function, FunctionType):
                self.functions.setdefault(function.__code__.co_filename, []).append(function)
        if not any(name.startswith(str(self.tree.folder)) for name in self.functions):
            raise RuntimeError('no function of the package was found, so none can be changed')
        self.serve(self)
        return True

    def run_changed(self, module: str, code: str, chosen: Chosen) -> int:
        """Exchange the functions of a module, run tests; return the exit status."""
        name = str(self.tree.path(module))
        codes = dict(_codes(compile(code, name, 'exec', dont_inherit=True)))
        for function in self.functions.get(name, ()):
            old = function.__code__
            function.__code__ = codes[old.co_qualname, old.co_firstlineno]
        self.forget()
        items = chosen.of(self.items)
        if items:
            items[0].config.pluginmanager.register(chosen)
        for item, following in zip(items, [*items[1:], None]):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        return 0

    def forget(self) -> None:
        """Empty the caches of functions, of the package and of its tests."""
        for module in list(sys.modules.values()):
            if str(getattr(module, '__file__', '')).startswith(str(self.tree.folder)):
                for value in vars(module).values():
                    if not isinstance(value, type) and hasattr(value, 'cache_clear'):
                        value.cache_clear()


def _codes(code: CodeType) -> Generator[tuple[tuple[str, int], CodeType], None, None]:
    """Yield all functions in a code, by qualified name and first line."""
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield (part.co_qualname, part.co_firstlineno), part
            yield from _codes(part)
