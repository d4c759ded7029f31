"""Figures of Matplotlib in files."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from lunar_rover_sim.errors import LunarRoverSimError
from lunar_rover_sim.files.atomic import atomic_write


def save_figure(figure: Figure, path: str | Path, error: type[LunarRoverSimError],
                dpi: float = 110, kind: str = 'png') -> None:
    """Write a figure, whole or not at all; kind: a format of Matplotlib.

    Raises `error` if the file cannot be written.
    """
    atomic_write(path, lambda stream: figure.savefig(stream, dpi=dpi, format=kind), error)
