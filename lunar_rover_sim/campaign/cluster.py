"""Episodes on the workers of a Dask cluster that is there already.

Each thread of a worker makes one episode at a time. The folder of the data set must be one that
all machines share; each worker finds out for itself. A worker that dies takes its episode with
it: Dask gives it to another one, a few times (`distributed.scheduler.allowed-failures`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
import logging
from pathlib import Path

from lunar_rover_sim.campaign.episode import EpisodeTask, make_episode, Outcome
from lunar_rover_sim.campaign.layout import STOP_FILE
from lunar_rover_sim.errors import GraphError

_CONNECT_S = 10


def run_on_cluster(tasks: Sequence[EpisodeTask], dataset: Path, address: str,
                   done: Callable[[Outcome], None]) -> None:
    """Make episodes on the cluster of the scheduler at `address` (tcp://host:port).

    `done` is called in this thread with each outcome. Raises GraphError where there is no such
    scheduler, or it has no workers.
    """
    try:
        from distributed import as_completed, Client
    except ImportError:
        raise GraphError('dask.distributed is missing: '
                         "pip install 'lunar_rover_sim[cluster]'") from None
    stop = dataset / STOP_FILE
    stop.unlink(missing_ok=True)
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = ' '.join(str(error).split())[:200]
        raise GraphError(f'--scheduler {address}: no Dask scheduler answers: {reason}') from None
    with client:
        if not client.scheduler_info(n_workers=-1)['workers']:
            raise GraphError(f'--scheduler {address}: it has no workers; start some with '
                             f'`dask worker {address}`')
        # pure=False: what counts is what it does, not what it returns.
        futures = {client.submit(_make, task, str(dataset), pure=False): task.plan.name
                   for task in tasks}
        try:
            for future in as_completed(list(futures), loop=client.loop):
                if future.status == 'finished':
                    done(future.result())
                else:
                    death = future.exception()
                    done(Outcome(futures[future], f'{type(death).__name__}: {death}', 0.0))
        except BaseException:
            # What waits is taken back; what runs sees the file and stops.
            with suppress(OSError):
                stop.touch()
            with suppress(Exception):
                client.cancel(list(futures))
            raise


def _make(task: EpisodeTask, dataset: str) -> Outcome:
    """Make an episode on a worker."""
    logging.getLogger(__name__).info('episode %s', task.plan.name)
    return make_episode(task, dataset, (Path(dataset) / STOP_FILE).exists)
