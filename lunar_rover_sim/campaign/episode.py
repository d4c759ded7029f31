"""One episode: simulated, checked, exported, described, put in its place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import dataclasses
import os
from pathlib import Path
import shutil
import sys
import time
from typing import Any
import uuid

from lunar_rover_sim.campaign import process
from lunar_rover_sim.campaign.episode_plans import EpisodePlan
from lunar_rover_sim.campaign.layout import (EPISODES, ERROR_FILE, FAILED, LOG_FILE, PARTIAL,
                                             PLAN_FILE, TASK_FILE, TOKEN_FILE)
from lunar_rover_sim.campaign.manifest import read_json, sync_folder, why_unfinished, write_json
from lunar_rover_sim.errors import BagError, LunarRoverSimError
from lunar_rover_sim.run.plan import LOG_FOLDER, SCENARIO_FILE

_START_S = 300.0       # world, nodes
_SLOWEST = 60.0        # wall time over simulated time
_FINISH_S = 300.0      # check, export, and so much more per simulated second:
_FINISH_SLOWEST = 10.0
_GRACE_S = 20.0        # the recorder finishes its bag


@dataclasses.dataclass(frozen=True)
class EpisodeTask:
    """What a worker needs to make an episode; plain values, since it may go to another machine.

    token: what the data set's token file holds, by which a worker knows that it sees the folder.
    """

    plan: EpisodePlan
    formats: tuple[str, ...]
    keep_bag: bool
    timeout_s: float
    token: str


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of an episode: why it failed, or ''; wall time [s]; frames recorded."""

    name: str
    error: str
    wall_s: float
    frames: int = 0
    interrupted: bool = False


def make_episode(task: EpisodeTask, dataset: str | Path,
                 stopped: Callable[[], bool] = lambda: False) -> Outcome:
    """Make an episode and put it under its name; what fails is recorded, not raised.

    Work goes on in a folder of its own, so that attempts never meet; whoever is first wins.
    """
    start = time.monotonic()
    dataset = Path(dataset)
    name = task.plan.name
    attempt = dataset / PARTIAL / f'{name}.{uuid.uuid4().hex[:12]}'
    try:
        _check_shared(dataset, task.token)
        attempt.mkdir(parents=True)
        error = _simulate_and_finish(task, attempt, stopped)
        if stopped() and error:
            return Outcome(name, 'was interrupted', time.monotonic() - start, interrupted=True)
        if not error:
            frames = _install(task, attempt, dataset)
            return Outcome(name, '', time.monotonic() - start, frames)
        _bury(name, attempt, dataset, error)
    except (OSError, LunarRoverSimError) as problem:
        error = f'{type(problem).__name__}: {problem}' if isinstance(problem, OSError) \
            else str(problem)
    finally:
        shutil.rmtree(attempt, ignore_errors=True)
    return Outcome(name, error, time.monotonic() - start)


def _check_shared(dataset: Path, token: str) -> None:
    try:
        found = (dataset / TOKEN_FILE).read_text(encoding='ascii').strip()
    except OSError:
        found = ''
    if found != token:
        raise BagError(f'{dataset}: this machine ({os.uname().nodename}) does not see the folder '
                       'of the data set; valid is one that all workers share')


def _simulate_and_finish(task: EpisodeTask, attempt: Path, stopped: Callable[[], bool]) -> str:
    """Return why the episode failed; '' where it did not."""
    plan = attempt / PLAN_FILE
    plan.write_text(task.plan.scenario_yaml, encoding='utf-8')
    timeout_s = task.timeout_s or _START_S + _SLOWEST * task.plan.duration_s
    run = process.run(
        [sys.executable, '-m', 'lunar_rover_sim.cli.main', 'run', str(plan), '-o',
         str(attempt / EPISODES)], attempt / LOG_FILE, timeout_s, _GRACE_S, stopped)
    if run.words:
        return f'the simulation failed: {run.words}'
    write_json(attempt / TASK_FILE, {
        'name': task.plan.name, 'drawn': task.plan.drawn, 'formats': list(task.formats),
        'keep_bag': task.keep_bag, 'scenario_sha256': task.plan.scenario_hash,
        'run_wall_s': round(run.wall_s, 3)})
    written = (attempt / EPISODES / SCENARIO_FILE).read_text(encoding='utf-8')
    if written != task.plan.scenario_yaml:
        return 'the scenario that was run is not the one that was planned'
    finish = process.run(
        [sys.executable, '-m', 'lunar_rover_sim.campaign.finish', str(attempt)],
        attempt / LOG_FILE, _FINISH_S + _FINISH_SLOWEST * task.plan.duration_s, _GRACE_S, stopped)
    return finish.words


def _install(task: EpisodeTask, attempt: Path, dataset: Path) -> int:
    """Put the finished episode under its name; return its number of frames."""
    target = dataset / EPISODES / task.plan.name
    frames = int(read_json(attempt / EPISODES / 'manifest.json')['statistics']['frames'])
    try:
        (attempt / EPISODES).rename(target)
    except OSError:
        # Another attempt was first.
        if why_unfinished(target, task.plan.scenario_hash) is not None:
            raise
    sync_folder(target.parent)
    shutil.rmtree(dataset / FAILED / task.plan.name, ignore_errors=True)
    return frames


def _bury(name: str, attempt: Path, dataset: Path, error: str) -> None:
    """Keep what tells why an episode failed: error, logs, scenario."""
    grave = dataset / FAILED / name
    shutil.rmtree(grave, ignore_errors=True)
    grave.mkdir(parents=True)
    for source in (attempt / LOG_FILE, attempt / PLAN_FILE):
        if source.is_file():
            shutil.copyfile(source, grave / source.name)
    logs = attempt / EPISODES / LOG_FOLDER
    if logs.is_dir():
        shutil.copytree(logs, grave / LOG_FOLDER)
    record: Mapping[str, Any] = {'name': name, 'error': error}
    write_json(grave / ERROR_FILE, record)
