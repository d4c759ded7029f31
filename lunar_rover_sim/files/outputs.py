"""Refusing the output of a command before anything is computed.

Each function raises ConfigError where nothing can be written under a name: a folder is expected
where a file is or the other way round, the name is that of a device, or the folder in which it
would be made is missing or not for this user.
"""

from __future__ import annotations

from pathlib import Path
import tempfile

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.folders import refuse_existing


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


def check_folder(path: Path) -> None:
    """Refuse what is not a folder to write to, and cannot be made with the folders above it."""
    _check_inside(next(p for p in (path, *path.absolute().parents) if _exists(p)), path)


def check_new_folder(path: Path) -> None:
    """Refuse what exists or cannot be made with the folders above it."""
    check_folder(path)
    refuse_existing(path)


def check_path(path: Path) -> None:
    """Refuse a file or a folder whose own folder cannot be written or made."""
    check_folder(path.parent)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError as error:    # such as a name that is too long
        raise ConfigError(f'--output: {path} cannot be written: {error.strerror}') from None


def _check_inside(folder: Path, path: Path) -> None:
    """Raise ConfigError for the output `path` if no file can be made in a folder."""
    if not folder.is_dir():
        raise ConfigError(f'--output: {path} cannot be written: {folder} is not a folder')
    try:
        # Permissions alone do not say it: root has them in /sys, too.
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise ConfigError(f'--output: {path} cannot be written: '
                          f'{error.strerror or error}') from None
