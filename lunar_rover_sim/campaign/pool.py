"""Episodes side by side on this machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
import queue
import threading

from lunar_rover_sim.campaign.episode import EpisodeTask, make_episode, Outcome

_POLL_S = 0.2


def run_local(tasks: Sequence[EpisodeTask], dataset: Path, jobs: int,
              done: Callable[[Outcome], None]) -> None:
    """Make episodes, `jobs` at a time; `done` is called in this thread with each outcome.

    On KeyboardInterrupt, or whatever else `done` raises, what is running is stopped first.
    """
    stop = threading.Event()
    waiting: queue.SimpleQueue[EpisodeTask] = queue.SimpleQueue()
    for task in tasks:
        waiting.put(task)
    outcomes: queue.SimpleQueue[Outcome] = queue.SimpleQueue()

    def work() -> None:
        while not stop.is_set():
            try:
                task = waiting.get_nowait()
            except queue.Empty:
                return
            try:
                outcome = make_episode(task, dataset, stop.is_set)
            except Exception as error:  # one episode's trouble is not that of the others
                outcome = Outcome(task.plan.name, f'{type(error).__name__}: {error}', 0.0)
            outcomes.put(outcome)

    # Not daemons: they end their processes before this one ends.
    workers = [threading.Thread(target=work) for _ in range(max(1, min(jobs, len(tasks))))]
    for worker in workers:
        worker.start()
    try:
        for _ in tasks:
            while True:
                try:
                    outcome = outcomes.get(timeout=_POLL_S)
                    break
                except queue.Empty:
                    continue
            done(outcome)
    finally:
        stop.set()
        for worker in workers:
            worker.join()
