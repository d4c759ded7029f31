"""Message classes by their ROS 2 type names."""

from __future__ import annotations

import importlib
from typing import Any

from lunar_rover_sim.errors import GraphError


def message_class(type_name: str) -> Any:
    """Return the class of `package/msg/Name`; raise GraphError where it is not installed."""
    package, _, name = type_name.replace('/msg/', '/').partition('/')
    try:
        return getattr(importlib.import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        raise GraphError(f'{type_name}: no such message type is installed; install the package '
                         f'{package}') from None


def name_of(cls: Any) -> str:
    """Return the `package/msg/Name` of a message class."""
    return f'{cls.__module__.partition(".")[0]}/msg/{cls.__name__}'
