"""Many drives of a study: by several processes, and in a folder from which it can be resumed.

The folder holds the settings of the study, and a file for each finished drive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
import json
import multiprocessing
from pathlib import Path
from typing import Any, TypeVar

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import make_new_folder

Item = TypeVar('Item')
Result = TypeVar('Result')


def map_in_processes(function: Callable[[Item], Result], items: Sequence[Item], workers: int,
                     progress: Callable[[Result, int, int], object] | None = None
                     ) -> list[Result]:
    """Return function(item) of all items, in their order.

    Args:
        workers: Number of processes; up to 1 for this one. They get function and items pickled.
        progress: Called with each result, how many there are so far, and how many there will be.

    Raises:
        StudyError: If a process dies.
    """
    results: list[Result] = []

    def collect(stream: Iterable[Result]) -> None:
        for result in stream:
            results.append(result)
            if progress is not None:
                progress(result, len(results), len(items))

    if workers <= 1:
        collect(map(function, items))
        return results
    # Not forked: a forked process would share threads and GPU contexts with this one.
    with ProcessPoolExecutor(workers, multiprocessing.get_context('spawn')) as pool:
        try:
            collect(pool.map(function, items))
        except BrokenProcessPool as error:
            raise StudyError(f'a worker process died: {error}') from None
    return results


Drive = TypeVar('Drive')


class StudyFolder:
    """One file per drive, and the settings that all were made with."""

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
        file = folder / self.settings_file
        if resume and folder.exists():
            try:
                before = file.read_text(encoding='utf-8')
            except OSError as error:
                raise StudyError(f'{folder}: is no study to resume: {error.strerror}') from None
            if before != settings:
                raise StudyError(f'{folder}: was made with other settings; compare {file}, or give'
                                 ' another folder')
        else:
            make_new_folder(folder)
            atomic_write(file, settings, StudyError)
        self._drives.mkdir(exist_ok=True)

    def read(self, name: str, make: Callable[[dict[str, Any]], Drive]) -> Drive | None:
        """Return what `make` makes of the values of a drive; None if there is no such drive.

        Raises:
            StudyError: If its file cannot be read.
        """
        path = self._path(name)
        if not path.exists():
            return None
        try:
            return make(json.loads(path.read_text(encoding='utf-8')))
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise StudyError(f'{path}: is no drive of this study: {error}; delete it to make it'
                             ' again') from None

    def write(self, name: str, values: Mapping[str, Any]) -> None:
        """Keep the values of a finished drive."""
        atomic_write(self._path(name), json.dumps(values), StudyError)

    def _path(self, name: str) -> Path:
        return self._drives / f'{name}.json'
