"""The state of something that runs, as a file: values and arrays, bit for bit, and no code.

A state is a tree: numbers, texts, bytes, arrays and generators of NumPy, lists, tuples, sets,
queues, dictionaries, and objects of this package by their attributes. Two places that hold one
object hold one object again when the state is read.

The file is a NumPy .npz: `tree` is JSON, the other entries are the arrays. NumPy's own objects,
which are pickled, are neither written nor read.
"""

from __future__ import annotations

import base64
from collections import deque
from collections.abc import Mapping
import enum
import importlib
import json
from pathlib import Path
from typing import Any, cast
import zipfile

import numpy as np

from lunar_rover_sim.base.errors import ConfigError, one_line
from lunar_rover_sim.base.files.atomic import atomic_write

_PACKAGE = 'lunar_rover_sim.'
_FORMAT = 2     # grows with every change of what states hold
_SEQUENCES: dict[str, type] = {'list': list, 'tuple': tuple, 'set': set, 'frozenset': frozenset}


def attributes(thing: object, *names: str) -> dict[str, Any]:
    """Return attributes of an object by name: its state, or a part of it."""
    return {name: getattr(thing, name) for name in names}


def attributes_but(thing: object, *names: str) -> dict[str, Any]:
    """Return the attributes of an object but these, which it is made with."""
    return {name: value for name, value in vars(thing).items() if name not in names}


def restore_attributes(thing: object, state: Mapping[str, Any]) -> None:
    """Set attributes as `attributes` has returned them.

    A queue stays the same object, since others may hold it, with other content.

    Raises:
        ConfigError: If the object has no such attribute.
    """
    for name, value in state.items():
        try:
            own = getattr(thing, name)
        except AttributeError:
            raise ConfigError(f'state of {type(thing).__name__}: {name} is not valid; valid is a '
                              'state of the same version') from None
        if isinstance(own, deque):
            own.clear()
            own.extend(value)
        else:
            setattr(thing, name, value)


def save_state(path: Path, state: Any) -> None:
    """Write a state to a file, which is there whole or not at all.

    Raises:
        ConfigError: If it cannot be written.
        TypeError: If the state holds what no file can, such as a function.
    """
    writer = _Writer()
    root = writer.reference(state)
    text = json.dumps({'format': _FORMAT, 'objects': writer.objects, 'root': root})
    tree = np.frombuffer(text.encode(), np.uint8)
    # Plans over far maps are large, and mostly one value.
    atomic_write(path, lambda file: np.savez_compressed(file, tree=tree, **writer.arrays),
                 ConfigError)


def load_state(path: Path) -> Any:
    """Return the state in a file.

    Raises:
        ConfigError: If it cannot be read, or another version has written it.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            tree = json.loads(file['tree'].tobytes())
            told = tree['format']
            if told == _FORMAT:
                return _read(tree['objects'], tree['root'],
                             {name: file[name] for name in file.files if name != 'tree'})
    except (OSError, zipfile.BadZipFile, ValueError, LookupError, TypeError, AttributeError,
            ImportError, EOFError) as error:
        raise ConfigError(f'{path}: is no state that can be read: {one_line(error)}') from None
    raise ConfigError(f'{path}: format {told} is not valid; valid is {_FORMAT}, that of this '
                      'version')


class _Writer:
    """Turns a state into JSON and arrays.

    A reference is the value itself where it is a plain one, and otherwise [number] of an object.

    Attributes:
        objects: Kind and content of each object; it refers only to those before it.
        arrays: By the names in the file.
    """

    def __init__(self) -> None:
        self.objects: list[tuple[str, Any]] = []
        self.arrays: dict[str, Any] = {}
        self._numbers: dict[int, int] = {}      # by identity, of what `_held` keeps alive
        self._held: list[object] = []

    def reference(self, value: Any) -> Any:
        """Return what stands for a value in JSON."""
        if value is None or type(value) in (bool, int, float, str):
            return value
        number = self._numbers.get(id(value))
        if number is None:
            content = self._content(value)
            number = self._numbers[id(value)] = len(self.objects)
            self.objects.append(content)
            self._held.append(value)
        return [number]

    def _content(self, value: Any) -> tuple[str, Any]:
        of_package = type(value).__module__.startswith(_PACKAGE)
        name = f'{type(value).__module__}:{type(value).__qualname__}'
        if isinstance(value, enum.Enum) and of_package:
            return 'enum', [name, value.name]
        if isinstance(value, (np.ndarray, np.generic)) and not value.dtype.hasobject:
            key = f'a{len(self.arrays)}'
            self.arrays[key] = np.asarray(value)
            return 'array' if isinstance(value, np.ndarray) else 'number', key
        if isinstance(value, np.random.Generator):
            return 'generator', value.bit_generator.state
        if isinstance(value, bytes):
            return 'bytes', base64.b64encode(value).decode()
        if type(value) is dict:
            return 'dict', [[self.reference(key), self.reference(item)]
                            for key, item in value.items()]
        if type(value) is deque:
            return 'deque', [value.maxlen, *map(self.reference, value)]
        if type(value).__name__ in _SEQUENCES and type(value) in _SEQUENCES.values():
            return type(value).__name__, [self.reference(item) for item in value]
        if of_package and isinstance(value, tuple):
            return 'record', [name, *map(self.reference, value)]
        if of_package and hasattr(value, '__dict__'):
            return 'object', [name, {key: self.reference(item)
                                     for key, item in vars(value).items()}]
        raise TypeError(f'{type(value)} cannot be a part of a state')


def _read(contents: list[Any], root: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    objects: list[Any] = []

    def of(reference: Any) -> Any:
        return objects[reference[0]] if isinstance(reference, list) else reference

    for kind, content in contents:
        value: Any
        if kind == 'enum':
            value = _class(content[0])[content[1]]
        elif kind in ('array', 'number'):
            value = arrays[content] if kind == 'array' else arrays[content][()]
        elif kind == 'generator':
            value = np.random.Generator(getattr(np.random, content['bit_generator'])())
            value.bit_generator.state = content
        elif kind == 'bytes':
            value = base64.b64decode(content)
        elif kind == 'dict':
            value = {of(key): of(item) for key, item in content}
        elif kind == 'deque':
            value = deque(map(of, content[1:]), maxlen=content[0])
        elif kind == 'record':
            value = _class(content[0])._make(map(of, content[1:]))
        elif kind == 'object':
            value = object.__new__(_class(content[0]))
            vars(value).update((name, of(item)) for name, item in content[1].items())
        else:
            value = _SEQUENCES[kind](map(of, content))
        objects.append(value)
    return of(root)


def _class(name: str) -> Any:
    """Return a class of this package by the name of its module and its own."""
    module, _, own = name.partition(':')
    if not module.startswith(_PACKAGE):
        raise ValueError(f'{module} is no module of {_PACKAGE[:-1]}')
    found = getattr(importlib.import_module(module), own)
    if not isinstance(found, type):
        raise ValueError(f'{name} is no class')
    return cast(Any, found)
