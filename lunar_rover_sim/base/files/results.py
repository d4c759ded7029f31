"""Results in files: tables in Markdown and CSV, JSON, and figures of Matplotlib."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import csv
import io
import json
import math
from pathlib import Path
from typing import Any, TYPE_CHECKING

from lunar_rover_sim.base.errors import LunarRoverSimError
from lunar_rover_sim.base.files.atomic import atomic_write

if TYPE_CHECKING:   # it takes time to import
    from matplotlib.figure import Figure


def markdown_table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table in Markdown; a `|` within a cell is escaped."""
    return ['| ' + ' | '.join(cell.replace('|', r'\|') for cell in row) + ' |'
            for row in (titles, ['---'] * len(titles), *rows)]


def csv_table(titles: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV; None is an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(titles)
    writer.writerows(rows)
    return text.getvalue()


def plain(value: Any) -> Any:
    """Return plain values with None for the numbers that JSON lacks: NaN and infinity."""
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def json_text(value: Any) -> str:
    """Return plain values as JSON, None for the numbers that it lacks."""
    return json.dumps(plain(value), indent=2, ensure_ascii=False)


def save_figure(figure: Figure, path: str | Path, error: type[LunarRoverSimError],
                dpi: float = 110, kind: str = 'png') -> None:
    """Write a figure, whole or not at all, and make its folder; kind: a format of Matplotlib.

    Raises `error` if the file cannot be written.
    """
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise error(f'{path}: cannot be written: {problem.strerror}') from None
    atomic_write(path, lambda stream: figure.savefig(stream, dpi=dpi, format=kind), error)
