"""The files that a benchmark leaves: table as Markdown, CSV and LaTeX, every drive, and a page."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
from pathlib import Path

from lunar_rover_sim.errors import ConfigError, SlamError
from lunar_rover_sim.files.atomic import atomic_write
from lunar_rover_sim.slam import table
from lunar_rover_sim.slam.benchmark_page import curves, html_report, png
from lunar_rover_sim.slam.drives import csv_of_drives, Judged
from lunar_rover_sim.slam.findings import findings
from lunar_rover_sim.slam.seeds import text_of_seeds


@dataclasses.dataclass(frozen=True)
class BenchmarkReport:
    """The table as Markdown, the findings as sentences, and the files that were written."""

    table: str
    findings: list[str]
    files: list[Path]


def write_report(judged: Sequence[Judged], folder: Path, name: str,
                 paper: table.Paper | None = None) -> BenchmarkReport:
    """Write NAME.md, .csv, .tex and .html, NAME_drives.csv, and NAME.png of a sweep.

    judged: at least one; of several systems, each has findings of its own
    folder: is there; paper: published numbers
    Raises SlamError if a file cannot be written.
    """
    rows, parameter = table.rows_of(judged), judged[0].drive.parameter
    systems = list(dict.fromkeys(one.result.system for one in judged))
    found = [f'{system}: {sentence}' if len(systems) > 1 else sentence for system in systems
             for sentence in findings([one for one in judged if one.result.system == system],
                                      parameter)]
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
    return BenchmarkReport(text, found, [folder / file for file in contents])


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
        'one map. Medians over the successes with 95 % intervals of the bootstrap; tracked and '
        'distance over all drives. Mono is aligned by Sim(3), the others by SE(3); scale is true '
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
