"""Output folders of commands, always new ones so that no result is overwritten; home folders."""

from __future__ import annotations

from pathlib import Path

from lunar_rover_sim.errors import ConfigError


def refuse_existing(folder: Path) -> None:
    """Raise ConfigError if a folder or a file of that name exists."""
    if folder.exists():
        raise ConfigError(f'--output: {folder} exists; name a new folder')


def make_new(folder: Path) -> None:
    """Make a folder; raise ConfigError if it exists or cannot be made."""
    refuse_existing(folder)
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise ConfigError(f'--output: {folder} cannot be made: {error}') from None


def user_path(text: str, name: str) -> Path:
    """Return a path in which `~` is the home of the user.

    name: of the parameter, for the ConfigError that is raised if there is no home.
    """
    try:
        return Path(text).expanduser()
    except RuntimeError:
        raise ConfigError(f'{name}: {text} names a home folder that there is not') from None
