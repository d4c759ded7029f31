"""Home folders in paths that a user gives."""

from __future__ import annotations

from pathlib import Path

from lunar_rover_sim.errors import ConfigError


def user_path(text: str, name: str) -> Path:
    """Return a path in which `~` is the home of the user.

    name: of the parameter, for the ConfigError that is raised if there is no home.
    """
    try:
        return Path(text).expanduser()
    except RuntimeError:
        raise ConfigError(f'{name}: {text} names a home folder that there is not') from None
