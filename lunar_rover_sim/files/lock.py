"""Locks between processes, on a file or a folder."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path


def lock(path: Path, mode: int | None = 0o644) -> int:
    """Return a descriptor that locks a folder, or a file that is made if it is missing.

    The lock holds until the descriptor is closed or its process ends. mode: of a file that is
    made; None: none is made, and the file is only read.
    Raises BlockingIOError where another descriptor holds the lock, OSError where there is none.
    """
    if path.is_dir():
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    elif mode is None:
        descriptor = os.open(path, os.O_RDONLY)
    else:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, mode)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor
