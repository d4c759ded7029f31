"""Refusing what is not a regular file: a pipe is read for ever, a device has no end."""

from __future__ import annotations

from pathlib import Path
import stat

from lunar_rover_sim.errors import ConfigError, LunarRoverSimError


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
