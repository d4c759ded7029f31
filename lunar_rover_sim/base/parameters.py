"""Frozen, validated parameter sets, for YAML files and ROS parameters.

A parameter set is a frozen dataclass that derives from `Parameters` and declares its fields with
`param` (a value with unit, range and meaning) and `group` (a nested set). One declaration serves
the YAML loader, the ROS parameter descriptors and the documentation.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
import dataclasses
import logging
import math
import re
import typing
from typing import Any, ClassVar, TypeVar

import numpy as np

from lunar_rover_sim.base.errors import (brief, ConfigError, did_you_mean, full_names, INT64,
                                         nearest, offered)

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


log = logging.getLogger(__name__)

T = TypeVar('T', bound='Parameters')
D = TypeVar('D')

_SCALARS = {'bool': bool, 'int': int, 'float': float, 'str': str}
_ARRAYS = {'tuple[float, ...]': float, 'tuple[int, ...]': int, 'tuple[str, ...]': str}
_HINTS: dict[type, dict[str, Any]] = {}     # types of the fields of each class


@dataclasses.dataclass(frozen=True)
class ParamInfo:
    """The declaration of one parameter: meaning, unit, valid range or choices.

    `low` and `high` are inclusive unless `open_low`, `open_high`; for lists they bound every
    element and `length` bounds their number. `live` parameters may change while a node runs.
    A run sets those that are `by_run`, no user.
    """

    doc: str
    unit: str = ''
    low: float | None = None
    high: float | None = None
    open_low: bool = False
    open_high: bool = False
    choices: tuple[str, ...] = ()
    length: int | None = None
    live: bool = False
    by_run: bool = False

    def valid(self) -> str:
        """Return what is valid, in words: nothing where all values of its type are."""
        parts = []
        if self.length is not None:
            parts.append(f'{self.length} elements')
        if self.choices:
            parts.append('one of ' + ', '.join(self.choices))
        low = f'{"> " if self.open_low else ""}{self.low:g}' if self.low is not None else ''
        high = f'{"< " if self.open_high else ""}{self.high:g}' if self.high is not None else ''
        if low and high:
            parts.append(f'{low} to {high}')
        elif low or high:
            parts.append(low if self.open_low else high if self.open_high
                         else f'>= {low}' if low else f'<= {high}')
        unit = [f'[{self.unit}]'] if self.unit else []
        return ' '.join([', '.join(parts), *unit]).strip()


def param(default: Any, doc: str, **info: Any) -> Any:
    """Declare a field of a parameter set; `info` as in `ParamInfo`."""
    return dataclasses.field(default=default, metadata={'info': ParamInfo(doc, **info)})


def group(cls: type) -> Any:
    """Declare a nested parameter set with its defaults."""
    return dataclasses.field(default_factory=cls)


def named(cls: type, default: Callable[[], Named[Any]] = Named) -> Any:
    """Declare a field `Named[cls]`: sets that a user adds by their names.

    Args:
        default: Makes those without which none are given; where any are given, they are all.
    """
    return dataclasses.field(default_factory=default, metadata={'named': cls})


class Parameters:
    """Base of every frozen parameter set; checks each field against its declaration.

    Attributes:
        gone: Parameters of earlier versions that change nothing any more, with their defaults:
            recorded scenarios name them. They are read and left out.
        fixed: Fields of a base class that keep the defaults of this one, and are no parameters
            here.
    """

    gone: ClassVar[Mapping[str, Any]] = {}
    fixed: ClassVar[Container[str]] = ()

    def __post_init__(self) -> None:
        hints = _hints(type(self))
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            if 'info' in field.metadata:
                value = check(field.name, getattr(self, field.name), hints[field.name],
                              field.metadata['info'])
                object.__setattr__(self, field.name, value)
        self.validate()

    def validate(self) -> None:
        """Check conditions between several fields; raise ConfigError."""

    @classmethod
    def from_mapping(cls: type[T], mapping: Mapping[str, Any], where: str = '') -> T:
        """Build the set from nested plain values; `where` prefixes names in errors.

        Keys may be dotted (`imu.rate_hz`), as ROS 2 writes them.

        Raises:
            ConfigError: For an unknown name (with the nearest valid ones), a wrong type or a value
                out of range.
        """
        if not isinstance(mapping, Mapping):
            raise ConfigError(f'{where or cls.__name__}: {brief(mapping)} is not a mapping of '
                              'parameter names to values')
        fields = {f.name: f for f in dataclasses.fields(cls)  # type: ignore[arg-type]
                  if f.name not in cls.fixed}
        hints = _hints(cls)
        values: dict[str, Any] = {}
        for key, value in nest(mapping, where).items():
            name = f'{where}.{key}' if where else key
            if key in cls.gone or key in cls.fixed:
                if not _is(value, cls.gone[key] if key in cls.gone else getattr(cls(), key)):
                    log.warning('%s: there is no such parameter any more; %s is ignored',
                                _shown(name), brief(value))
                continue
            if key not in fields:
                raise ConfigError(f'{_shown(name)}: no such parameter; '
                                  + _offered(cls, key, fields, where))
            if 'info' in fields[key].metadata:
                values[key] = check(name, value, hints[key], fields[key].metadata['info'])
            elif 'named' in fields[key].metadata:
                values[key] = _named_sets(fields[key].metadata['named'], value, name)
            else:
                values[key] = hints[key].from_mapping(value, name)
        try:
            return cls(**values)
        except ConfigError as error:
            raise ConfigError(f'{where}.{error}' if where else str(error)) from None

    def to_mapping(self) -> dict[str, Any]:
        """Return nested plain values (lists for tuples), the inverse of `from_mapping`."""
        result: dict[str, Any] = {}
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            if field.name in self.fixed:
                continue
            value = getattr(self, field.name)
            if isinstance(value, Named):
                if not value:
                    continue        # ROS 2 has no empty groups
                value = {name: one.to_mapping() for name, one in value.items()}
            result[field.name] = _plain(value)
        return result

    def flatten(self, prefix: str = '',
                documented: bool = False) -> Iterator[tuple[str, Any, ParamInfo, Any]]:
        """Yield (dotted name, value, info, type) of every parameter.

        Args:
            documented: For each `Named` field, yield one set with its defaults, called NAME.
        """
        hints = _hints(type(self))
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if field.name in self.fixed:
                continue
            if isinstance(value, Named):
                sets = {NAME: field.metadata['named']()} if documented else value
                for name, one in sets.items():
                    yield from one.flatten(f'{prefix}{field.name}.{name}.', documented)
            elif isinstance(value, Parameters):
                yield from value.flatten(f'{prefix}{field.name}.', documented)
            else:
                yield prefix + field.name, value, field.metadata['info'], hints[field.name]


def _is(value: Any, kept: Any) -> bool:
    """Return whether a value of a file says what is kept; a set may leave parameters out."""
    if isinstance(kept, Parameters) and isinstance(value, Mapping):
        return type(kept).from_mapping({**kept.to_mapping(), **value}) == kept
    return bool(value == _plain(kept))


def _plain(value: Any) -> Any:
    """Return a value as a file has it."""
    if isinstance(value, Parameters):
        return value.to_mapping()
    return list(value) if isinstance(value, tuple) else value


def _offered(cls: type[Parameters], key: str, fields: Iterable[str], where: str) -> str:
    """Return a phrase that offers what may be meant by the name of no parameter."""
    below = [name for name in full_names(key, (name for name, *_ in cls().flatten('', True)))
             if '.' in name]
    left_out = any(name.endswith(f'.{key}') for name in below)      # a group
    if below and (left_out or not did_you_mean(key, fields)):
        return offered(f'{where}.{name}' if where else name for name in below)
    return nearest(key, fields)


def _named_sets(cls: type[T], value: Any, where: str) -> Named[T]:
    """Return parameter sets by their names; `where` prefixes names in errors."""
    if not isinstance(value, Mapping):
        raise ConfigError(f'{where}: {brief(value)} is not a mapping of names to parameters')
    return Named({name: cls.from_mapping(one, f'{where}.{checked_name(name, where)}')
                  for name, one in nest(value, where).items()})


def nest(mapping: Mapping[str, Any], where: str = '') -> dict[str, Any]:
    """Return the mapping with dotted keys turned into nested mappings.

    Args:
        where: Prefix of names in errors.

    Raises:
        ConfigError: If a key is not text, or if a parameter is given twice: nested and dotted.
    """
    result: dict[str, Any] = {}
    for key, value in mapping.items():
        if not isinstance(key, str):
            raise ConfigError(f'{where + "." if where else ""}{brief(key)}: a parameter name is '
                              'text')
        head, _, tail = key.partition('.')
        _add(result, head, {tail: value} if tail else value, where)
    return result


def _add(nested: dict[str, Any], key: str, value: Any, where: str) -> None:
    """Add a value, or the values of a mapping; raise ConfigError if a parameter is there."""
    name = f'{where}.{key}' if where else key
    if key not in nested:
        nested[key] = value
    elif isinstance(value, Mapping) and isinstance(nested[key], Mapping):
        nested[key] = nest(nested[key], name)
        for part, part_value in nest(value, name).items():
            _add(nested[key], part, part_value, name)
    else:
        raise ConfigError(f'{_shown(name)}: is given twice')


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with its values replaced by those of `over`, mapping by mapping."""
    result = dict(base)
    for key, value in over.items():
        if isinstance(value, Mapping) and isinstance(result.get(key), Mapping):
            result[key] = merge(result[key], value)
        else:
            result[key] = value
    return result


