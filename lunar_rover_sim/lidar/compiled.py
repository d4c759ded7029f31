"""Loops that Numba compiles.

Numba keeps what it has compiled of a file until that file changes. So compiled functions use no
constants and no functions of other files.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function, and keep the result for other processes if there is a place for it."""
    options: Any = {'error_model': 'numpy'}     # a division by zero is no exception
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:    # neither this folder nor the user's cache can be written to
        return numba.njit(**options)(function)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function into those that call it."""
    options: Any = {'error_model': 'numpy', 'inline': 'always'}
    return numba.njit(**options)(function)
