"""Docstrings of what the reference lists: Google's sections, of things that exist."""

from __future__ import annotations

import importlib
import inspect
import re
from types import FunctionType
from typing import Any

import pytest

import lunar_rover_sim


def public(owner: Any, name: str) -> list[Any]:
    """Return the functions and classes of a class or module that are documented with it."""
    found = []
    for key, value in vars(owner).items():
        value = getattr(value, '__func__', getattr(value, 'fget', value))
        if not key.startswith('_') and isinstance(value, (FunctionType, type)) \
                and value.__module__ == name:
            found += [value, *(public(value, name) if isinstance(value, type) else ())]
    return found


# Modules that export something, whole.
HOMES = sorted({getattr(lunar_rover_sim, name).__module__ for name in lunar_rover_sim.__all__})
OBJECTS = [pytest.param(value, id=f'{name}.{value.__qualname__}') for name in HOMES
           for value in public(importlib.import_module(name), name)]


@pytest.mark.parametrize('value', OBJECTS)
def test_sections(value: Any) -> None:
    """Arguments are those of the signature, errors stand under Raises, nothing in a dialect."""
    text = inspect.cleandoc(value.__doc__ or '')
    prose, *parts = re.split(r'^(Args|Returns|Yields|Attributes|Raises):\n', text, flags=re.M)
    sections = dict(zip(parts[::2], parts[1::2]))
    names = set(inspect.signature(value).parameters) if value.__doc__ else set()
    described = set(re.findall(r'^    (\w+):', sections.get('Args', ''), re.M))
    assert described <= names
    assert not re.search(r'\bRaises [A-Z]\w+Error', prose)
    assert not [name for name in names if re.search(rf'^{name}(, \w+)*: ', prose, re.M)]
    # Markup by accident: substitutions of reStructuredText.
    assert not re.search(r'\|\S[^|\n]*\S\|', re.sub(r'`[^`]*`', '', text))
