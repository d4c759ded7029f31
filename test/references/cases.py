"""All reference results: a function for each, by room."""

from __future__ import annotations

from collections.abc import Callable
import importlib
import inspect
import json
from pathlib import Path
from typing import Any

from references.summary import summarised

FOLDER = Path(__file__).resolve().parent
ROOMS = ('world', 'regolith', 'physics', 'gait', 'illumination', 'camera', 'stereo', 'evaluation',
         'bag', 'parameters')

_cases: dict[str, Callable[..., dict[str, Any]]] = {}


def reference(function: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
    """Register a case; it may take an empty folder. It returns names and results."""
    room = function.__module__.rpartition('.')[2].partition('_')[0]
    register(f'{room}/{function.__name__}', function)
    return function


def register(case: str, function: Callable[..., dict[str, Any]]) -> None:
    """Register a function as the case of a name."""
    _cases[case] = function


def all_cases() -> dict[str, Callable[..., dict[str, Any]]]:
    """Return the cases by `room/name`."""
    for path in sorted(FOLDER.glob('*.py')):
        if path.stem.partition('_')[0] in ROOMS:
            importlib.import_module(f'references.{path.stem}')
    return dict(_cases)


def found(case: str, folder: Path) -> Any:
    """Return what a case gives now, as it is stored; folder: an empty one."""
    function = _cases[case]
    arguments = [folder] if inspect.signature(function).parameters else []
    return json.loads(json.dumps(summarised(function(*arguments))))


def stored(room: str) -> dict[str, Any]:
    """Return the stored results of a room by the name of the case."""
    path = FOLDER / 'stored' / f'{room}.json'
    return dict(json.loads(path.read_text(encoding='utf-8'))) if path.is_file() else {}
