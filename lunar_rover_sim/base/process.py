"""What a process takes of the system: open files, and memory that it gives back."""

from __future__ import annotations

import contextlib
import ctypes
import resource

from lunar_rover_sim.base.errors import ConfigError

_LEAST = 64


def check_open_files() -> None:
    """Raise ConfigError if a process may open so few files that libraries cannot be loaded."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if 0 <= limit < _LEAST:
        raise ConfigError(f'{limit} open files are allowed; at least {_LEAST} are needed; raise '
                          f'the limit with `ulimit -n {_LEAST}`')


def return_freed() -> None:
    """Give freed memory back, where the C library can; elsewhere nothing happens.

    glibc keeps what is freed in between what is used. After large arrays of other sizes have come
    and gone, as when windows of a site change, a process holds half as much again as it uses.
    """
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
