"""The files that a benchmark leaves: table as Markdown, CSV and LaTeX, and a page."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
from pathlib import Path

from lunar_rover_sim.errors import SlamError
from lunar_rover_sim.files.atomic import atomic_write
from lunar_rover_sim.slam import table
from lunar_rover_sim.slam.benchmark import Cell
from lunar_rover_sim.slam.benchmark_page import html_report
from lunar_rover_sim.slam.findings import findings


@dataclasses.dataclass(frozen=True)
class Report:
    """The table as Markdown, the findings as sentences, and the files that were written."""

    table: str
    findings: list[str]
    files: list[Path]


def write_report(cells: Sequence[Cell], folder: Path, parameter: str = '',
                 paper: table.Paper | None = None) -> Report:
    """Write SYSTEM.md, .csv, .tex and .html into the folder of a benchmark.

    cells: of one system, with results; parameter: what a sweep changes; paper: published numbers
    Raises SlamError if a file cannot be written.
    """
    rows = table.rows_of(cells)
    system = cells[0].estimator.system
    text, found = table.markdown(rows, paper, parameter), findings(cells, parameter)
    statement = _statement(cells)
    title = 'Benchmark' + (f' over {parameter}' if parameter else '')
    contents = {
        f'{system}.md': '\n\n'.join([*statement, text, *found]).rstrip() + '\n',
        f'{system}.csv': table.csv_text(rows),
        f'{system}.tex': table.latex(rows, paper, parameter),
        f'{system}.html': html_report(title, statement, rows, cells, found, folder, parameter,
                                      paper)}
    for name, content in contents.items():
        atomic_write(folder / name, content, SlamError)
    return Report(text, found, [folder / name for name in contents])


def _statement(cells: Sequence[Cell]) -> list[str]:
    """Return sentences about the drives and the columns of the table."""
    seeds = max(cell.drive.seed for cell in cells)
    drive, scenario = cells[-1].drive, cells[-1].drive.load_scenario()
    return [
        f'{seeds} drives of {drive.duration_s:g} s per line, seeds 1 to {seeds}, '
        f'{scenario.render_node.frame_rate_hz:g} frames/s, commanded speed '
        f'{scenario.drive_node.speed_mps:g} m/s; system {cells[0].estimator.system}.',
        f'A drive is a success if {100 * table.SUCCESS_SHARE:g} % of its frames are tracked, in '
        'one map. Medians over the successes with 95 % intervals of the bootstrap; tracked and '
        'distance over all drives. Mono is aligned by Sim(3), the others by SE(3); scale is true '
        'over estimated size of the path, by Sim(3); RPE is over pieces of 1 m. Distance is '
        'horizontal, in steps of 0.1 s.']
