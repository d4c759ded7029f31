"""Refusing the output of a command before anything is computed; new output folders.

Each function raises ConfigError where nothing can be written under a name: a folder is expected
where a file is or the other way round, the name is that of a device, or the folder in which it
would be made is missing or not for this user. `name`: of the parameter, in the error.
"""

from __future__ import annotations

from pathlib import Path
import tempfile

from lunar_rover_sim.errors import ConfigError

_OPTION = '--output'


def check_file(path: Path) -> None:
    """Refuse what cannot become a file, or be replaced by one; its folder must exist."""
    if _exists(path) and not path.is_file():
        raise ConfigError(f'--output: {path} is not a regular file; name a file')
    _check_inside(path.parent, path)


def check_png(path: Path) -> None:
    """Refuse as `check_file`, and what does not end in .png: figures are written as PNG."""
    if path.suffix.lower() != '.png':
        raise ConfigError(f'--output: {path} is no name of a picture; valid is one that ends in '
                          '.png')
    check_file(path)


def check_folder(path: Path, name: str = _OPTION) -> None:
    """Refuse what is not a folder to write to, and cannot be made with the folders above it."""
    _check_inside(next(p for p in (path, *path.absolute().parents) if _exists(p, name)), path,
                  name)


def check_new_folder(path: Path, name: str = _OPTION) -> None:
    """Refuse what exists or cannot be made with the folders above it: nothing is overwritten."""
    check_folder(path, name)
    if path.exists():
        raise ConfigError(f'{name}: {path} exists; name a new folder')


def make_new_folder(path: Path, name: str = _OPTION) -> None:
    """Make a folder and those above it; refuse as `check_new_folder`."""
    check_new_folder(path, name)
    try:
        path.mkdir(parents=True)
    except OSError as error:
        raise ConfigError(f'{name}: {path} cannot be written: {error.strerror}') from None


def check_path(path: Path) -> None:
    """Refuse a file or a folder whose own folder cannot be written or made."""
    check_folder(path.parent)


def _exists(path: Path, name: str = _OPTION) -> bool:
    try:
        return path.exists()
    except OSError as error:    # such as a name that is too long
        raise ConfigError(f'{name}: {path} cannot be written: {error.strerror}') from None


def _check_inside(folder: Path, path: Path, name: str = _OPTION) -> None:
    """Raise ConfigError for the output `path` if no file can be made in a folder."""
    if not folder.is_dir():
        raise ConfigError(f'{name}: {path} cannot be written: {folder} is not a folder')
    try:
        # Permissions alone do not say it: root has them in /sys, too.
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise ConfigError(f'{name}: {path} cannot be written: '
                          f'{error.strerror or error}') from None
