"""A benchmark: every estimator on every drive. Each such cell is done once, and its result kept.

The folder of a benchmark holds `recordings/DRIVE` (one per scenario, swept value and seed, shared
by all sensors) and `cells/DRIVE-SENSOR-SYSTEM` with a `result.json`, which is written when the
cell is done. A benchmark that was stopped goes on when it is called again.
`sequences-SYSTEM/DRIVE` holds an exported recording while estimators work on it.
`sequences-SYSTEM` is locked: other systems may be run in the same folder at the same time, and not
the same one twice.

Several drives may be under way at once, each in a thread of its own: nodes and estimators are
other processes, and what is left for the threads is a fraction of the work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
import dataclasses
import json
import os
from pathlib import Path
import shutil
import threading
from typing import Any

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import LunarRoverSimError, SlamError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import BAG_FOLDER, lock
from lunar_rover_sim.judge.slam.drives import CELLS, Drive, Judged, read_result, RESULT
from lunar_rover_sim.judge.slam.estimators import ANCHORED, Estimator
from lunar_rover_sim.judge.slam.graph.anchor import Anchor
from lunar_rover_sim.judge.slam.run_on_bag import run_on_bag, SlamResult
from lunar_rover_sim.run.recording import record, Recording
from lunar_rover_sim.run.resumable import record_once
from lunar_rover_sim.run.scenario import Scenario


class StepCounter:
    """Tells how many parts of a piece of work are done, at about every hundredth of it."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._text, self._total, self._count = '', 0, 0

    def begin(self, text: str, total: int | None) -> None:
        """Announce work of `total` parts; None if unknown."""
        self._text, self._total, self._count = text, total or 0, 0
        self._tell(text)

    def advance(self) -> None:
        """Count a part that is done."""
        self._count += 1
        if self._total and self._count % max(1, self._total // 100) == 0:
            self._tell(f'{self._text}, {self._count} of {self._total}')


# The topics that estimators and their evaluation need.
_RECORDED = (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.LEFT_INFO, topics.RIGHT_INFO,
             topics.TRUE_DEPTH, topics.ODOM, topics.IMU_RAW, topics.SCENARIO, topics.WORLD_HASH)
# What wheels and graph need besides, where it is recorded.
AIDED = (*_RECORDED, topics.WHEEL_ODOM, topics.SUN_SENSOR, topics.STAR_TRACKER, topics.SUN)
_START_S = 300.0     # wall time that the nodes may take to start
_SLOWEST = 60.0      # most wall time over simulated time


@dataclasses.dataclass(frozen=True)
class Cell:
    """One drive, one estimator, and the result once there is one.

    Attributes:
        failed: Whether the result is the reason of a failure, without numbers.
    """

    drive: Drive
    estimator: Estimator
    result: SlamResult | None = None
    failed: bool = False

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f'{self.drive.name}-{self.estimator.sensor}-{self.estimator.system}'

    def judged(self, folder: Path) -> Judged:
        """Return its result; folder: that of the benchmark."""
        assert self.result is not None
        return Judged(self.drive, self.result, self.failed, cell_folder(folder, self))


Step = Callable[[Cell, str], None]


def scenario_of(drive: Drive) -> Scenario:
    """Return the scenario of a drive, recorded with the topics that estimators need.

    Raises:
        ConfigError: If a setting is not valid.
    """
    return drive.load_scenario(
        f'recorder_node.topics=[{",".join(topic.name for topic in _RECORDED)}]')


def plan(scenarios: Sequence[str], estimators: Sequence[Estimator], seeds: Sequence[int],
         duration_s: float, parameter: str = '', values: Sequence[str] = (),
         overrides: Sequence[str] = ()) -> list[Cell]:
    """Return the cells of a benchmark, recording by recording.

    Args:
        parameter, values: What a sweep changes.

    Raises:
        SlamError: If an argument is not valid, or two cells would share a folder.
    """
    if not duration_s > 0.0:
        raise SlamError(f'duration: {duration_s:g} is not valid; valid is > 0 [s]')
    if bool(parameter) != bool(values):
        raise SlamError('sweep: needs a parameter and its values, NODE.PARAM=V1,V2,...')
    cells = [Cell(Drive(scenario, seed, duration_s, parameter, value, tuple(overrides)), estimator)
             for scenario in scenarios for value in (values or ('',))
             for seed in seeds for estimator in estimators]
    names = [cell.name for cell in cells]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise SlamError(f'benchmark: two cells are called {twice}; name each scenario, '
                        'seed, sensor and value once')
    return cells


def run(cells: Iterable[Cell], folder: Path, step: Step = lambda _cell, _text: None,
        retry: bool = False, jobs: int = 1,
        recorder: Callable[..., Recording] = record,
        anchor_of: Callable[[Drive], Anchor | None] = lambda _drive: None) -> list[Cell]:
    """Do what is missing, and return all cells with their results.

    A cell that fails keeps its reason, and the others go on.

    Args:
        step: Called with a cell and a text: what is being done and how much of it is, at last
            `done` or `kept`. One thread calls it at a time.
        retry: Do failed cells again.
        jobs: Drives that are recorded or judged at the same time.
        recorder: Records a drive; takes the arguments of `run.recording.record`.
        anchor_of: Returns what finds the place of a drive on its site, for the graph.

    Raises:
        SlamError: If the folder cannot be written, holds cells of other settings, or another
            benchmark runs these systems in it.
    """
    cells = list(cells)
    drives: dict[Drive, list[Cell]] = {}
    for cell in cells:
        drives.setdefault(cell.drive, []).append(cell)
    stop, one_at_a_time = threading.Event(), threading.Lock()

    def tell(cell: Cell, text: str) -> None:
        if stop.is_set():
            raise _Stopped
        with one_at_a_time:
            step(cell, text)

    # Another benchmark of this folder may run other systems at the same time.
    systems = sorted({cell.estimator.system for cell in cells})
    with _sequences(folder, systems) as sequences, ThreadPoolExecutor(jobs) as pool:
        pending = [pool.submit(_do_drive, of_drive, folder, sequences / drive.name, recorder, tell,
                               retry, stop.is_set, anchor_of)
                   for drive, of_drive in drives.items()]
        try:
            ended, _ = wait(pending, return_when=FIRST_EXCEPTION)
            for future in ended:
                future.result()
        finally:
            # After an error, or Ctrl-C: the others end early, nodes in order.
            stop.set()
            pool.shutdown(cancel_futures=True)
    done = {cell.name: cell for future in pending for cell in future.result()}
    return [done[cell.name] for cell in cells]


def cell_folder(folder: Path, cell: Cell) -> Path:
    """Return the folder with the files of a cell."""
    return folder / CELLS / cell.name


class _Stopped(Exception):
    """The benchmark is being stopped."""


def _do_drive(cells: Sequence[Cell], folder: Path, sequence: Path,
              recorder: Callable[..., Recording], step: Step, retry: bool,
              stop: Callable[[], bool],
              anchor_of: Callable[[Drive], Anchor | None]) -> list[Cell]:
    """Do what is missing of the cells of one drive, which share its recording.

    Args:
        sequence: Where it is exported; removed in the end.
    """
    done, bag, failure, exported = [], None, '', ''

    def recorded(cell: Cell) -> Path:
        nonlocal failure
        if failure:
            raise SlamError(failure)
        step(cell, 'recording')
        try:
            return _record(cell.drive, folder / 'recordings', recorder, lambda now_ns: step(
                cell, f'recording, {now_ns / 1e9:.0f} of {cell.drive.duration_s:g} s'), stop)
        except LunarRoverSimError as error:
            failure = str(error)
            raise

    try:
        for cell in cells:
            kept = _read(cell, folder)
            if kept is not None and not (kept.failed and retry):
                step(kept, 'kept')
                done.append(kept)
                continue
            try:
                bag = bag or recorded(cell)
                if cell.estimator.format != exported:
                    shutil.rmtree(sequence, ignore_errors=True)
                    exported = cell.estimator.format
                finished = _judge(cell, bag, sequence, folder, step, stop, anchor_of)
            except LunarRoverSimError as error:
                finished = dataclasses.replace(cell, failed=True, result=SlamResult(
                    cell.estimator.system, cell.estimator.sensor, str(error)))
            except OSError as error:
                raise SlamError(f'{folder}: cannot be written: '
                                f'{error.strerror or error}') from None
            if stop():
                raise _Stopped
            assert finished.result is not None
            _write(cell_folder(folder, cell) / RESULT,
                   {'request': _request(cell), 'failed': finished.failed,
                    'result': finished.result.to_mapping()})
            done.append(finished)
            step(finished, 'done')
    finally:
        shutil.rmtree(sequence, ignore_errors=True)
    return done


def _judge(cell: Cell, bag: Path, sequence: Path, folder: Path, step: Step,
           stop: Callable[[], bool], anchor_of: Callable[[Drive], Anchor | None]) -> Cell:
    """Return the cell with what its estimator made of the recording."""
    work = cell_folder(folder, cell)
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    counter = StepCounter(lambda text: step(cell, text))
    return dataclasses.replace(cell, result=run_on_bag(
        bag, cell.estimator, work, step=counter.begin, advance=counter.advance,
        kept_sequence=sequence, stop=stop,
        anchor=anchor_of(cell.drive) if cell.estimator.system == ANCHORED else None))


@contextmanager
def _sequences(folder: Path, systems: Sequence[str]) -> Iterator[Path]:
    """Yield the empty folder for exported recordings, locked until the context ends.

    Raises:
        SlamError: If it is locked already, or cannot be written.
    """
    path = folder / '-'.join(['sequences', *systems])
    try:
        path.mkdir(parents=True, exist_ok=True)
        locked = lock(path)
    except BlockingIOError:
        raise SlamError(f'{folder}: another benchmark runs the same system in it; wait for its '
                        'end, or name another folder') from None
    except OSError as error:
        raise SlamError(f'{folder}: cannot be written: {error.strerror}') from None
    try:
        for left in path.iterdir():     # by a benchmark that was killed
            shutil.rmtree(left, ignore_errors=True)
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)
        os.close(locked)


