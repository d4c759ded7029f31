"""Figures of Matplotlib in files."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from lunar_rover_sim.errors import LunarRoverSimError
from lunar_rover_sim.files.atomic import atomic_write


def save_figure(figure: Figure, path: str | Path, error: type[LunarRoverSimError],
                dpi: float = 110, kind: str = 'png') -> None:
    """Write a figure, whole or not at all, and make its folder; kind: a format of Matplotlib.

    Raises `error` if the file cannot be written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as reason:
        raise error(f'{path}: cannot be written: {reason.strerror}') from None
    atomic_write(path, lambda stream: figure.savefig(stream, dpi=dpi, format=kind), error)
