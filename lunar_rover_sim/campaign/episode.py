"""Making episodes, each in a process of its own: one, many on this machine, or on a Dask cluster.

On a cluster, each thread of a worker makes one episode at a time. All machines must share the
folder of the data set; each worker checks that for itself. If a worker dies, Dask gives its
episode to another one, a few times (`distributed.scheduler.allowed-failures`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed, ThreadPoolExecutor
from contextlib import suppress
import dataclasses
import logging
import os
from pathlib import Path
import shutil
import sys
import threading
import time
import uuid

from lunar_rover_sim.base.errors import CampaignError, LunarRoverSimError, one_line, with_extra
from lunar_rover_sim.campaign.campaign_file import EpisodePlan
from lunar_rover_sim.campaign.manifest import (EPISODES, ERROR_FILE, FAILED, LOG_FILE, MANIFEST,
                                               PARTIAL, PLAN_FILE, read_json, STOP_FILE, TASK_FILE,
                                               TOKEN_FILE, write_json)
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
        try:
            _keep_failure(name, attempt, dataset, error)
        except OSError as problem:
            error += f'; its logs are not kept: {problem.strerror or problem}'
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


_CONNECT_S = 5


def run_local(tasks: Sequence[EpisodeTask], dataset: Path, jobs: int,
              done: Callable[[Outcome], None]) -> None:
    """Make episodes, `jobs` at a time; call `done` in this thread with each outcome.

    On KeyboardInterrupt, or if `done` raises, the running episodes are stopped first.
    """
    stop = threading.Event()
    # Each thread waits for the process of its episode.
    with ThreadPoolExecutor(max(1, min(jobs, len(tasks)))) as pool:
        futures = {pool.submit(make_episode, task, dataset, stop.is_set): task for task in tasks}
        try:
            for future in as_completed(futures):
                problem = future.exception()
                done(_failed(futures[future], problem) if problem else future.result())
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def run_on_cluster(tasks: Sequence[EpisodeTask], dataset: Path, address: str,
                   done: Callable[[Outcome], None]) -> None:
    """Make episodes on the cluster of the scheduler at `address` (tcp://host:port).

    `done` is called in this thread with each outcome.

    Raises:
        CampaignError: If there is no such scheduler, it has no workers, or Dask is not installed.
    """
    try:
        import distributed  # here, because it is an optional dependency
    except ImportError:
        raise CampaignError(f"dask.distributed is missing: {with_extra('cluster')}") from None
    stop = dataset / STOP_FILE
    stop.unlink(missing_ok=True)
    try:
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = one_line(error)[:200]
        raise CampaignError(f'--scheduler {address}: no Dask scheduler answers: '
                            f'{reason}') from None
    with client:
        if not client.scheduler_info(n_workers=-1)['workers']:
            raise CampaignError(f'--scheduler {address}: it has no workers; start some with '
                                f'`dask worker {address}`')
        # pure=False: a task is done for its effect, so that an equal one is not left out.
        futures = {client.submit(_make, task, str(dataset), pure=False): task
                   for task in tasks}
        try:
            for future in distributed.as_completed(list(futures), loop=client.loop):
                problem = future.exception()
                done(_failed(futures[future], problem) if problem else future.result())
        except BaseException:
            # Waiting tasks are cancelled; running ones see the file and stop.
            with suppress(OSError):
                stop.touch()
            with suppress(OSError):
                client.cancel(list(futures))
            raise


def _failed(task: EpisodeTask, error: BaseException) -> Outcome:
    """Return the outcome of a task that ended with an error, which the others survive."""
    return Outcome(task.plan.name, f'{type(error).__name__}: {error}', 0.0)


def _make(task: EpisodeTask, dataset: str) -> Outcome:
    """Make an episode on a worker."""
    logging.getLogger(__name__).info('episode %s', task.plan.name)
    return make_episode(task, dataset, (Path(dataset) / STOP_FILE).exists)
