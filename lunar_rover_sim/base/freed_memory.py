"""Memory that was freed, back to the system."""

from __future__ import annotations

import contextlib
import ctypes


def return_freed() -> None:
    """Give freed memory back, where the C library can; elsewhere nothing happens.

    glibc keeps what is freed in between what is used. After large arrays of other sizes have come
    and gone, as when windows of a site change, a process holds half as much again as it uses.
    """
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
