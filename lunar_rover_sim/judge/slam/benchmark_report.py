"""The files that a benchmark leaves: table as Markdown, CSV and LaTeX, every drive, and a page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
import io
from pathlib import Path

import jinja2
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
import numpy as np

from lunar_rover_sim.base.errors import ConfigError, SlamError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.slam import table
from lunar_rover_sim.judge.slam.drives import csv_of_drives, Judged, text_of_seeds
from lunar_rover_sim.judge.slam.table import is_success, Paper, row_of, TableRow, text_cells

_MEASURES = {'ate_percent': 'ATE [% of distance]', 'scale': 'scale', 'tracked': 'tracked [%]'}


def html_report(title: str, statement: Sequence[str], rows: Sequence[TableRow],
                judged: Sequence[Judged], findings: Sequence[str], parameter: str = '',
                paper: Paper | None = None) -> str:
    """Return the report as HTML.

    Args:
        statement, findings: Sentences about the drives, and about the steps of a sweep.
        parameter: What a sweep changes.
    """
    columns, lines = text_cells(rows, paper or {}, parameter)
    errors = curves(rows, judged, parameter) if parameter else _bars(rows, judged)
    # What is inserted is escaped; a value that is missing is an error, not an empty text.
    pages = jinja2.Environment(
        loader=jinja2.PackageLoader('lunar_rover_sim.judge.slam'), autoescape=True,
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return pages.get_template('benchmark.html').render(
        title=title, statement=statement, columns=columns, rows=lines,
        findings=findings, failures=[f'{" ".join(filter(None, row.key))}, {reason}'
                                     for row in rows for reason in row.reasons],
        **{name: f'data:image/png;base64,{base64.b64encode(png(figure)).decode("ascii")}'
           for name, figure in (('errors_png', errors), ('paths_png', _paths(rows, judged)))})


def _bars(rows: Sequence[TableRow], judged: Sequence[Judged]) -> Figure:
    figure = Figure(figsize=(12.0, 4.0), layout='constrained')
    several = len({row.system for row in rows}) > 1
    labels = ['\n'.join([r.scenario, r.sensor, *([r.system] if several else [])]) for r in rows]
    for axis, (name, title) in zip(figure.subplots(1, 3), _MEASURES.items()):
        _draw_values(axis, rows, judged, name)
        axis.set_xticks(range(len(rows)), labels, rotation=60, ha='right', fontsize=7)
        axis.set_title(f'{title}: median, 95 %, drives (o: failed)', fontsize=10)
        axis.grid(alpha=0.3)
    return figure


def curves(rows: Sequence[TableRow], judged: Sequence[Judged], parameter: str) -> Figure:
    """Return success and error over the values of a sweep, a curve per scenario, sensor, system.

    Whiskers are 95 % intervals: Wilson's of the share of successes, the sign test's of the median
    error. Crosses are drives that succeeded.
    """
    figure = Figure(figsize=(10.0, 4.0), layout='constrained')
    success, error = figure.subplots(1, 2)
    places, axis_title = _places(list(dict.fromkeys(r.value for r in rows)), parameter)
    width = max(places.values()) - min(places.values()) or 1.0
    lines = table.curves_of(rows)
    for k, (line, chosen) in enumerate(lines.items()):
        # Beside each other, so that whiskers of equal height can be told apart.
        at = [places[r.value] + 0.012 * width * (k - 0.5 * (len(lines) - 1)) for r in chosen]
        shares = np.array([[r.success.value, r.success.low, r.success.high] for r in chosen])
        drawn = _whiskers(success, at, 100.0 * shares, 'o-', ', '.join(line))
        errors = np.array([[r.ate_m.value, r.ate_m.low, r.ate_m.high] for r in chosen])
        _whiskers(error, at, 1e3 * errors, 'o-', colour=drawn)
        for place, row in zip(at, chosen):
            own = [1e3 * one.result.ate_m for one in judged
                   if row_of(one) == row.key and is_success(one)]
            error.plot(np.full(len(own), place), own, 'x', color=drawn, alpha=0.5)
    for axis, title in ((success, 'drives that succeed [%]'), (error, 'ATE of these [mm]')):
        axis.set_title(title, fontsize=10)
        axis.set_xticks(list(places.values()), list(places))
        axis.set_xlabel(axis_title)
        axis.grid(alpha=0.3)
    success.set_ylim(-4.0, 104.0)
    if any(r.successes for r in rows):
        error.set_yscale('log')
        error.yaxis.set_major_formatter('{x:g}')
        low, high = error.get_ylim()
        # The powers of ten say enough of a wide range; more labels would not find room.
        error.yaxis.set_minor_formatter('{x:g}' if high < 20.0 * low else NullFormatter())
    error.set_xlim(success.get_xlim())
    success.legend(fontsize=8, loc='best')
    return figure


def _places(values: Sequence[str], parameter: str) -> tuple[dict[str, float], str]:
    """Return where the values of a sweep stand on their axis, and its title."""
    try:
        places = {v: float(v) for v in values}
    except ValueError:
        return {v: float(k) for k, v in enumerate(values)}, parameter
    if 0.0 < 10.0 * min(places.values()) < max(places.values()):
        # On a linear axis the labels of the small ones would not find room.
        return {v: float(np.log10(place)) for v, place in places.items()}, f'{parameter}, log'
    return places, parameter


def _whiskers(axis: Axes, places: Sequence[float], values: Array, style: str, label: str = '',
              colour: str | None = None) -> str:
    """Draw (n, 3) values with their lower and upper ends, where there are any."""
    middle = values[:, 0]
    reach = np.nan_to_num(np.abs(values[:, 1:] - middle[:, None]))
    drawn = axis.errorbar(places, middle, yerr=reach.T, fmt=style, capsize=4, label=label,
                          color=colour)
    return to_hex(drawn.lines[0].get_color())


def _draw_values(axis: Axes, rows: Sequence[TableRow], judged: Sequence[Judged],
                 name: str) -> None:
    """Draw medians with their intervals, every success as a cross, every failure as a circle."""
    medians = [getattr(row, name) for row in rows]
    colour = _whiskers(axis, range(len(rows)),
                       np.array([[m.value, m.low, m.high] for m in medians]), 'o')
    for place, row in enumerate(rows):
        own = [one for one in judged
               if row_of(one) == row.key and not table.tipped_over(one)]
        for good, marker in ((True, 'x'), (False, 'o')):
            of_drives = [100.0 * one.result.tracked_share if name == 'tracked'
                         else getattr(one.result, name)
                         for one in own if is_success(one) == good]
            axis.plot(np.full(len(of_drives), place), of_drives, marker, color=colour, alpha=0.6,
                      markerfacecolor='none')


def _paths(rows: Sequence[TableRow], judged: Sequence[Judged]) -> Figure:
    columns = min(3, max(1, len(rows)))
    lines = max(1, -(-len(rows) // columns))
    figure = Figure(figsize=(4.2 * columns, 3.8 * lines), layout='constrained')
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    several = len({row.system for row in rows}) > 1
    for axis in axes[len(rows):]:
        axis.set_axis_off()
    for axis, row in zip(axes, rows):
        for one in judged:
            path = one.folder / 'path.npz' if one.folder is not None else None
            if row_of(one) != row.key or path is None or not path.exists():
                continue
            with np.load(path) as data:
                axis.plot(*data['truth_m'][:, :2].T, 'k', lw=1.0)
                axis.plot(*data['estimate_m'][:, :2].T, lw=1.0, label=f'seed {one.drive.seed}')
        axis.set_aspect('equal', adjustable='datalim')
        names = (row.scenario, row.value, row.sensor, row.system if several else '')
        axis.set_title(' '.join(filter(None, names)), fontsize=9)
        axis.set(xlabel='x [m]', ylabel='y [m]')
        axis.grid(alpha=0.3)
        if axis.get_legend_handles_labels()[1]:
            axis.legend(fontsize=7)
    return figure


def png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    data = io.BytesIO()
    figure.savefig(data, format='png', dpi=100)
    return data.getvalue()


def write_report(judged: Sequence[Judged], folder: Path, name: str,
                 paper: table.Paper | None = None) -> tuple[str, list[str]]:
    """Write NAME.md, .csv, .tex and .html, NAME_drives.csv, and NAME.png of a sweep.

    Args:
        judged: At least one.
        folder: Must exist.
        paper: Published numbers.

    Returns:
        The table as Markdown; what a sweep shows as sentences, and the files that were written.

    Raises:
        SlamError: If a file cannot be written.
    """
    rows, parameter = table.rows_of(judged), judged[0].drive.parameter
    systems = list(dict.fromkeys(one.result.system for one in judged))
    found = table.steps(rows, judged) if parameter else []
    text, statement = table.markdown(rows, paper, parameter), _statement(judged, systems)
    title = 'Benchmark' + (f' over {parameter}' if parameter else '')
    contents: dict[str, str | bytes] = {
        f'{name}.md': '\n\n'.join([*statement, text, *found]).rstrip() + '\n',
        f'{name}.csv': table.csv_text(rows),
        f'{name}_drives.csv': csv_of_drives(judged),
        f'{name}.tex': table.latex(rows, paper, parameter),
        f'{name}.html': html_report(title, statement, rows, judged, found, parameter, paper)}
    if parameter:
        contents[f'{name}.png'] = png(curves(rows, judged, parameter))
    for file, content in contents.items():
        atomic_write(folder / file, content, SlamError)
    return text, [*found, *(str(folder / file) for file in contents)]


def _statement(judged: Sequence[Judged], systems: Sequence[str]) -> list[str]:
    """Return sentences about the drives and the columns of the table."""
    counts = {row.drives for row in table.rows_of(judged)}
    lasts = {one.drive.duration_s for one in judged if one.drive.duration_s > 0.0}
    parts = [f'{_range(counts)} drives', *([f'of {_range(lasts)} s'] if lasts else []),
             f'per line, seeds {text_of_seeds(one.drive.seed for one in judged)}']
    return [
        ' '.join(parts) + _of_scenarios(judged)
        + f'; {"system" if len(systems) == 1 else "systems"} {", ".join(systems)}.',
        f'A drive is a success if {100 * table.SUCCESS_SHARE:g} % of its frames are tracked, in '
        'one map; drives on which the rover tips over are left out. Medians over the successes '
        'with 95 % intervals of the sign test; tracked and distance over all drives. Mono is '
        'aligned by Sim(3), the others by SE(3); scale is true '
        'over estimated size of the path, by Sim(3); RPE is over pieces of 1 m. Distance is '
        'horizontal, in steps of 0.1 s.']


def _of_scenarios(judged: Sequence[Judged]) -> str:
    """Return frame rate and speed, as far as the scenarios of the drives are at hand."""
    rates_hz, speeds_mps = set(), set()
    for drive in {(one.drive.scenario, one.drive.value): one.drive for one in judged}.values():
        if not drive.duration_s > 0.0:
            return ''
        try:
            scenario = drive.load_scenario()
        except ConfigError:
            return ''       # of another machine
        rates_hz.add(float(scenario.render_node.frame_rate_hz))
        speeds_mps.add(float(scenario.drive_node.speed_mps))
    return f', {_range(rates_hz)} frames/s, commanded speed {_range(speeds_mps)} m/s'


def _range(values: set[int] | set[float]) -> str:
    low, high = min(values), max(values)
    return f'{low:g}' if low == high else f'{low:g} to {high:g}'
