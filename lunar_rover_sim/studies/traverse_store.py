"""Finished drives of a traverse study in its folder, so that it can be resumed."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np

from lunar_rover_sim.errors import StudyError
from lunar_rover_sim.files.atomic import atomic_write
from lunar_rover_sim.files.paths import make_new_folder
from lunar_rover_sim.studies.traverse_result import Traverse

SETTINGS_FILE, DRIVES_FOLDER = 'settings.yaml', 'drives'


class TraverseStore:
    """One file per drive, and the settings that all were made with."""

    def __init__(self, folder: Path, settings: str, resume: bool) -> None:
        """Make the folder, or go on with it.

        settings: all that the drives depend on but ground and seed, as text
        Raises ConfigError if the folder exists already and is not to be resumed, StudyError if it
        belongs to other settings.
        """
        self._drives = folder / DRIVES_FOLDER
        file = folder / SETTINGS_FILE
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

    def load(self, ground: str, seed: int) -> Traverse | None:
        """Return a finished drive, None if there is none; StudyError if it cannot be read."""
        path = self._path(ground, seed)
        if not path.exists():
            return None
        try:
            values = json.loads(path.read_text(encoding='utf-8'))
            return Traverse(**{**values, 'path_m': np.array(values['path_m']).reshape(-1, 3)})
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise StudyError(f'{path}: is no drive of this study: {error}; delete it to make it'
                             ' again') from None

    def save(self, ground: str, result: Traverse) -> None:
        """Keep a finished drive."""
        values = {**dataclasses.asdict(result), 'path_m': result.path_m.tolist()}
        atomic_write(self._path(ground, result.seed), json.dumps(values), StudyError)

    def _path(self, ground: str, seed: int) -> Path:
        return self._drives / f'{ground}_{seed}.json'
