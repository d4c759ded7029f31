"""How many files a process may open."""

from __future__ import annotations

import resource

from lunar_rover_sim.base.errors import ConfigError

_LEAST = 64


def check_open_files() -> None:
    """Raise ConfigError if a process may open so few files that libraries cannot be loaded."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if 0 <= limit < _LEAST:
        raise ConfigError(f'{limit} open files are allowed; at least {_LEAST} are needed; raise '
                          f'the limit with `ulimit -n {_LEAST}`')
