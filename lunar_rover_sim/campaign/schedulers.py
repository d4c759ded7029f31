"""Making many episodes: side by side on this machine, or on a Dask cluster.

On a cluster, each thread of a worker makes one episode at a time. All machines must share the
folder of the data set; each worker checks that for itself. If a worker dies, Dask gives its
episode to another one, a few times (`distributed.scheduler.allowed-failures`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed, ThreadPoolExecutor
from contextlib import suppress
import logging
from pathlib import Path
import threading

from lunar_rover_sim.base.errors import CampaignError, one_line, with_extra
from lunar_rover_sim.campaign.episode import EpisodeTask, make_episode, Outcome
from lunar_rover_sim.campaign.layout import STOP_FILE

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
