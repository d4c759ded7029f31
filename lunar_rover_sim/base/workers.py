"""Threads that share the rows of images, where there are cores for them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
import os
import threading
from typing import Any

_MOST_THREADS = 8
_FEWEST_ROWS = 16       # of a thread: of less, handing over takes as long as the work


class Workers:
    """Calls a function many times, in threads or one call after the other.

    The thread that asks for the calls takes its part. They write to different places, and compiled
    functions hold no lock: results are the same with any number of threads.

    Attributes:
        memory: What each thread keeps from call to call.
    """

    def __init__(self, count: int | None = None) -> None:
        """Start no thread yet; count: of threads, by default half of the cores, or both of two."""
        cores = len(os.sched_getaffinity(0))
        self._count = min(max(cores // 2, min(cores, 2)), _MOST_THREADS) if count is None \
            else count
        self._pool = ThreadPoolExecutor(max(self._count - 1, 1))    # unused by a count of one
        self.memory = threading.local()

    def map(self, function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]]) -> list[Any]:
        """Return the results of a function for the arguments of each task, in order."""
        tasks = list(tasks)
        results: list[Any] = [None] * len(tasks)
        left = iter(enumerate(tasks))   # the interpreter's lock hands out each of them once

        def work() -> None:
            for k, task in left:
                results[k] = function(*task)
        others = [self._pool.submit(work) for _ in range(min(self._count, len(tasks)) - 1)]
        try:
            work()
        finally:
            # One that has not begun finds nothing left to do.
            errors = [other.exception() for other in others if not other.cancel()]
        for error in filter(None, errors):
            raise error
        return results

    def rows(self, function: Callable[..., Any], height: int, *args: Any) -> list[Any]:
        """Call function(first row, row after the last, *args) for all rows of an image."""
        return self.map(function, [(*ends, *args) for ends in self.shares(height)])

    def shares(self, size: int) -> list[tuple[int, int]]:
        """Return the first row or column of each thread, and the one after its last."""
        parts = max(min(self._count, size // _FEWEST_ROWS), 1)
        bounds = [size * k // parts for k in range(parts + 1)]
        return list(zip(bounds, bounds[1:]))

    def release(self) -> None:
        """Let the threads end."""
        self._pool.shutdown()


ONE_THREAD = Workers(1)
