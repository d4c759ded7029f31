"""Where the package's own configuration files are, installed or in the source tree."""

from __future__ import annotations

from pathlib import Path
import sys

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.parameters import nearest

_PACKAGE = Path(__file__).resolve().parents[1]


def config_folder() -> Path:
    """Return the folder `config/`: of the source tree, or share/lunar_rover_sim of the prefix."""
    source = _PACKAGE.parent / 'config'
    if (source / 'scenarios').is_dir() and (_PACKAGE.parent / 'package.xml').is_file():
        return source
    # site-packages lies below the prefix that holds share/, in a venv as in a colcon install.
    for prefix in (*_PACKAGE.parents, Path(sys.prefix)):
        installed = prefix / 'share' / 'lunar_rover_sim' / 'config'
        if installed.is_dir():
            return installed
    raise ConfigError('the folder share/lunar_rover_sim/config is missing; install the package '
                      'again')


def config_path(name: str) -> Path:
    """Return the path of a packaged configuration file such as `rover.yaml`."""
    path = config_folder() / name
    if not path.exists():
        raise ConfigError(f'{name}: no such packaged configuration file in {path.parent}')
    return path


def packaged_names(kind: str) -> list[str]:
    """Return the names of the packaged files of a kind: 'scenario' or 'campaign'."""
    return sorted(path.stem for path in (config_folder() / f'{kind}s').glob('*.yaml'))


def find_file(kind: str, name_or_path: str) -> Path:
    """Return the file of a kind that a packaged name or a path means.

    Raises ConfigError where there is none, offering the nearest names.
    """
    path = Path(name_or_path)
    if path.suffix in ('.yaml', '.yml') or '/' in name_or_path:
        if not path.is_file():
            raise ConfigError(f'{name_or_path}: no such {kind} file')
        return path
    packaged = config_folder() / f'{kind}s' / f'{name_or_path}.yaml'
    if not packaged.is_file():
        raise ConfigError(f'{name_or_path}: no such {kind}; '
                          f'{nearest(name_or_path, packaged_names(kind))}')
    return packaged
