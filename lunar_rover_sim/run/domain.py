"""A ROS domain of one's own, so that graphs side by side do not hear each other."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
import tempfile
from types import TracebackType

from lunar_rover_sim.errors import GraphError

# Domains whose ports stay clear of the ephemeral range on Linux.
_FIRST, _LAST = 1, 101


class OwnDomain:
    """Holds a free ROS_DOMAIN_ID of this machine until closed; context manager.

    Only runs of this package are kept apart by this; a domain that somebody else uses can be
    avoided by naming one.
    """

    def __init__(self, domain: int | None = None) -> None:
        folder = Path(tempfile.gettempdir()) / f'lunar_rover_sim_domains_{os.getuid()}'
        folder.mkdir(mode=0o700, exist_ok=True)
        # Spread, so that two users' runs seldom meet.
        start = os.getpid()
        count = _LAST - _FIRST + 1
        candidates = [domain] if domain is not None else \
            [_FIRST + (start + k) % count for k in range(count)]
        for candidate in candidates:
            file = os.open(folder / str(candidate), os.O_RDWR | os.O_CREAT, 0o600)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                os.close(file)
                continue
            self._file: int | None = file
            self.id = candidate
            return
        if domain is not None:
            raise GraphError(f'--domain {domain}: another run is using it; choose another')
        raise GraphError(f'all ROS domains {_FIRST} to {_LAST} are in use by other runs')

    def close(self) -> None:
        """Give the domain back."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def __enter__(self) -> OwnDomain:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 traceback: TracebackType | None) -> None:
        self.close()
