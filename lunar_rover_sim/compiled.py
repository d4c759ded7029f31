"""Loops that Numba compiles.

Numba keeps what it has compiled of a file until that file changes. So compiled functions use no
constants and no functions of other files.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import DTypeLike, NDArray


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function, and keep the result for other processes if there is a place for it."""
    return _compiled(function)


def vectorised(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `compiled`, for loops over pixels, whose sums may be fused and reordered."""
    return _compiled(function, fastmath={'contract', 'nsz', 'arcp', 'reassoc'})


def _compiled(function: Callable[..., Any], **further: Any) -> Callable[..., Any]:
    # A division by zero is no exception; other threads run meanwhile.
    options: Any = {'error_model': 'numpy', 'nogil': True, **further}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:    # neither this folder nor the user's cache can be written to
        return numba.njit(**options)(function)


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