def replaced(config: D, values: Mapping[str, Any]) -> D:
    """Return a dataclass with some values replaced, which dotted names may seek in nested ones."""
    changes = {name: value for name, value in values.items() if '.' not in name}
    nested: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        head, dot, rest = name.partition('.')
        if dot:
            nested.setdefault(head, {})[rest] = value
    for head, parts in nested.items():
        changes[head] = replaced(getattr(config, head), parts)
    return dataclasses.replace(config, **changes)   # type: ignore[type-var]


def check(name: str, value: Any, kind: Any, info: ParamInfo) -> Any:
    """Return `value` in its declared type, or raise ConfigError that names `name` and the bound.

    A whole number is accepted where a float is declared, and NumPy's numbers and arrays where
    those of Python are; nothing else is converted.
    """
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.tolist()
    kind_name = _kind_name(kind)
    if kind_name in _ARRAYS:
        if isinstance(value, (str, bytes)) or not isinstance(value, Sequence):
            raise ConfigError(f'{name}: {brief(value)} is not a list')
        items = tuple(_scalar(name, item, _ARRAYS[kind_name]) for item in value)
        if info.length is not None and len(items) != info.length:
            raise ConfigError(f'{name}: {len(items)} elements given; valid is {info.valid()}')
        for item in items:
            _bound(name, item, info)
        return items
    if info.choices and not isinstance(value, str):
        raise ConfigError(f'{name}: {brief(value)} is not valid; valid is {info.valid()}')
    value = _scalar(name, value, _SCALARS[kind_name])
    _bound(name, value, info)
    return value


