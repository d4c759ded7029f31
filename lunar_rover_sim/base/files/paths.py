"""Files and folders by name: of the package, of a user, and what may be done with them."""

from __future__ import annotations

import fcntl
import hashlib
import os
from pathlib import Path
import stat
import sys
import tempfile

from lunar_rover_sim.base.errors import ConfigError, LunarRoverSimError, nearest

BAG_FOLDER = 'bag'      # of a run's folder
_PACKAGE = Path(__file__).resolve().parents[2]


def config_folder() -> Path:
    """Return the folder `config/` of the source tree, or that in share/ of the installation.

    Raises:
        ConfigError: If there is none.
    """
    source = _PACKAGE.parent / 'config'
    if (source / 'scenarios').is_dir() and (_PACKAGE.parent / 'package.xml').is_file():
        return source
    # In a venv and in a colcon install, site-packages is below the prefix that holds share/.
    for prefix in (*_PACKAGE.parents, Path(sys.prefix)):
        installed = prefix / 'share' / 'lunar_rover_sim' / 'config'
        if installed.is_dir():
            return installed
    raise ConfigError('the folder share/lunar_rover_sim/config is missing; install the package '
                      'again')


def config_path(name: str) -> Path:
    """Return the path of a packaged file such as `fastdds.xml`; ConfigError if it is missing."""
    path = config_folder() / name
    if not path.exists():
        raise ConfigError(f'{name}: no such packaged configuration file in {path.parent}')
    return path


def program_path(name: str) -> Path:
    """Return the path of a packaged program of resource/; ConfigError if it is missing."""
    path = config_folder().parent / 'resource' / name
    if not path.is_file():
        raise ConfigError(f'{path}: the packaged program is missing; install the package again')
    return path


def recorded_bag(path: Path | str) -> Path:
    """Return the bag in the folder of a run; any other path as it is."""
    bag = Path(path, BAG_FOLDER)
    return bag if os.path.isdir(bag) else Path(path)     # what cannot be read is told later


def packaged_names(kind: str) -> list[str]:
    """Return the names of the packaged files of a kind: 'scenario', 'campaign', …"""
    return sorted(path.stem for path in (config_folder() / f'{kind}s').glob('*.yaml'))


def find_file(kind: str, name_or_path: str) -> Path:
    """Return the file of a kind, given by the name of a packaged one or by its path.

    Raises:
        ConfigError: If there is none; it offers the nearest names.
    """
    path = Path(name_or_path)
    if path.suffix in ('.yaml', '.yml') or '/' in name_or_path:
        if path.exists() and not path.is_file():
            raise ConfigError(f'{name_or_path}: is not a regular file')
        if not path.is_file():
            raise ConfigError(f'{name_or_path}: no such {kind} file')
        return path
    packaged = config_folder() / f'{kind}s' / f'{name_or_path}.yaml'
    if not packaged.is_file():
        raise ConfigError(f'{name_or_path}: no such {kind}; '
                          f'{nearest(name_or_path, packaged_names(kind))}')
    return packaged


def user_path(text: str, name: str) -> Path:
    """Return a path in which `~` is the home of the user.

    Args:
        name: Of the parameter, for the ConfigError that is raised if there is no home.
    """
    try:
        return Path(text).expanduser()
    except RuntimeError:
        raise ConfigError(f'{name}: {text} names a home folder that there is not') from None


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


def check_regular(path: Path, error: type[LunarRoverSimError] = ConfigError) -> None:
    """Raise `error` if there is no file of that name, or it is a folder, a pipe or a device."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise error(f'{path}: cannot be read: no such file') from None
    except (OSError, ValueError) as reason:
        words = reason.strerror if isinstance(reason, OSError) else reason
        raise error(f'{path}: cannot be read: {words}') from None
    if not stat.S_ISREG(mode):
        raise error(f'{path}: cannot be read: it is not a regular file')


_BLOCK = 1 << 20


def file_hash(path: Path) -> str:
    """Return the hexadecimal SHA-256 of a file; raises OSError if it cannot be read."""
    digest = hashlib.sha256()
    with path.open('rb') as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def lock(path: Path, mode: int | None = 0o644) -> int:
    """Return a descriptor that locks a folder, or a file that is made if it is missing.

    The lock holds until the descriptor is closed or its process ends.

    Args:
        mode: Permissions of a file that is made; None makes none, and opens the file to read it.

    Raises:
        BlockingIOError: If another descriptor holds the lock.
        OSError: If there is no such file or folder.
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


def counted(count: int, thing: str) -> str:
    """Return `1 world`, `2 worlds`: a number, and a noun whose plural ends in s."""
    return f'{count} {thing}' if count == 1 else f'{count} {thing}s'
