"""One episode, made in a process of its own: recorded, checked, exported, put in its place."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import os
from pathlib import Path
import shutil
import sys
import time
import uuid

from lunar_rover_sim.base.errors import CampaignError, LunarRoverSimError
from lunar_rover_sim.campaign.episode_plans import EpisodePlan
from lunar_rover_sim.campaign.layout import (EPISODES, ERROR_FILE, FAILED, LOG_FILE, PARTIAL,
                                             PLAN_FILE, TASK_FILE, TOKEN_FILE)
from lunar_rover_sim.campaign.manifest import MANIFEST, read_json, write_json
from lunar_rover_sim.run.child_process import run_program
from lunar_rover_sim.run.plan import LOG_FOLDER

_START_S = 300.0       # wall time of the world and the start of the nodes
_SLOWEST = 60.0        # wall time over simulated time
_FINISH_S = 300.0      # wall time of check and export, and so much more per simulated second:
_FINISH_SLOWEST = 10.0
_GRACE_S = 20.0        # the recorder finishes its bag


@dataclasses.dataclass(frozen=True)
class EpisodeTask:
    """What a worker needs to make an episode; plain values, as it may go to another machine.

    Attributes:
        token: Content of the token file of the data set, by which a worker recognises the folder.
    """

    plan: EpisodePlan
    formats: tuple[str, ...]
    keep_bag: bool
    timeout_s: float
    token: str


@dataclasses.dataclass(frozen=True)
class Outcome:
    """The outcome of a task: why the episode failed, or ''; wall time [s]; frames recorded."""

    name: str
    error: str
    wall_s: float
    frames: int = 0
    interrupted: bool = False


def make_episode(task: EpisodeTask, dataset: str | Path,
                 stop: Callable[[], bool] = lambda: False) -> Outcome:
    """Make an episode of a data set in a child process; a failure is recorded, not raised.

    Several attempts at one episode do not disturb each other; the first to finish wins.

    Args:
        stop: Once it returns True, the child process is ended and the outcome is `interrupted`.
    """
    start = time.monotonic()
    dataset = Path(dataset)
    name = task.plan.name
    attempt = dataset / PARTIAL / f'{name}.{uuid.uuid4().hex[:12]}'
    try:
        _check_shared(dataset, task.token)
        attempt.mkdir(parents=True)
        error = _run_process(task, dataset, attempt, stop)
        if error and stop():
            return Outcome(name, 'was interrupted', time.monotonic() - start, interrupted=True)
        if not error:
            shutil.rmtree(dataset / FAILED / name, ignore_errors=True)
            manifest = read_json(dataset / EPISODES / name / MANIFEST)
            return Outcome(name, '', time.monotonic() - start,
                           int(manifest['statistics']['frames']))
        _keep_failure(name, attempt, dataset, error)
    except OSError as problem:
        error = f'{type(problem).__name__}: {problem}'
    except LunarRoverSimError as problem:
        error = str(problem)
    finally:
        shutil.rmtree(attempt, ignore_errors=True)
    return Outcome(name, error, time.monotonic() - start)


def _check_shared(dataset: Path, token: str) -> None:
    """Raise CampaignError if this machine does not see the folder of the data set."""
    try:
        found = (dataset / TOKEN_FILE).read_text(encoding='ascii').strip()
    except OSError:
        found = ''
    if found != token:
        raise CampaignError(f'{dataset}: this machine ({os.uname().nodename}) does not see the '
                            'folder of the data set; valid is one that all workers share')


def _run_process(task: EpisodeTask, dataset: Path, attempt: Path,
                 stop: Callable[[], bool]) -> str:
    """Return why the episode failed; '' if it did not."""
    plan = task.plan
    (attempt / PLAN_FILE).write_text(plan.scenario_yaml, encoding='utf-8')
    run_s = task.timeout_s or _START_S + _SLOWEST * plan.duration_s
    write_json(attempt / TASK_FILE, {
        'name': plan.name, 'drawn': plan.drawn, 'formats': list(task.formats),
        'keep_bag': task.keep_bag, 'scenario_sha256': plan.scenario_hash, 'timeout_s': run_s})
    return run_program(
        [sys.executable, '-m', 'lunar_rover_sim.campaign.episode_process', attempt,
         dataset / EPISODES / plan.name], attempt / LOG_FILE,
        run_s + _FINISH_S + _FINISH_SLOWEST * plan.duration_s, grace_s=_GRACE_S, stop=stop).error


def _keep_failure(name: str, attempt: Path, dataset: Path, error: str) -> None:
    """Keep what shows why an episode failed: error, logs, scenario."""
    failed = dataset / FAILED / name
    shutil.rmtree(failed, ignore_errors=True)
    failed.mkdir(parents=True)
    for source in (attempt / LOG_FILE, attempt / PLAN_FILE):
        if source.is_file():
            shutil.copyfile(source, failed / source.name)
    logs = attempt / EPISODES / LOG_FOLDER
    if logs.is_dir():
        shutil.copytree(logs, failed / LOG_FOLDER)
    write_json(failed / ERROR_FILE, {'name': name, 'error': error})
