"""Parameters and named values of all rooms: defaults, units, bounds, choices, presets."""

from __future__ import annotations

import ast
from collections.abc import Iterator
import dataclasses
import functools
import importlib
import inspect
import pkgutil
from types import ModuleType
from typing import Any

import numpy as np
from references.cases import register, ROOMS

from lunar_rover_sim.parameters import Parameters

_ROOMS = ('bag', 'camera', 'evaluation', 'gait', 'illumination', 'physics', 'regolith', 'rover',
          'sensors', 'stereo', 'world')


def _modules(room: str) -> Iterator[ModuleType]:
    package = importlib.import_module(f'lunar_rover_sim.{room}')
    for info in pkgutil.iter_modules(package.__path__, package.__name__ + '.'):
        yield importlib.import_module(info.name)


def _declared(kind: type[Parameters]) -> dict[str, Any]:
    """Return what is declared of each field of a parameter set; its words are left out."""
    result: dict[str, Any] = {}
    for field in dataclasses.fields(kind):
        info = field.metadata.get('info')
        if info is None:
            if field.default_factory is not dataclasses.MISSING:
                result[field.name] = field.default_factory.__name__
            continue
        values = {name: getattr(info, name) for name in (
            'unit', 'low', 'high', 'open_low', 'open_high', 'choices', 'length', 'live')}
        told = [f'{name} {value}' for name, value in values.items()
                if value not in ('', ()) and value is not None and value is not False]
        result[field.name] = ', '.join([f'{field.default!r}', *told])
    return result


def _parameters(room: str) -> dict[str, Any]:
    return {kind.__name__: _declared(kind) for module in _modules(room)
            for kind in vars(module).values()
            if isinstance(kind, type) and issubclass(kind, Parameters)
            and kind.__module__ == module.__name__}


def _has_numbers(value: object) -> bool:
    if isinstance(value, (tuple, list)):
        return any(map(_has_numbers, value))
    if isinstance(value, dict):
        return any(map(_has_numbers, value.values()))
    if dataclasses.is_dataclass(value) and not isinstance(value, (type, Parameters)):
        return any(_has_numbers(getattr(value, f.name)) for f in dataclasses.fields(value))
    return isinstance(value, (int, float, np.ndarray))


def _named_values(room: str) -> dict[str, Any]:
    """Return the numbers that modules name in public, and their tables of presets."""
    result: dict[str, Any] = {}
    for module in _modules(room):
        own = {target.id for node in ast.parse(inspect.getsource(module)).body
               if isinstance(node, (ast.Assign, ast.AnnAssign))
               for whole in (node.targets if isinstance(node, ast.Assign) else [node.target])
               for target in ast.walk(whole) if isinstance(target, ast.Name)}
        for name, value in vars(module).items():
            if name in own and name.isupper() and name[0] != '_' and _has_numbers(value):
                result[f'{module.__name__.rpartition(".")[2]}.{name}'] = value
    return result


for _room in _ROOMS:
    register(f'parameters/sets of {_room}', functools.partial(_parameters, _room))
    if _room in ROOMS:
        register(f'parameters/constants of {_room}', functools.partial(_named_values, _room))
