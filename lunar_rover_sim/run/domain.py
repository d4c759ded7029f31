"""A free ROS domain for each run, so that parallel runs do not receive each other's messages."""

from __future__ import annotations

import numbers
import os
from pathlib import Path
import tempfile
from types import TracebackType

from lunar_rover_sim.arguments import brief
from lunar_rover_sim.errors import ConfigError, GraphError
from lunar_rover_sim.files.paths import lock

# Domains whose ports stay clear of the ephemeral range on Linux.
_FIRST, _LAST = 1, 101
# Ports of DDS are 7400 + 250 per domain (RTPS specification 2.5, 9.6.2), and end at 65535.
_MOST = 232


class OwnDomain:
    """Holds a free ROS_DOMAIN_ID of this machine until closed; context manager.

    The lock is a file that other runs of this package respect. Other programs do not know it; name
    a domain that they do not use.

    id: the domain
    """

    def __init__(self, domain: int | None = None) -> None:
        """Take `domain`, or any free one.

        Raises ConfigError for a number that is no domain, GraphError if a run of this package
        holds it.
        """
        if domain is not None and not (isinstance(domain, numbers.Integral)
                                       and 0 <= domain <= _MOST):
            raise ConfigError(f'--domain {brief(domain)}: is not valid; valid is 0 to {_MOST}')
        folder = Path(tempfile.gettempdir()) / f'lunar_rover_sim_domains_{os.getuid()}'
        folder.mkdir(mode=0o700, exist_ok=True)
        # Runs of two users, who do not share the folder, seldom start at the same domain.
        start = os.getpid()
        count = _LAST - _FIRST + 1
        candidates = [domain] if domain is not None else \
            [_FIRST + (start + k) % count for k in range(count)]
        for candidate in candidates:
            try:
                self._file: int | None = lock(folder / str(candidate), 0o600)
            except BlockingIOError:
                continue
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
