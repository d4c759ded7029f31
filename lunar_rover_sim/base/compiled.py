"""Loops that Numba compiles.

Numba keeps what it has compiled of a file until that file changes; here also until what it takes
from other files does, compiled functions and numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import fcntl
import os
from typing import Any

import numba
from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.dispatcher import Dispatcher
import numpy as np
from numpy.typing import DTypeLike, NDArray

from lunar_rover_sim.base.compilation import COMPILATION


class _Listener(event.Listener):  # type: ignore[misc]
    """Passes on that something is compiled: not what was kept, nor what is loaded."""

    def on_start(self, _event: event.Event) -> None:
        COMPILATION.begin()

    def on_end(self, _event: event.Event) -> None:
        COMPILATION.end()


event.register('numba:compile', _Listener())


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function, and keep the result for other processes if there is a place for it."""
    return _compiled(function)


def vectorised(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `compiled`, for loops over pixels, whose sums may be fused and reordered."""
    return _compiled(function, fastmath={'contract', 'nsz', 'arcp', 'reassoc'})


def _compiled(function: Callable[..., Any], **further: Any) -> Callable[..., Any]:
    # A division by zero is no exception; other threads run meanwhile.
    dispatcher = numba.njit(error_model='numpy', nogil=True, **further)(function)
    # Neither this folder nor the user's cache may be writable.
    with contextlib.suppress(RuntimeError):
        dispatcher._cache = _SharedCache(function)
    return dispatcher


class _SharedCache(FunctionCache):  # type: ignore[misc]
    """Keeps what is compiled of a function, for all processes."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = SharedFiles(self.cache_path, self._impl.filename_base,
                                       (self._impl.locator.get_source_stamp(),
                                        *_taken_from_elsewhere(function)))


def _taken_from_elsewhere(function: Callable[..., Any]) -> tuple[Any, Any]:
    """Return times and sizes of files whose compiled functions a file uses, and its numbers."""
    names = function.__globals__
    files = {value.py_func.__code__.co_filename for value in names.values()
             if isinstance(value, Dispatcher)} - {function.__code__.co_filename}
    return ([(os.stat(file).st_mtime, os.stat(file).st_size) for file in sorted(files)],
            {name: value for name, value in names.items()
             if isinstance(value, (int, float, np.number))})


class SharedFiles(IndexDataCacheFile):  # type: ignore[misc]
    """The code of a function by types of its arguments, and an index of it.

    Numba takes no lock, and writes the index first: of two processes that compile a function for
    different types at a time, one got the code of the other, and so did all later ones.
    """

    def load(self, key: Any) -> Any:
        """Return the code for these types; None if there is none."""
        with self._locked(fcntl.LOCK_SH):
            return super().load(key)

    def save(self, key: Any, data: Any) -> None:
        """Keep the code for these types."""
        with self._locked(fcntl.LOCK_EX):
            index = self._load_index()
            name = index.get(key, self._data_name(len(index) + 1))
            self._save_data(name, data)
            self._save_index({**index, key: name})

    @contextlib.contextmanager
    def _locked(self, how: int) -> Iterator[None]:
        with contextlib.ExitStack() as owned:
            # Where nothing can be written, nothing changes.
            with contextlib.suppress(OSError):
                fcntl.flock(owned.enter_context(
                    open(os.path.join(self._cache_path, 'lock'), 'ab')), how)
            yield


def read_only(array: NDArray[Any], dtype: DTypeLike) -> NDArray[Any]:
    """Return an array of a world for compiled functions.

    Those of a world that was loaded are read-only, and arrays that may be written to are another
    type, for which all would be compiled again.
    """
    view = np.ascontiguousarray(array, dtype).view()
    view.flags.writeable = False
    return view


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function into those that call it."""
    options: Any = {'error_model': 'numpy', 'inline': 'always'}
    return numba.njit(**options)(function)
