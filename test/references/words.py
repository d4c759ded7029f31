"""What is refused, and in which words."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from lunar_rover_sim.errors import LunarRoverSimError


def said(call: Callable[..., Any], *arguments: Any, without: Path | None = None,
         **options: Any) -> str:
    """Return the text of the error that a call raises, '' if none; without: a path."""
    try:
        call(*arguments, **options)
    except LunarRoverSimError as error:
        return str(error) if without is None else str(error).replace(str(without), 'FOLDER')
    return ''
