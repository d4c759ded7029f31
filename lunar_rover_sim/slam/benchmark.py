"""A benchmark: every estimator on every drive, each of these cells done once and kept.

The folder of a benchmark holds `recordings/DRIVE` (one per scenario, swept value and seed, shared
by all sensors) and `cells/DRIVE-SENSOR-SYSTEM` with a `result.json`, which is written when the
cell is done. Whatever stops a benchmark, the same call does what is missing. `sequence-SYSTEM`
holds the exported recording while estimators work on it, and is locked: other systems may be run
in the same folder at the same time, and not the same one twice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import dataclasses
import json
import os
from pathlib import Path
import shutil
from typing import Any

from lunar_rover_sim import topics
from lunar_rover_sim.errors import LunarRoverSimError, SlamError
from lunar_rover_sim.files.atomic import atomic_write
from lunar_rover_sim.files.lock import lock
from lunar_rover_sim.run.plan import BAG_FOLDER
from lunar_rover_sim.run.recording import record, Recording
from lunar_rover_sim.run.resumable import record_once
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.slam.drives import CELLS, Drive, Judged, load, RESULT
from lunar_rover_sim.slam.estimators import Estimator
from lunar_rover_sim.slam.run_on_bag import run_on_bag, SlamResult

# The topics that estimators and their evaluation need.
_RECORDED = (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.LEFT_INFO, topics.RIGHT_INFO,
             topics.TRUE_DEPTH, topics.ODOM, topics.IMU_RAW, topics.SCENARIO, topics.WORLD_HASH)
_START_S = 300.0     # wall time of the start of the nodes
_SLOWEST = 60.0      # wall time over simulated time


@dataclasses.dataclass(frozen=True)
class Cell:
    """One drive, one estimator, and the result once there is one.

    failed: the result has a reason and no numbers
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

    Raises ConfigError if a setting is not valid.
    """
    return drive.load_scenario(
        f'recorder_node.topics=[{",".join(topic.name for topic in _RECORDED)}]')


def plan(scenarios: Sequence[str], estimators: Sequence[Estimator], seeds: Sequence[int],
         duration_s: float, parameter: str = '', values: Sequence[str] = (),
         overrides: Sequence[str] = ()) -> list[Cell]:
    """Return the cells of a benchmark, recording by recording.

    parameter, values: what a sweep changes. Raises SlamError if an argument is not valid, there is
    nothing to do, or two cells would share a folder.
    """
    if not seeds or not scenarios or not estimators:
        raise SlamError(f'benchmark: {len(scenarios)} scenarios, {len(estimators)} sensors, '
                        f'{len(seeds)} seeds; valid is at least 1 of each')
    if not duration_s > 0.0:
        raise SlamError(f'duration: {duration_s:g} is not valid; valid is > 0 [s]')
    if bool(parameter) != bool(values):
        raise SlamError('sweep: needs a parameter and its values, NODE.PARAM=V1,V2,...')
    cells = [Cell(Drive(scenario, seed, duration_s, parameter, value, tuple(overrides)), estimator)
             for scenario in scenarios for value in (values or ('',))
             for seed in seeds for estimator in estimators]
    names = [cell.name for cell in cells]
    if len(set(names)) < len(names):
        double = next(name for name in names if names.count(name) > 1)
        raise SlamError(f'benchmark: two cells are called {double}; name each scenario, '
                        'seed, sensor and value once')
    return cells


def run(cells: Iterable[Cell], folder: Path, step: Step = lambda _cell, _text: None,
        retry: bool = False, recorder: Callable[..., Recording] = record) -> list[Cell]:
    """Do what is missing, and return all cells with their results.

    step: called with the cell and what is being done, and how far that is, at last with `done` or
        `kept`
    retry: do failed cells again
    recorder: records a drive; takes the arguments of `run.recording.record`

    A cell that fails keeps its reason, and the others go on. Raises SlamError if the folder cannot
    be written, holds cells of other settings, or another benchmark runs these systems in it.
    """
    done = []
    failed_drives: dict[Drive, str] = {}
    cells = list(cells)
    # Another benchmark of this folder may run other systems at the same time.
    systems = sorted({cell.estimator.system for cell in cells})
    with _OneSequence(folder / '-'.join(['sequence', *systems])) as sequence:
        for cell in cells:
            kept = _read(cell, folder)
            if kept is not None and not (kept.failed and retry):
                step(kept, 'kept')
                done.append(kept)
                continue
            done.append(_do(cell, folder, recorder, step, failed_drives, sequence))
            step(done[-1], 'done')
    return done


def cell_folder(folder: Path, cell: Cell) -> Path:
    """Return the folder with the files of a cell."""
    return folder / CELLS / cell.name


def _do(cell: Cell, folder: Path, recorder: Callable[..., Recording], step: Step,
        failed_drives: dict[Drive, str], sequence: _OneSequence) -> Cell:
    system, sensor = cell.estimator.system, cell.estimator.sensor
    try:
        if cell.drive in failed_drives:
            raise SlamError(failed_drives[cell.drive])
        step(cell, 'recording')
        try:
            bag = _record(cell.drive, folder / 'recordings', recorder, lambda now_ns: step(
                cell, f'recording, {now_ns / 1e9:.0f} of {cell.drive.duration_s:g} s'))
        except LunarRoverSimError as error:
            failed_drives[cell.drive] = str(error)
            raise
        work = cell_folder(folder, cell)
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        counter = _Counter(lambda text: step(cell, text))
        result = run_on_bag(bag, cell.estimator, work, step=counter.begin, advance=counter.advance,
                            kept_sequence=sequence.folder(cell))
        finished = dataclasses.replace(cell, result=result)
    except LunarRoverSimError as error:
        finished = dataclasses.replace(cell, result=SlamResult(system, sensor, str(error)),
                                       failed=True)
    except OSError as error:
        raise SlamError(f'{folder}: cannot be written: {error.strerror or error}') from None
    assert finished.result is not None
    _write(cell_folder(folder, cell) / RESULT,
           {'request': _request(cell), 'failed': finished.failed,
            'result': finished.result.to_mapping()})
    return finished


class _OneSequence:
    """The exported sequence of one drive, which estimators that follow each other share.

    Its folder is locked while it is open, as a context manager; SlamError if it is already, or
    cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._locked, self._folder = folder, folder / 'exported'
        self._of: tuple[Drive, str] | None = None
        self._lock: int | None = None

    def folder(self, cell: Cell) -> Path:
        """Return the folder, without the sequence of another drive or format."""
        needed = cell.drive, cell.estimator.format
        if needed != self._of:
            self._remove()
            self._of = needed
        return self._folder

    def _remove(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> _OneSequence:
        try:
            self._locked.mkdir(parents=True, exist_ok=True)
            self._lock = lock(self._locked)
        except BlockingIOError:
            raise SlamError(f'{self._locked.parent}: another benchmark runs the same system in it;'
                            ' wait for its end, or name another folder') from None
        except OSError as error:
            raise SlamError(f'{self._locked.parent}: cannot be written: '
                            f'{error.strerror}') from None
        self._remove()      # left by a benchmark that was killed
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self._locked, ignore_errors=True)
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


