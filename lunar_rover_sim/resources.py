"""Where the package's own configuration files are, installed or in the source tree."""

from __future__ import annotations

from pathlib import Path
import sys

from lunar_rover_sim.errors import ConfigError

_PACKAGE = Path(__file__).resolve().parent


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
