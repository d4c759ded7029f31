"""Recordings that are made once.

A finished recording of the same scenario is kept, an unfinished one is made again. The work is
done in another folder, which takes its name in one step when it is complete: whatever stops the
work, the same call completes it.
"""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
from pathlib import Path
import shutil
from typing import Any

from lunar_rover_sim.bag.marker import why_incomplete
from lunar_rover_sim.base.errors import BagError, ConfigError, GraphError
from lunar_rover_sim.base.files.atomic import sync_folder
from lunar_rover_sim.base.files.paths import BAG_FOLDER
from lunar_rover_sim.run.plan import resolve, SCENARIO_FILE
from lunar_rover_sim.run.recording import record, Recording
from lunar_rover_sim.run.scenario import Scenario


def why_incomplete_recording(folder: Path) -> str | None:
    """Return why a folder is not a finished recording, or None if it is one."""
    if not (folder / BAG_FOLDER).is_dir():
        return 'it has no bag'
    return why_incomplete(folder / BAG_FOLDER)


def record_once(scenario: Scenario, folder: Path, *, partial: Path | None = None,
                why_unfinished: Callable[[Path], str | None] = why_incomplete_recording,
                finish: Callable[[Path, Recording], object] = lambda _folder, _recording: None,
                recorder: Callable[..., Recording] = record, **options: Any) -> Path:
    """Return the folder of a scenario's recording, which is made now unless it is there.

    Args:
        folder: Where the recording is, or will be.
        partial: Folder in which it is made (default: beside `folder`); removed if it exists.
        why_unfinished: Returns why a folder is not a finished recording, or None if it is one.
        finish: Called with the partial folder before it takes its name; adds what belongs to it.
        recorder: Records; `run.recording.record`, or a function that takes the same arguments.
        options: Further arguments of `record`.

    Raises:
        BagError: If `folder` holds the recording of another scenario or cannot be written.
        GraphError: If the run is interrupted, and what `recorder` and `finish` raise.
    """
    scenario = resolve(scenario)
    partial = partial or folder.with_name(f'.{folder.name}.partial')
    try:
        if folder.exists():
            _check_scenario(folder, scenario)
            if why_unfinished(folder) is None:
                return folder
            shutil.rmtree(folder)
        if partial.exists():
            shutil.rmtree(partial)
        partial.parent.mkdir(parents=True, exist_ok=True)
        recording = recorder(scenario, partial, **options)
        if recording.interrupted:
            raise GraphError(f'{folder}: the recording was interrupted')
        reason = why_incomplete_recording(partial)
        if reason is not None:
            raise GraphError(f'{folder}: the recording is incomplete: {reason}')
        _check_scenario(partial, scenario)
        finish(partial, recording)
        _move_into_place(partial, folder, why_unfinished)
    except OSError as error:
        raise BagError(f'{folder}: cannot be written: {error.strerror or error}') from None
    return folder


def _check_scenario(folder: Path, scenario: Scenario) -> None:
    """Raise BagError if a folder holds a recording of another scenario."""
    path = folder / SCENARIO_FILE
    if not path.is_file():
        return
    try:
        recorded = Scenario.load(path)
    except ConfigError:
        recorded = None     # not written by this version
    if recorded is not None and not scenario.run.world_hash:
        # A recording names the world that it was made on.
        recorded = dataclasses.replace(
            recorded, run=dataclasses.replace(recorded.run, world_hash=''))
    if recorded is None or recorded.to_yaml() != scenario.to_yaml():
        raise BagError(f'{folder}: was recorded from another scenario; name another folder, or '
                       'remove it')


def _move_into_place(partial: Path, folder: Path,
                     why_unfinished: Callable[[Path], str | None]) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        partial.rename(folder)
    except OSError:
        # Another process may have made the same recording meanwhile.
        if not folder.is_dir() or why_unfinished(folder) is not None:
            raise
        shutil.rmtree(partial)
    sync_folder(folder.parent)
