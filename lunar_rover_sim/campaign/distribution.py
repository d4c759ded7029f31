"""Distributions of parameters: from a probability in [0, 1] to a value, by the quantile.

A distribution is written as a mapping of one kind to its numbers:

    {uniform: [a, b]}        any number from a to b
    {log_uniform: [a, b]}    any number from a to b, equally likely per factor
    {normal: [mean, sd]}     cut off at mean ± 3 sd
    {integer: [a, b]}        any whole number from a to b, both included
    {choice: [v, w, ...]}    one of the values; mappings set several parameters at once

and, for a grid, `levels: n`: the number of values, at even steps of the probability from 0 to 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
import math
from typing import Any

from scipy.special import ndtr, ndtri

from lunar_rover_sim.arguments import brief
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.parameters import nearest

KINDS = ('uniform', 'log_uniform', 'normal', 'integer', 'choice')
MAX_CHOICES = 1000
MAX_LEVELS = 1000
_CUT_SIGMAS = 3.0
_LARGEST = 1e12
# Digits that are kept: enough for any parameter, and files stay readable.
_DIGITS = 9


@dataclasses.dataclass(frozen=True)
class Distribution:
    """One distribution; `numbers` are its two numbers, or its values for a choice.

    Attributes:
        levels: Number of values in a grid; 0 if the file names none.
    """

    kind: str
    numbers: tuple[Any, ...]
    levels: int = 0

    @classmethod
    def parse(cls, name: str, text: object) -> Distribution:
        """Return the distribution that a campaign file describes; ConfigError names `name`."""
        if not isinstance(text, Mapping):
            raise ConfigError(f'{name}: {brief(text)} is not a distribution; valid is a mapping '
                              f'with one of {", ".join(KINDS)}')
        for key in text:
            if key not in (*KINDS, 'levels'):
                raise ConfigError(f'{name}: no such distribution {brief(key)}; '
                                  f'{nearest(str(key), KINDS)}')
        kinds = [kind for kind in KINDS if kind in text]
        if len(kinds) != 1:
            raise ConfigError(f'{name}: {len(kinds)} distributions given; valid is one of '
                              f'{", ".join(KINDS)}')
        kind, numbers = kinds[0], text[kinds[0]]
        if isinstance(numbers, (str, bytes)) or not isinstance(numbers, Sequence):
            raise ConfigError(f'{name}.{kind}: {brief(numbers)} is not a list')
        levels = text.get('levels', 0)
        if not _is_int(levels) or not 0 <= levels <= MAX_LEVELS:
            raise ConfigError(f'{name}.levels: {brief(levels)} is not valid; valid is a whole '
                              f'number from 2 to {MAX_LEVELS}')
        if kind == 'choice':
            if not 1 <= len(numbers) <= MAX_CHOICES:
                raise ConfigError(f'{name}.choice: {len(numbers)} values given; valid are 1 to '
                                  f'{MAX_CHOICES}')
            return cls(kind, tuple(numbers), len(numbers))
        if levels == 1:
            raise ConfigError(f'{name}.levels: 1 is not valid; valid is 2 or more, or a choice')
        return cls(kind, _two_numbers(f'{name}.{kind}', kind, numbers), levels)

    def quantile(self, probability: float) -> Any:
        """Return the value below which a share in [0, 1] of the distribution lies."""
        if self.kind == 'choice':
            return self.numbers[min(int(probability * len(self.numbers)), len(self.numbers) - 1)]
        a, b = self.numbers
        if self.kind == 'integer':
            return min(a + int(probability * (b - a + 1)), b)
        if self.kind == 'log_uniform':
            value = math.exp(math.log(a) + probability * (math.log(b) - math.log(a)))
        elif self.kind == 'normal':
            value = _normal(probability, a, b)
        else:
            value = a + probability * (b - a)
        rounded = _rounded(value)
        if self.kind == 'normal' or a <= rounded <= b:
            return rounded
        return _rounded(min(max(rounded, a), b))

    def grid(self) -> list[Any]:
        """Return the values of a grid, in order."""
        if self.kind == 'choice':
            return list(self.numbers)
        if self.kind == 'integer':
            a, b = self.numbers
            count = min(self.levels, b - a + 1)
            return [a + round(k * (b - a) / max(count - 1, 1)) for k in range(count)]
        return [self.quantile(k / (self.levels - 1)) for k in range(self.levels)]

    def to_mapping(self) -> dict[str, Any]:
        """Return what `parse` reads."""
        result: dict[str, Any] = {self.kind: list(self.numbers)}
        if self.levels and self.kind != 'choice':
            result['levels'] = self.levels
        return result


def _two_numbers(name: str, kind: str, numbers: Sequence[Any]) -> tuple[Any, Any]:
    valid = _is_int if kind == 'integer' else _is_number
    if len(numbers) != 2 or not all(valid(n) for n in numbers):
        what = 'whole numbers' if kind == 'integer' else 'finite numbers'
        raise ConfigError(f'{name}: {brief(numbers)} is not valid; valid are two {what} of at '
                          f'most {_LARGEST:g}')
    a, b = numbers
    if kind == 'normal':
        if not b > 0.0:
            raise ConfigError(f'{name}: standard deviation {b} is not valid; valid is > 0')
    elif not a < b:
        raise ConfigError(f'{name}: {brief(numbers)} is not valid; valid is lower, then upper')
    if kind == 'log_uniform' and not a > 0.0:
        raise ConfigError(f'{name}: {a} is not valid; valid is > 0')
    return (a, b) if kind == 'integer' else (float(a), float(b))


def _normal(probability: float, mean: float, sd: float) -> float:
    """Return the quantile of a normal distribution cut off at `_CUT_SIGMAS`."""
    low = ndtr(-_CUT_SIGMAS)
    return float(mean + sd * ndtri(low + probability * (1.0 - 2.0 * low)))


def _rounded(value: float) -> float:
    return float(f'{value:.{_DIGITS}g}')


def _is_int(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= _LARGEST


def _is_number(value: object) -> bool:
    return _is_int(value) or (isinstance(value, float) and math.isfinite(value)
                              and abs(value) <= _LARGEST)