class _Counter:
    """Tells how many parts of a piece of work are done, about a hundred times in each."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._text, self._total, self._count = '', 0, 0

    def begin(self, text: str, total: int | None) -> None:
        """Tell that work of so many parts begins; None where nobody knows."""
        self._text, self._total, self._count = text, total or 0, 0
        self._tell(text)

    def advance(self) -> None:
        """Count a part that is done."""
        self._count += 1
        if self._total and self._count % max(1, self._total // 100) == 0:
            self._tell(f'{self._text}, {self._count} of {self._total}')


def _record(drive: Drive, recordings: Path, recorder: Callable[..., Recording],
            progress: Callable[[int], None]) -> Path:
    """Return the bag of a drive, recorded now unless it is there."""
    folder = record_once(
        scenario_of(drive), recordings / drive.name, recorder=recorder,
        timeout_s=_START_S + _SLOWEST * drive.duration_s, on_progress=progress,
        finish=lambda partial, _: _write(partial / 'drive.json', dataclasses.asdict(drive)))
    return folder / BAG_FOLDER


def _request(cell: Cell) -> Any:
    return _plain({'drive': dataclasses.asdict(cell.drive),
                   'estimator': dataclasses.asdict(cell.estimator)})


def _read(cell: Cell, folder: Path) -> Cell | None:
    path = cell_folder(folder, cell) / RESULT
    if not path.exists():
        return None
    kept = load(path)
    try:
        if kept['request'] != _request(cell):
            raise SlamError(f'{path}: is the result of other settings; name another folder for '
                            'this benchmark, or remove it')
        return dataclasses.replace(cell, result=SlamResult.from_mapping(kept['result']),
                                   failed=bool(kept['failed']))
    except (KeyError, TypeError, AttributeError):
        raise SlamError(f'{path}: is not a result of a benchmark') from None


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value, default=str))


def _write(path: Path, value: Any) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SlamError(f'{path.parent}: cannot be made: {error.strerror}') from None
    atomic_write(path, json.dumps(value, indent=2, default=str) + '\n', SlamError)
