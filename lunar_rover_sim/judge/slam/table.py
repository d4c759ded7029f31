"""The table of a benchmark: successes, and medians over them, in three formats."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.files.results import csv_table, markdown_table, plain
from lunar_rover_sim.base.files.yaml_text import read_yaml
from lunar_rover_sim.judge.evaluation.statistics import (adjusted, Comparison, CONFIDENCE, Median,
                                                         Share)
from lunar_rover_sim.judge.slam.drives import Judged
from lunar_rover_sim.judge.slam.estimators import join

SUCCESS_SHARE = 0.9     # of the frames
_MAX_BYTES = 1 << 18

# Published numbers, by scenario and sensor: ate_m, scale.
Paper = Mapping[str, Mapping[str, Mapping[str, float]]]


@dataclasses.dataclass(frozen=True)
class TableRow:
    """All seeds of one scenario (and swept value), sensor and system.

    Medians of the successes: ate_m [m], ate_percent [% of the distance], scale, rpe_m [m per
    metre]; of all drives on which it ran: tracked [%]; of all drives: distance_m [m],
    duration_s [s].

    Attributes:
        drives: Number of drives on which the rover did not tip over.
        successes: Those of which it tracked nearly all, see `is_success`.
        success: Their share, with its interval.
        reasons: What went wrong, drive by drive.
    """

    scenario: str
    value: str
    sensor: str
    system: str
    drives: int
    successes: int
    success: Share
    ate_m: Median
    ate_percent: Median
    scale: Median
    rpe_m: Median
    tracked: Median
    distance_m: Median
    duration_s: Median
    reasons: tuple[str, ...]

    @property
    def key(self) -> tuple[str, str, str, str]:
        """Scenario, value, sensor and system, which its drives share; see `row_of`."""
        return self.scenario, self.value, self.sensor, self.system


def row_of(one: Judged) -> tuple[str, str, str, str]:
    """Return the key of the row that a drive belongs to."""
    return one.drive.scenario, one.drive.value, one.result.sensor, one.result.system


def is_success(one: Judged) -> bool:
    """Return whether the estimator has poses, in one map, of nearly all frames of the drive."""
    return (not one.failed and not tipped_over(one) and bool(np.isfinite(one.result.ate_m))
            and one.result.tracked_share >= SUCCESS_SHARE)


def tipped_over(one: Judged) -> bool:
    """Return whether the rover tipped over: neither a success nor a failure of an estimator."""
    return bool(np.isfinite(one.result.tipped_over_s))


def _what_went_wrong(one: Judged) -> str:
    result = one.result
    if one.failed or is_success(one):
        return result.reason
    if tipped_over(one):
        return join('left out', result.reason)
    share = f'tracked {100.0 * result.tracked_share:.3g} % of the frames'
    error = f', ATE of these {result.ate_m:.4f} m' if np.isfinite(result.ate_m) else ''
    return join(share + error, result.reason)


def _groups(judged: Iterable[Judged]) -> dict[tuple[str, str, str, str], list[Judged]]:
    """Return the drives of each row, in the order of their first ones."""
    groups: dict[tuple[str, str, str, str], list[Judged]] = {}
    for one in judged:
        groups.setdefault(row_of(one), []).append(one)
    return groups


def rows_of(judged: Iterable[Judged]) -> list[TableRow]:
    """Return the rows of a table, in the order of their first drives."""
    rows = []
    for key, group in _groups(judged).items():
        # A lost track counts as zero; a drive that failed for another reason does not count.
        upright = [one for one in group if not tipped_over(one)]
        ran = [one.result for one in upright if not one.failed]
        good = [one.result for one in group if is_success(one)]
        reasons = [f'seed {one.drive.seed}: {text}' for one in group
                   if (text := _what_went_wrong(one))]
        rows.append(TableRow(*key, len(upright), len(good),
                             Share.of(len(good), len(upright)),
                             Median.of(r.ate_m for r in good),
                             Median.of(r.ate_percent for r in good),
                             Median.of(r.scale for r in good), Median.of(r.rpe_m for r in good),
                             Median.of(100.0 * r.tracked_share for r in ran),
                             Median.of(one.result.distance_m for one in group),
                             Median.of(one.result.duration_s for one in group), tuple(reasons)))
    return rows


def differences(pairs: Sequence[tuple[str, Iterable[Judged], Iterable[Judged]]], same: str,
                larger: str, smaller: str) -> list[str]:
    """Say of each name whether the errors of its first drives differ from those of its second.

    Drives of one seed are pairs, and a failure counts as worse than any error. A difference is
    shown by its q, which counts all tests.

    Args:
        same, larger, smaller: What is said of the first ones.
    """
    def errors(group: Iterable[Judged]) -> dict[int, float]:
        return {one.drive.seed: one.result.ate_m if is_success(one) else float('inf')
                for one in group if not one.failed and not tipped_over(one)}

    tests = []
    for _, *both in pairs:
        first, second = map(errors, both)
        seeds = sorted(first.keys() & second.keys())
        tests.append(Comparison.of([first[s] for s in seeds], [second[s] for s in seeds]))
    sentences = []
    for (name, *_), test, q in zip(pairs, tests, adjusted([test.p for test in tests])):
        said = same if not q < 1.0 - CONFIDENCE else larger if test.effect > 0.0 else smaller
        sentences.append(f'{name}: {said} ({test.text()}, q = {q:.2g} of {len(tests)} tests)')
    return sentences


def curves_of(rows: Iterable[TableRow]) -> dict[tuple[str, str, str], list[TableRow]]:
    """Return scenario, sensor and system → their rows, one for each value of a sweep."""
    curves: dict[tuple[str, str, str], list[TableRow]] = {}
    for row in rows:
        curves.setdefault((row.scenario, row.sensor, row.system), []).append(row)
    return curves


def steps(rows: Sequence[TableRow], judged: Sequence[Judged]) -> list[str]:
    """Say of each value of a sweep and the next one whether their errors differ."""
    groups, found = _groups(judged), []
    for curve, along in curves_of(rows).items():
        for row, after in zip(along, along[1:]):
            found.append((f'{", ".join(curve)}, from {row.value} to {after.value}',
                          groups[row.key], groups[after.key]))
    return differences(found, 'the error is not shown to differ', 'the error becomes smaller',
                       'the error becomes larger')


def read_paper(path: Path) -> Paper:
    """Read published numbers: YAML, `scenario: {sensor: {ate_m: ..., scale: ...}}`.

    Raises:
        SlamError: If the file cannot be read or holds something else.
    """
    values = read_yaml(path, _MAX_BYTES, SlamError)
    try:
        return {str(scenario): {str(sensor): {str(k): _finite(v) for k, v in numbers.items()}
                                for sensor, numbers in sensors.items()}
                for scenario, sensors in values.items()}
    except (AttributeError, TypeError, ValueError, OverflowError):
        raise SlamError(f'{path}: is not valid; valid is scenario: {{sensor: {{ate_m: '
                        'number, scale: number}}') from None


def _finite(value: Any) -> float:
    number = float(value)
    if not np.isfinite(number):
        raise ValueError(value)
    return number


def markdown(rows: Sequence[TableRow], paper: Paper | None = None, parameter: str = '') -> str:
    """Return the table as Markdown, with the reasons below it."""
    titles, lines = text_cells(rows, paper or {}, parameter)
    several = len({row.system for row in rows}) > 1
    reasons = ['- ' + ' '.join(filter(None, (r.scenario, r.value, r.sensor,
                                             r.system if several else ''))) + f', {reason}'
               for r in rows for reason in r.reasons]
    wrong = ['', 'What went wrong:', '', *reasons] if reasons else []
    return '\n'.join([*markdown_table(titles, lines), *wrong]) + '\n'


def latex(rows: Sequence[TableRow], paper: Paper | None = None, parameter: str = '') -> str:
    """Return the table as a LaTeX tabular (booktabs)."""
    titles, lines = text_cells(rows, paper or {}, parameter)
    body = [' & '.join(_escaped(cell) for cell in line) + r' \\' for line in (titles, *lines)]
    return '\n'.join([r'\begin{tabular}{' + 'l' * 3 + 'r' * (len(titles) - 3) + '}', r'\toprule',
                      body[0], r'\midrule', *body[1:], r'\bottomrule', r'\end{tabular}']) + '\n'


def csv_text(rows: Sequence[TableRow]) -> str:
    """Return the table as CSV, with all digits."""
    names = ('ate_m', 'ate_percent', 'scale', 'rpe_m', 'tracked', 'distance_m', 'duration_s')
    titles = ['scenario', 'value', 'sensor', 'system', 'drives', 'successes', 'success_low',
              'success_high',
              *(f'{name}{end}' for name in names for end in ('', '_low', '_high', '_n')),
              'reasons']
    return csv_table(titles, (
        [*row.key, row.drives, row.successes, row.success.low, row.success.high,
         *plain([v for name in names for v in dataclasses.astuple(getattr(row, name))]),
         '; '.join(row.reasons)] for row in rows))


def text_cells(rows: Sequence[TableRow], paper: Paper,
               parameter: str = '') -> tuple[list[str], list[list[str]]]:
    """Return the titles of the columns, and the lines of the table, as text."""
    paper = {row.scenario: paper[row.scenario] for row in rows if row.scenario in paper}
    titles = ['scenario', *([parameter] if parameter else []), 'sensor', 'system', 'success',
              'ATE [m]', 'ATE [% of distance]', 'scale', 'RPE [m per m]', 'tracked [%]',
              'distance [m]', *(['paper: ATE [m]', 'paper: scale'] if paper else [])]
    lines = []
    for row in rows:
        published = paper.get(row.scenario, {}).get(row.sensor, {})
        lines.append([row.scenario, *([row.value] if parameter else []), row.sensor, row.system,
                      f'{row.successes}/{row.drives}', row.ate_m.text(4),
                      row.ate_percent.text(2), row.scale.text(4), row.rpe_m.text(4),
                      row.tracked.text(1), row.distance_m.text(2),
                      *([_number(published.get(k)) for k in ('ate_m', 'scale')] if paper else [])])
    return titles, lines


def _number(value: float | None) -> str:
    return '–' if value is None else f'{value:g}'


def _escaped(text: str) -> str:
    return text.replace('_', r'\_').replace('%', r'\%').replace('–', '--')
