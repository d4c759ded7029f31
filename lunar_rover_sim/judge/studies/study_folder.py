"""Many drives of a study: by several processes, and in a folder from which it can be resumed.

The folder holds the settings of the study, and a file for each finished drive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
import dataclasses
import json
import multiprocessing
from pathlib import Path
from typing import Any, Generic, TypeVar

from lunar_rover_sim.base.errors import LunarRoverSimError, StudyError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import make_new_folder
from lunar_rover_sim.base.files.yaml_text import read_text

_MOST_BYTES = 1 << 26       # of the settings, or a drive
Item = TypeVar('Item')
Result = TypeVar('Result')
Progress = Callable[[int, int], object]     # called with how many are done, and of how many


def silent(done: int, total: int) -> None:
    """Show no progress."""


def map_in_processes(function: Callable[[Item], Result], items: Sequence[Item], workers: int,
                     progress: Progress = silent) -> list[Result]:
    """Return function(item) of all items, in their order, as `in_processes` makes them."""
    results: list[Result] = []
    for result in in_processes(function, items, workers):
        results.append(result)
        progress(len(results), len(items))
    return results


def in_processes(function: Callable[[Item], Result], items: Sequence[Item],
                 workers: int) -> Iterator[Result]:
    """Yield function(item) of all items, in their order.

    Args:
        workers: Number of processes; up to 1 for this one. They get function and items pickled.

    Raises:
        StudyError: If a process dies.
    """
    if workers <= 1:
        yield from map(function, items)
        return
    # Not forked: a forked process would share threads and GPU contexts with this one.
    with ProcessPoolExecutor(workers, multiprocessing.get_context('spawn')) as pool:
        try:
            yield from pool.map(function, items)
        except BrokenProcessPool as error:
            raise StudyError(f'a worker process died: {error}') from None


def write_report(folder: Path, name: str, text: str, table: str = '') -> str:
    """Write NAME.md, and a table as NAME.csv; return the text, which is Markdown.

    Raises:
        StudyError: If one cannot be written.
    """
    atomic_write(folder / f'{name}.md', text, StudyError)
    if table:
        atomic_write(folder / f'{name}.csv', table, StudyError)
    return text


Case = TypeVar('Case')
Drive = TypeVar('Drive')


class StudyFolder(Generic[Case, Drive]):
    """One file per drive, and the settings that all were made with.

    A drive is a record, or plain values.
    """

    settings_file = 'settings.yaml'

    def __init__(self, folder: Path, settings: str, resume: bool) -> None:
        """Make the folder, or go on with it.

        Args:
            folder: Of the study.
            settings: All that the drives depend on but what their names say, as text.
            resume: Go on with a folder that exists.

        Raises:
            ConfigError: If the folder exists already and is not to be resumed.
            StudyError: If it belongs to other settings.
        """
        self._drives = folder / 'drives'
        self._file = file = folder / self.settings_file
        if resume and folder.exists():
            try:
                before = read_text(file, _MOST_BYTES, StudyError)
            except StudyError as error:
                raise StudyError(f'{folder}: is no study to resume: {error}') from None
            if before != settings:
                raise StudyError(f'{folder}: was made with other settings; compare {file}, or give'
                                 ' another folder')
        else:
            make_new_folder(folder)
            atomic_write(file, settings, StudyError)
        self._drives.mkdir(exist_ok=True)

    def name(self, case: Case) -> str:
        """Return the name of the file of a drive, without its suffix."""
        return str(case)

    def drive(self, values: dict[str, Any]) -> Drive:
        """Return the drive of the values of its record: arrays are lists."""
        return values   # type: ignore[return-value]

    def load(self, case: Case) -> Drive | None:
        """Return a finished drive; None if it is not there.

        Raises:
            StudyError: If its file cannot be read.
        """
        path = self._path(case)
        if not path.exists():
            return None
        try:
            return self.drive(json.loads(read_text(path, _MOST_BYTES, StudyError)))
        except (StudyError, ValueError, TypeError, KeyError, RecursionError) as error:
            raise StudyError(f'{path}: is no drive of this study: {error}; delete it to make it'
                             ' again') from None

    def save(self, case: Case, drive: Drive) -> None:
        """Keep a finished drive."""
        atomic_write(self._path(case), json.dumps(drive, default=_plain), StudyError)

    def study(self, make: Callable[[Case], Drive], cases: Sequence[Case], workers: int = 1,
              progress: Callable[[Case, Drive, int], object] = lambda case, drive, done: None
              ) -> dict[Case, Drive]:
        """Make the drives that are missing, keep each at once, and return all of them.

        Args:
            make: Makes the drive of a case; pickled for other processes.
            progress: Called with case, drive and the number of finished ones.
        """
        found = {case: self.load(case) for case in cases}
        done = {case: drive for case, drive in found.items() if drive is not None}
        left = [case for case in cases if case not in done]
        try:
            for drive, case in zip(in_processes(make, left, workers), left):
                self.save(case, drive)
                done[case] = drive
                progress(case, drive, len(done))
        except LunarRoverSimError:
            if not any(self._drives.iterdir()):
                self._remove()
            raise
        return {case: done[case] for case in cases}

    def _remove(self) -> None:
        """Remove the folder of a study that was refused; other files stay."""
        self._drives.rmdir()
        self._file.unlink()
        with suppress(OSError):
            self._drives.parent.rmdir()

    def _path(self, case: Case) -> Path:
        return self._drives / f'{self.name(case)}.json'


def _plain(value: Any) -> Any:
    """Return a record or an array as JSON has it."""
    return value.tolist() if hasattr(value, 'tolist') else dataclasses.asdict(value)
