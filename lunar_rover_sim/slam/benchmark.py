"""Many drives, many estimators: cells that are done once and kept.

A folder holds `recordings/DRIVE` (one per scenario, swept value and seed; all sensors share it)
and `cells/DRIVE-SENSOR-SYSTEM` with a `result.json` that appears when the cell is done. Whatever
stops a benchmark, the same call goes on with what is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import dataclasses
import json
import os
from pathlib import Path
import re
import shutil
from typing import Any

from lunar_rover_sim.errors import LunarRoverSimError, SlamError
from lunar_rover_sim.slam.estimators import Estimator
from lunar_rover_sim.slam.run_on_bag import run_on_bag, SlamResult

BAG = 'bag'                  # in the folder of a recording
_INCOMPLETE = 'incomplete.yaml'


@dataclasses.dataclass(frozen=True)
class Drive:
    """One simulated drive; parameter and value are what a sweep changes, empty without one."""

    scenario: str
    seed: int
    duration_s: float
    parameter: str = ''
    value: str = ''
    overrides: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of its folder."""
        swept = f'-{self.parameter}={self.value}' if self.parameter else ''
        return re.sub(r'[^\w.=+-]', '_', f'{Path(self.scenario).stem}{swept}-seed{self.seed}')

    @property
    def settings(self) -> list[str]:
        """What is set in the scenario, as NODE.PARAM=VALUE."""
        return [*self.overrides, *([f'{self.parameter}={self.value}'] if self.parameter else [])]


@dataclasses.dataclass(frozen=True)
class Cell:
    """One drive, one estimator, and what came out; failed: there is a reason and no result."""

    drive: Drive
    estimator: Estimator
    result: SlamResult | None = None
    failed: bool = False

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f'{self.drive.name}-{self.estimator.sensor}-{self.estimator.system}'


Simulate = Callable[[Drive, Path], None]   # records into a folder that it makes, with a bag in it
Step = Callable[[Cell, str], None]


def plan(scenarios: Sequence[str], estimators: Sequence[Estimator], seeds: int,
         duration_s: float, parameter: str = '', values: Sequence[str] = (),
         overrides: Sequence[str] = ()) -> list[Cell]:
    """Return the cells of a benchmark, recording by recording; seeds count from 1.

    Raises SlamError where nothing would be done, or two cells would share a folder.
    """
    if seeds < 1 or not scenarios or not estimators:
        raise SlamError(f'benchmark: {len(scenarios)} scenarios, {len(estimators)} sensors, '
                        f'{seeds} seeds; valid is at least 1 of each')
    if not duration_s > 0.0:
        raise SlamError(f'duration: {duration_s:g} is not valid; valid is > 0 [s]')
    if bool(parameter) != bool(values):
        raise SlamError('sweep: needs a parameter and its values, NODE.PARAM=V1,V2,...')
    cells = [Cell(Drive(scenario, seed, duration_s, parameter, value, tuple(overrides)), estimator)
             for scenario in scenarios for value in (values or ('',))
             for seed in range(1, seeds + 1) for estimator in estimators]
    names = [cell.name for cell in cells]
    if len(set(names)) < len(names):
        double = next(name for name in names if names.count(name) > 1)
        raise SlamError(f'benchmark: two cells are called {double}; name each scenario, '
                        'sensor and value once')
    return cells


def run(cells: Iterable[Cell], folder: Path, simulate: Simulate, step: Step | None = None,
        retry: bool = False) -> list[Cell]:
    """Do what is missing, and return all cells with their results.

    retry: do failed cells again. A cell that fails keeps its reason, and the others go on. Raises
    SlamError where the folder cannot be written, or holds cells of other settings.
    """
    step = step or (lambda _cell, _text: None)
    done = []
    failed_drives: dict[Drive, str] = {}
    for cell in cells:
        kept = _read(cell, folder)
        if kept is not None and not (kept.failed and retry):
            step(kept, 'kept')
            done.append(kept)
            continue
        done.append(_do(cell, folder, simulate, step, failed_drives))
        step(done[-1], 'done')
    return done


def cell_folder(folder: Path, cell: Cell) -> Path:
    """Return where a cell keeps its files."""
    return folder / 'cells' / cell.name


def _do(cell: Cell, folder: Path, simulate: Simulate, step: Step,
        failed_drives: dict[Drive, str]) -> Cell:
    system, sensor = cell.estimator.system, cell.estimator.sensor
    try:
        if cell.drive in failed_drives:
            raise SlamError(failed_drives[cell.drive])
        step(cell, 'recording')
        try:
            bag = _record(cell.drive, folder / 'recordings', simulate)
        except LunarRoverSimError as error:
            failed_drives[cell.drive] = str(error)
            raise
        work = cell_folder(folder, cell)
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        result = run_on_bag(bag, cell.estimator, work, step=lambda text: step(cell, text))
        finished = dataclasses.replace(cell, result=result)
    except LunarRoverSimError as error:
        finished = dataclasses.replace(cell, result=SlamResult(system, sensor, str(error)),
                                       failed=True)
    except OSError as error:
        raise SlamError(f'{folder}: cannot be written: {error.strerror or error}') from None
    assert finished.result is not None
    _write(cell_folder(folder, cell) / 'result.json',
           {'request': _request(cell), 'failed': finished.failed,
            'result': finished.result.to_mapping()})
    return finished


def _record(drive: Drive, recordings: Path, simulate: Simulate) -> Path:
    """Return the bag of a drive, recorded now if it is not there."""
    folder = recordings / drive.name
    if folder.exists():
        if _plain(dataclasses.asdict(drive)) != _load(folder / 'drive.json'):
            raise SlamError(f'{folder}: was recorded with other settings; name another '
                            'folder for this benchmark, or remove it')
        return folder / BAG
    partial = recordings / f'.{drive.name}.partial'
    shutil.rmtree(partial, ignore_errors=True)
    recordings.mkdir(parents=True, exist_ok=True)
    simulate(drive, partial)
    if not (partial / BAG).is_dir() or (partial / BAG / _INCOMPLETE).exists():
        raise SlamError(f'{drive.name}: the recording is incomplete')
    _write(partial / 'drive.json', dataclasses.asdict(drive))
    partial.rename(folder)
    return folder / BAG


def _request(cell: Cell) -> Any:
    return _plain({'drive': dataclasses.asdict(cell.drive),
                   'estimator': dataclasses.asdict(cell.estimator)})


def _read(cell: Cell, folder: Path) -> Cell | None:
    path = cell_folder(folder, cell) / 'result.json'
    if not path.exists():
        return None
    kept = _load(path)
    try:
        if kept['request'] != _request(cell):
            raise SlamError(f'{path}: is of other settings; name another folder for this '
                            'benchmark, or remove it')
        return dataclasses.replace(cell, result=SlamResult.from_mapping(kept['result']),
                                   failed=bool(kept['failed']))
    except (KeyError, TypeError, AttributeError):
        raise SlamError(f'{path}: is not a result of a benchmark') from None


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value, default=str))


def _load(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError) as error:
        raise SlamError(f'{path}: cannot be read: {error}') from None


def _write(path: Path, value: Any) -> None:
    """Write JSON that is there whole or not at all."""
    partial = path.with_name(f'.{path.name}.{os.getpid()}.partial')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(json.dumps(value, indent=2, default=str) + '\n', encoding='utf-8')
        partial.replace(path)
    except OSError as error:
        raise SlamError(f'{path}: cannot be written: {error.strerror}') from None
