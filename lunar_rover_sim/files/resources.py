"""The configuration files and programs of the package, installed or in the source tree."""

from __future__ import annotations

from pathlib import Path
import sys

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.parameters import nearest

_PACKAGE = Path(__file__).resolve().parents[1]


def config_folder() -> Path:
    """Return the folder `config/` of the source tree, or that in share/ of the installation.

    Raises ConfigError if there is none.
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
    """Return the path of a packaged file such as `rover.yaml`; ConfigError if it is missing."""
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


def packaged_names(kind: str) -> list[str]:
    """Return the names of the packaged files of a kind: 'scenario', 'campaign', …"""
    return sorted(path.stem for path in (config_folder() / f'{kind}s').glob('*.yaml'))


def find_file(kind: str, name_or_path: str) -> Path:
    """Return the file of a kind, given by the name of a packaged one or by its path.

    Raises ConfigError, which offers the nearest names, if there is none.
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
