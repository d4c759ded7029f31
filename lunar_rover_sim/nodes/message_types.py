"""Message classes by their ROS 2 type names."""

from __future__ import annotations

import importlib
import re
from typing import Any

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.nodes.tf_type import tf_message_class


def message_class(type_name: str) -> Any:
    """Return the class of `package/msg/Name`; raise GraphError where it is not installed."""
    package, _, name = type_name.replace('/msg/', '/').partition('/')
    try:
        return getattr(importlib.import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        if f'{package}/msg/{name}' == topics.TF.type:
            return tf_message_class()
        raise GraphError(f'{type_name}: no such message type is installed; install the package '
                         f'{package}') from None


def name_of(cls: Any) -> str:
    """Return the `package/msg/Name` of a message class."""
    return f'{cls.__module__.partition(".")[0]}/msg/{cls.__name__}'


_NAMES = {'boolean': 'bool', 'double': 'float64', 'float': 'float32', 'octet': 'byte'}
_RULE = '=' * 80
_SEQUENCE = re.compile(r'sequence<(.+?)(?:, (\d+))?>')
_ARRAY = re.compile(r'(.+)\[(\d+)\]')
_STRING = re.compile(r'(w?string)<(\d+)>')


def definition_of(type_name: str) -> str:
    """Return the definition of `package/msg/Name`, and of the types that it uses, as MCAP has it.

    Raises:
        GraphError: Where one of them is not installed.
    """
    parts: dict[str, str] = {}
    waiting = [type_name.replace('/msg/', '/')]
    while waiting:
        name = waiting.pop(0)
        if name in parts:
            continue
        lines = []
        for field, kind in _fields(message_class(name)).items():
            text, element = _written(kind)
            lines.append(f'{text} {field}')
            if '/' in element:
                waiting.append(element)
        parts[name] = '\n'.join(lines) + '\n'
    first, *rest = parts.items()
    return first[1] + ''.join(f'{_RULE}\nMSG: {name}\n{text}' for name, text in rest)


def _fields(cls: Any) -> dict[str, str]:
    fields: dict[str, str] = cls.get_fields_and_field_types()
    return fields


def _written(kind: str) -> tuple[str, str]:
    """Return a type of rclpy as `.msg` files have it, and the type of its elements."""
    if match := _SEQUENCE.fullmatch(kind):
        text, element = _written(match[1])
        return text + (f'[<={match[2]}]' if match[2] else '[]'), element
    if match := _ARRAY.fullmatch(kind):
        text, element = _written(match[1])
        return f'{text}[{match[2]}]', element
    if match := _STRING.fullmatch(kind):
        return f'{match[1]}<={match[2]}', match[1]
    name = _NAMES.get(kind, kind)
    return name, name