def _scalar(name: str, value: Any, kind: type) -> Any:
    if isinstance(value, int) and not -INT64 <= value < INT64:
        raise ConfigError(f'{name}: {brief(value)} is not valid; valid are 64 bits')
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        words = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'text'}
        raise ConfigError(f'{name}: {brief(value)} is not {words[kind]}')
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f'{name}: {value!r} is not a finite number')
    return value


def _bound(name: str, value: Any, info: ParamInfo) -> None:
    if info.choices and value not in info.choices:
        # What is near to the only one may be a name that is valid elsewhere.
        hint = (nearest(value, info.choices) if len(info.choices) > 1
                else f'valid is {info.choices[0]}')
        raise ConfigError(f'{name}: {brief(value)} is not valid; {hint}')
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        too_low = info.low is not None and (value < info.low
                                            or (info.open_low and value == info.low))
        too_high = info.high is not None and (value > info.high
                                              or (info.open_high and value == info.high))
        if too_low or too_high:
            raise ConfigError(f'{name}: {value} is not valid; valid is {info.valid()}')


def _shown(name: str) -> str:
    return name if name.isprintable() and len(name) <= 120 else brief(name)


def _hints(cls: type) -> dict[str, Any]:
    if cls not in _HINTS:
        _HINTS[cls] = typing.get_type_hints(cls)
    return _HINTS[cls]


def _kind_name(kind: Any) -> str:
    return kind.__name__ if isinstance(kind, type) and not typing.get_args(kind) else str(kind)
