"""The report of a benchmark: one HTML file with everything in it."""

from __future__ import annotations

import base64
from collections.abc import Sequence
import html
import io
from pathlib import Path
from typing import Any

import numpy as np

from lunar_rover_sim.slam.benchmark import Cell, cell_folder
from lunar_rover_sim.slam.table import findings, Paper, Row, row_of, text_cells

_STYLE = ('body{font:15px/1.5 sans-serif;max-width:75em;margin:2em auto;padding:0 1em}'
          'table{border-collapse:collapse}td,th{padding:.25em .7em;border-bottom:1px solid #ccc;'
          'text-align:right}td:first-child,th:first-child{text-align:left}img{max-width:100%}')

_MEASURES = {'ate_percent': 'ATE [% of distance]', 'scale': 'scale', 'tracked': 'tracked [%]'}


def html_report(title: str, statement: Sequence[str], rows: Sequence[Row], cells: Sequence[Cell],
                folder: Path, parameter: str = '', paper: Paper | None = None) -> str:
    """Return the report; statement: what is to be known of the drives, in sentences.

    The paths are read from the cells' folders below `folder`.
    """
    parts = [f'<!DOCTYPE html><html lang="en"><meta charset="utf-8"><title>{_safe(title)}</title>'
             f'<style>{_STYLE}</style><h1>{_safe(title)}</h1>',
             *(f'<p>{_safe(line)}</p>' for line in statement), _table(rows, paper, parameter)]
    said = findings(rows, parameter)
    if said:
        parts.append('<ul>' + ''.join(f'<li>{_safe(line)}</li>' for line in said) + '</ul>')
    wrong = [f'{c.name}: {c.result.reason}' for c in cells if c.result and c.result.reason]
    if wrong:
        parts.append('<h2>What went wrong</h2><ul>'
                     + ''.join(f'<li>{_safe(line)}</li>' for line in wrong) + '</ul>')
    errors = _curves(rows, cells, parameter) if parameter else _bars(rows, cells)
    parts += ['<h2>Errors</h2>', _image(errors),
              '<h2>Paths</h2><p>Black: truth; coloured: estimate, aligned.</p>',
              _image(_paths(rows, cells, folder)), '</html>']
    return '\n'.join(parts) + '\n'


def _safe(text: str) -> str:
    return html.escape(text)


def _table(rows: Sequence[Row], paper: Paper | None, parameter: str) -> str:
    titles, lines = text_cells(rows, paper or {}, parameter)
    cells = [''.join(f'<th>{_safe(t)}</th>' for t in titles),
             *(''.join(f'<td>{_safe(v)}</td>' for v in line) for line in lines)]
    return '<table>' + ''.join(f'<tr>{line}</tr>' for line in cells) + '</table>'


def _figure(width: float, height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout='constrained')


def _bars(rows: Sequence[Row], cells: Sequence[Cell]) -> Any:
    figure = _figure(12.0, 4.0)
    labels = [f'{r.scenario}\n{r.sensor}' for r in rows]
    for axis, (name, title) in zip(figure.subplots(1, 3), _MEASURES.items()):
        _spread(axis, range(len(rows)), rows, cells, name, 'o')
        axis.set_xticks(range(len(rows)), labels, rotation=60, ha='right', fontsize=7)
        _finish(axis, title)
    return figure


def _curves(rows: Sequence[Row], cells: Sequence[Cell], parameter: str) -> Any:
    figure = _figure(12.0, 4.0)
    values = list(dict.fromkeys(r.value for r in rows))
    try:
        places = {v: float(v) for v in values}
    except ValueError:
        places = {v: float(k) for k, v in enumerate(values)}
    for axis, (name, title) in zip(figure.subplots(1, 3), _MEASURES.items()):
        for scenario, sensor in dict.fromkeys((r.scenario, r.sensor) for r in rows):
            chosen = [r for r in rows if (r.scenario, r.sensor) == (scenario, sensor)]
            _spread(axis, [places[r.value] for r in chosen], chosen, cells, name, 'o-',
                    f'{scenario} {sensor}')
        axis.set_xticks(list(places.values()), list(places))
        axis.set_xlabel(parameter)
        _finish(axis, title)
    axis.legend(fontsize=8)
    return figure


def _spread(axis: Any, places: Sequence[float], rows: Sequence[Row], cells: Sequence[Cell],
            name: str, style: str, label: str = '') -> None:
    """Draw means with their intervals, and every drive as a point."""
    means = [getattr(row, name) for row in rows]
    drawn = axis.errorbar(places, [m.value for m in means],
                          yerr=np.nan_to_num([m.half_width for m in means]), fmt=style, capsize=4,
                          label=label)
    colour = drawn.lines[0].get_color()
    for place, row in zip(places, rows):
        results = [c.result for c in cells if c.result is not None and row_of(c) == row.key]
        of_drives = np.array([100.0 * r.tracked_share if name == 'tracked' else getattr(r, name)
                              for r in results])
        axis.plot(np.full(len(results), place), of_drives, 'x', color=colour, alpha=0.6)


def _finish(axis: Any, title: str) -> None:
    axis.set_title(f'{title}: mean, 95 %, drives', fontsize=10)
    axis.grid(alpha=0.3)
    # The axes hold what was measured; the interval of two drives may go far beyond.
    points = np.concatenate([line.get_ydata() for line in axis.lines if line.get_marker() == 'x'])
    points = points[np.isfinite(points)]
    if len(points):
        margin = 0.15 * max(float(np.ptp(points)), 0.02 * float(np.abs(points).max()), 1e-6)
        axis.set_ylim(points.min() - margin, points.max() + margin)


def _paths(rows: Sequence[Row], cells: Sequence[Cell], folder: Path) -> Any:
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


def _image(figure: Any) -> str:
    data = io.BytesIO()
    figure.savefig(data, format='png', dpi=100)
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(data.getvalue()).decode()}">'
