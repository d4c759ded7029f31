"""The report of a benchmark: one HTML file with everything in it."""

from __future__ import annotations

from collections.abc import Sequence
import io
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.files.templates import data_uri, template
from lunar_rover_sim.slam.benchmark import Cell, cell_folder
from lunar_rover_sim.slam.table import is_success, Paper, Row, row_of, text_cells

_MEASURES = {'ate_percent': 'ATE [% of distance]', 'scale': 'scale', 'tracked': 'tracked [%]'}


def html_report(title: str, statement: Sequence[str], rows: Sequence[Row], cells: Sequence[Cell],
                findings: Sequence[str], folder: Path, parameter: str = '',
                paper: Paper | None = None) -> str:
    """Return the report as HTML.

    statement, findings: sentences about the drives and what they show
    folder: that of the benchmark; the paths are read from the folders of its cells
    parameter: what a sweep changes
    """
    columns, lines = text_cells(rows, paper or {}, parameter)
    errors = _curves(rows, cells, parameter) if parameter else _bars(rows, cells)
    return template('lunar_rover_sim.slam', 'benchmark.html').render(
        title=title, statement=statement, columns=columns, rows=lines,
        findings=findings, failures=[f'{" ".join(filter(None, row.key))}, {reason}'
                                     for row in rows for reason in row.reasons],
        errors_png=_png(errors), paths_png=_png(_paths(rows, cells, folder)))


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), layout='constrained')


def _bars(rows: Sequence[Row], cells: Sequence[Cell]) -> Figure:
    figure = _figure(12.0, 4.0)
    labels = [f'{r.scenario}\n{r.sensor}' for r in rows]
    for axis, (name, title) in zip(figure.subplots(1, 3), _MEASURES.items()):
        _draw_values(axis, range(len(rows)), rows, cells, name, 'o')
        axis.set_xticks(range(len(rows)), labels, rotation=60, ha='right', fontsize=7)
        _scale_axis(axis, title)
    return figure


def _curves(rows: Sequence[Row], cells: Sequence[Cell], parameter: str) -> Figure:
    figure = _figure(12.0, 4.0)
    values = list(dict.fromkeys(r.value for r in rows))
    try:
        places = {v: float(v) for v in values}
    except ValueError:
        places = {v: float(k) for k, v in enumerate(values)}
    for axis, (name, title) in zip(figure.subplots(1, 3), _MEASURES.items()):
        for scenario, sensor in dict.fromkeys((r.scenario, r.sensor) for r in rows):
            chosen = [r for r in rows if (r.scenario, r.sensor) == (scenario, sensor)]
            _draw_values(axis, [places[r.value] for r in chosen], chosen, cells, name, 'o-',
                         f'{scenario} {sensor}')
        axis.set_xticks(list(places.values()), list(places))
        axis.set_xlabel(parameter)
        _scale_axis(axis, title)
    axis.legend(fontsize=8)
    return figure


def _draw_values(axis: Axes, places: Sequence[float], rows: Sequence[Row], cells: Sequence[Cell],
                 name: str, style: str, label: str = '') -> None:
    """Draw medians with their intervals, every success as a cross, every failure as a circle."""
    medians = [getattr(row, name) for row in rows]
    middle = np.array([m.value for m in medians])
    reach = np.nan_to_num([[m.value - m.low, m.high - m.value] for m in medians])
    drawn = axis.errorbar(places, middle, yerr=reach.T, fmt=style, capsize=4, label=label)
    colour = drawn.lines[0].get_color()
    for place, row in zip(places, rows):
        own = [c for c in cells if c.result is not None and row_of(c) == row.key]
        for good, marker in ((True, 'x'), (False, 'o')):
            of_drives = [100.0 * c.result.tracked_share if name == 'tracked'
                         else getattr(c.result, name)
                         for c in own if c.result is not None and is_success(c) == good]
            axis.plot(np.full(len(of_drives), place), of_drives, marker, color=colour, alpha=0.6,
                      markerfacecolor='none')


def _scale_axis(axis: Axes, title: str) -> None:
    axis.set_title(f'{title}: median, 95 %, drives (o: failed)', fontsize=10)
    axis.grid(alpha=0.3)


def _paths(rows: Sequence[Row], cells: Sequence[Cell], folder: Path) -> Figure:
    columns = min(3, max(1, len(rows)))
    lines = max(1, -(-len(rows) // columns))
    figure = _figure(4.2 * columns, 3.8 * lines)
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    for axis in axes[len(rows):]:
        axis.set_axis_off()
    for axis, row in zip(axes, rows):
        for cell in cells:
            if row_of(cell) != row.key:
                continue
            path = cell_folder(folder, cell) / 'path.npz'
            if not path.exists():
                continue
            with np.load(path) as data:
                axis.plot(*data['truth_m'][:, :2].T, 'k', lw=1.0)
                axis.plot(*data['estimate_m'][:, :2].T, lw=1.0, label=f'seed {cell.drive.seed}')
        axis.set_aspect('equal', adjustable='datalim')
        axis.set_title(' '.join(filter(None, (row.scenario, row.value, row.sensor))), fontsize=9)
        axis.set(xlabel='x [m]', ylabel='y [m]')
        axis.grid(alpha=0.3)
        if axis.get_legend_handles_labels()[1]:
            axis.legend(fontsize=7)
    return figure


def _png(figure: Figure) -> str:
    data = io.BytesIO()
    figure.savefig(data, format='png', dpi=100)
    return data_uri(data.getvalue(), 'image/png')
