"""What must hold of everything that a reader accepts or says."""

import math
from typing import Any

from lunar_rover_sim.base.errors import LunarRoverSimError
from lunar_rover_sim.base.parameters import Parameters, ParamInfo


class Contradiction(AssertionError):
    """Something was accepted that the documentation excludes."""


def claim(holds: object, what: str) -> None:
    """Raise Contradiction if something does not hold."""
    if not holds:
        raise Contradiction(what)


def within_bounds(parameters: Parameters, where: str = '') -> None:
    """Every value has its declared type and is within its documented bounds."""
    for name, value, info, kind in parameters.flatten():
        for item in value if isinstance(value, tuple) else (value,):
            _within(f'{where}{name}', item, info)
        claim(isinstance(value, tuple) == str(kind).startswith('tuple'), f'{name}: {value!r}')
        claim(info.length in (None, len(value) if isinstance(value, tuple) else None),
              f'{name}: {value!r} has not {info.length} elements')


def _within(name: str, value: Any, info: ParamInfo) -> None:
    if isinstance(value, float):
        claim(math.isfinite(value), f'{name}: {value}')
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        if info.low is not None:
            claim(value > info.low if info.open_low else value >= info.low, f'{name}: {value}')
        if info.high is not None:
            claim(value < info.high if info.open_high else value <= info.high, f'{name}: {value}')
    if info.choices:
        claim(value in info.choices, f'{name}: {value!r} is none of {info.choices}')


def one_line(error: LunarRoverSimError | str) -> None:
    """A message for people is one line, not a page of it."""
    text = str(error)
    claim(text and text.isprintable(), f'not one printable line: {text[:300]!r}')
    claim(len(text) < 2000, f'{len(text)} characters: {text[:300]!r}')
