"""Sets of one kind by the names that a user gives them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import re
from typing import TypeVar

from lunar_rover_sim.base.errors import ConfigError

V = TypeVar('V')

NAME = 'NAME'       # stands for such names in documentation
_NAME = re.compile(r'[a-z][a-z0-9_]{0,39}')


class Named(Mapping[str, V]):
    """Any number of sets by their names, which can be part of topics, frames and parameters.

    Their order counts: two are equal if they hold equal sets in one order.
    """

    def __init__(self, sets: Mapping[str, V] | None = None) -> None:
        """Raise ConfigError for a name that is not valid."""
        self._sets = {checked_name(name, 'name'): value for name, value in (sets or {}).items()}

    def __getitem__(self, name: str) -> V:
        return self._sets[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._sets)

    def __len__(self) -> int:
        return len(self._sets)

    def __repr__(self) -> str:
        return f'{type(self).__name__}({self._sets!r})'

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Named) and tuple(self.items()) == tuple(other.items())

    def __hash__(self) -> int:
        return hash(tuple(self._sets.items()))


def checked_name(name: str, where: str) -> str:
    """Return a name; raise ConfigError, which begins with `where`, if it is not valid."""
    if not _NAME.fullmatch(name):
        raise ConfigError(f'{where}: {name[:80]!r} is not a valid name; valid are small letters, '
                          'digits and _, with a letter first, at most 40')
    return name