def _record(drive: Drive, recordings: Path, recorder: Callable[..., Recording],
            progress: Callable[[int], None], stop: Callable[[], bool]) -> Path:
    """Return the bag of a drive, recorded now unless it is there."""
    folder = record_once(
        scenario_of(drive), recordings / drive.name, recorder=recorder,
        timeout_s=_START_S + _SLOWEST * drive.duration_s, on_progress=progress,
        should_stop=stop,
        finish=lambda partial, _: _write(partial / 'drive.json', dataclasses.asdict(drive)))
    return folder / BAG_FOLDER


def _request(cell: Cell) -> Any:
    request = {'drive': dataclasses.asdict(cell.drive),
               'estimator': dataclasses.asdict(cell.estimator)}
    return json.loads(json.dumps(request, default=str))


def _read(cell: Cell, folder: Path) -> Cell | None:
    path = cell_folder(folder, cell) / RESULT
    if not path.exists():
        return None
    kept, request = read_result(path)
    if request != _request(cell):
        raise SlamError(f'{path}: is the result of other settings; name another folder for this '
                        'benchmark, or remove it')
    return dataclasses.replace(cell, result=kept.result, failed=kept.failed)


def _write(path: Path, value: Any) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SlamError(f'{path.parent}: cannot be made: {error.strerror}') from None
    atomic_write(path, json.dumps(value, indent=2, default=str) + '\n', SlamError)
