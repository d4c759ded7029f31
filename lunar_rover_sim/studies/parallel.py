"""One function over many items, by this process or by several."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
import multiprocessing
from typing import TypeVar

from lunar_rover_sim.errors import StudyError

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
