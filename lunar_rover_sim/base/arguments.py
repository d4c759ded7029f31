"""Checks of the arguments of functions, and values as one short line for errors."""

from __future__ import annotations

import os
import reprlib

from lunar_rover_sim.base.errors import ConfigError

INT64 = 2**63       # whole numbers are below it, as those of ROS parameters


class _Brief(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        # Python refuses to write numbers of more than 4300 digits.
        return repr(x) if abs(x) < INT64 else f'<whole number of {x.bit_length()} bits>'


_BRIEF = _Brief()
_BRIEF.maxstring = _BRIEF.maxother = 80
_BRIEF.maxlevel = 3


def brief(value: object) -> str:
    """Return a value as one short line, however large it is."""
    return _BRIEF.repr(value)


def check_argument(name: str, value: object, kind: type | tuple[type, ...], valid: str) -> None:
    """Raise ConfigError, which names an argument of a function, unless it is of a kind."""
    if not isinstance(value, kind):
        raise ConfigError(f'{name}: {brief(value)} is not valid; valid is {valid}')


def check_path(name: str, value: object) -> None:
    """Raise ConfigError unless an argument is a path."""
    check_argument(name, value, (str, os.PathLike), 'a path')
