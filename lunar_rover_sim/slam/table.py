"""The table of a benchmark: means over seeds with their 95 % intervals, in three formats."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import csv
import dataclasses
import io
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from lunar_rover_sim.errors import SlamError
from lunar_rover_sim.files.yaml_text import read_yaml
from lunar_rover_sim.slam.benchmark import Cell

CONFIDENCE = 0.95
_NEAR_ONE = 0.05
_MAX_BYTES = 1 << 18

# Published numbers, by scenario and sensor: ate_m, scale.
Paper = Mapping[str, Mapping[str, Mapping[str, float]]]


@dataclasses.dataclass(frozen=True)
class Mean:
    """Mean of `count` values, and the half width of its 95 % interval (Student's t).

    The half width is NaN for fewer than two values, the mean for none.
    """

    value: float
    half_width: float
    count: int

    @classmethod
    def of(cls, values: Iterable[float]) -> Mean:
        """Return the mean of the finite values."""
        known = np.array([v for v in values if np.isfinite(v)])
        if not len(known):
            return cls(float('nan'), float('nan'), 0)
        half = float('nan')
        if len(known) > 1:
            quantile = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, len(known) - 1))
            half = quantile * float(known.std(ddof=1)) / float(np.sqrt(len(known)))
        return cls(float(known.mean()), half, len(known))

    def text(self, digits: int, plus_minus: str = '±') -> str:
        """Return `mean ± half width`."""
        if not self.count:
            return '–'
        if not np.isfinite(self.half_width):
            return f'{self.value:.{digits}f}'
        return f'{self.value:.{digits}f} {plus_minus} {self.half_width:.{digits}f}'

    def p_against(self, other: Mean) -> float:
        """Return the p-value of Welch's test for equal means; 1 for fewer than two values each."""
        if min(self.count, other.count) < 2:
            return 1.0
        if not self.half_width and not other.half_width:    # no scatter
            return float(self.value == other.value)
        first, second = ((mean.value, mean.half_width * mean.count**0.5 / float(
            stats.t.ppf(0.5 + 0.5 * CONFIDENCE, mean.count - 1)), mean.count)
            for mean in (self, other))
        return float(stats.ttest_ind_from_stats(*first, *second, equal_var=False).pvalue)


@dataclasses.dataclass(frozen=True)
class Row:
    """All seeds of one scenario (and swept value), sensor and system.

    drives: number of drives; reasons: what went wrong, drive by drive
    Means are over the drives that have a value: ate_m [m], ate_percent [% of the distance], scale,
    tracked [%], distance_m [m], duration_s [s].
    """

    scenario: str
    value: str
    sensor: str
    system: str
    drives: int
    ate_m: Mean
    ate_percent: Mean
    scale: Mean
    tracked: Mean
    distance_m: Mean
    duration_s: Mean
    reasons: tuple[str, ...]

    @property
    def key(self) -> tuple[str, str, str, str]:
        """Scenario, value, sensor and system, which its cells share; see `row_of`."""
        return self.scenario, self.value, self.sensor, self.system


def row_of(cell: Cell) -> tuple[str, str, str, str]:
    """Return the key of the row that a cell belongs to."""
    return (cell.drive.scenario, cell.drive.value, cell.estimator.sensor, cell.estimator.system)


def rows_of(cells: Iterable[Cell]) -> list[Row]:
    """Return the rows of a table, in the order of their first cells."""
    groups: dict[tuple[str, str, str, str], list[Cell]] = {}
    for cell in cells:
        groups.setdefault(row_of(cell), []).append(cell)
    rows = []
    for (scenario, value, sensor, system), group in groups.items():
        results = [c.result for c in group if c.result is not None]
        # A lost track counts as zero; a cell that failed for another reason does not count.
        ran = [c.result for c in group if c.result is not None and not c.failed]
        reasons = [f'seed {c.drive.seed}: {c.result.reason}' for c in group
                   if c.result is not None and c.result.reason]
        rows.append(Row(scenario, value, sensor, system, len(group),
                        Mean.of(r.ate_m for r in results), Mean.of(r.ate_percent for r in results),
                        Mean.of(r.scale for r in results),
                        Mean.of(100.0 * r.tracked_share for r in ran),
                        Mean.of(r.distance_m for r in results),
                        Mean.of(r.duration_s for r in results), tuple(reasons)))
    return rows


def read_paper(path: Path) -> Paper:
    """Read published numbers: YAML, `scenario: {sensor: {ate_m: ..., scale: ...}}`.

    Raises SlamError if the file cannot be read or holds something else.
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


def markdown(rows: Sequence[Row], paper: Paper | None = None, parameter: str = '') -> str:
    """Return the table as Markdown, with the reasons below it."""
    titles, lines = text_cells(rows, paper or {}, parameter)
    table = ['| ' + ' | '.join(line) + ' |' for line in (titles, ['---'] * len(titles), *lines)]
    reasons = [f'- {r.scenario} {r.value} {r.sensor}, {reason}'.replace('  ', ' ')
               for r in rows for reason in r.reasons]
    return '\n'.join([*table, *(['', 'What went wrong:', '', *reasons] if reasons else [])]) + '\n'


def latex(rows: Sequence[Row], paper: Paper | None = None, parameter: str = '') -> str:
    """Return the table as a LaTeX tabular (booktabs)."""
    titles, lines = text_cells(rows, paper or {}, parameter, r'$\pm$')
    body = [' & '.join(_escaped(cell) for cell in line) + r' \\' for line in (titles, *lines)]
    return '\n'.join([r'\begin{tabular}{' + 'l' * 3 + 'r' * (len(titles) - 3) + '}', r'\toprule',
                      body[0], r'\midrule', *body[1:], r'\bottomrule', r'\end{tabular}']) + '\n'


def csv_text(rows: Sequence[Row]) -> str:
    """Return the table as CSV, with all digits."""
    names = ('ate_m', 'ate_percent', 'scale', 'tracked', 'distance_m', 'duration_s')
    file = io.StringIO()
    writer = csv.writer(file, lineterminator='\n')
    writer.writerow(['scenario', 'value', 'sensor', 'system', 'drives',
                     *(f'{name}{end}' for name in names for end in ('', '_half_width_95', '_n')),
                     'reasons'])
    for row in rows:
        means: list[Any] = [v for name in names
                            for v in dataclasses.astuple(getattr(row, name))]
        writer.writerow([row.scenario, row.value, row.sensor, row.system, row.drives,
                         *('' if v != v else v for v in means), '; '.join(row.reasons)])
    return file.getvalue()


def findings(rows: Sequence[Row], parameter: str = '') -> list[str]:
    """Return sentences that say whether the results are `as expected` of the scenarios or `not`.

    `open` says that the scatter of the drives leaves it undecided at 95 %: means differ by Welch's
    test or they do not, and an interval lies on one side of a bound or it does not. For a sweep
    over `parameter` they say at which of its values tracks were lost.
    """
    if parameter:
        return _losses(rows, parameter)
    by = {(r.scenario, r.sensor): r for r in rows}
    sentences = []
    for sensor in sorted({r.sensor for r in rows}):
        sparse = by.get(('feature_sparse', sensor))
        others = [r for s in ('baseline', 'low_albedo') if (r := by.get((s, sensor)))]
        if sparse is not None and others:
            signs = [_worse(sparse, other) for other in others]
            said = 'not' if min(signs) < 0 else 'as expected' if min(signs) > 0 else 'open'
            sentences.append(f'{said}: feature_sparse is worst ({sensor})')
    for scenario in ('baseline', 'low_albedo'):
        row = by.get((scenario, 'stereo'))
        if row is not None:
            sentences.append(f'{_near_one(row.scale)}: the scale of stereo is within '
                             f'{100 * _NEAR_ONE:g} % of 1 on {scenario}')
    return sentences


def _worse(row: Row, other: Row) -> int:
    """Return 1 if the drives of a row are worse than those of another, -1 if better, 0 if open.

    What decides is first the share of frames that are tracked, then the error.
    """
    for mean, against, bad in ((row.tracked, other.tracked, -1.0), (row.ate_m, other.ate_m, 1.0)):
        if mean.p_against(against) < 1.0 - CONFIDENCE:
            return int(np.sign(bad * (mean.value - against.value)))
    return 0


def _near_one(scale: Mean) -> str:
    """Return what the interval of a scale says: all of it is near 1, none of it, or some."""
    if not np.isfinite(scale.half_width):
        return 'open'
    away = abs(scale.value - 1.0)
    if away + scale.half_width <= _NEAR_ONE:
        return 'as expected'
    return 'not' if away - scale.half_width > _NEAR_ONE else 'open'


def _losses(rows: Sequence[Row], parameter: str) -> list[str]:
    sentences = []
    for scenario, sensor in dict.fromkeys((r.scenario, r.sensor) for r in rows):
        own = [r for r in rows if (r.scenario, r.sensor) == (scenario, sensor)]
        whole = [r.value for r in own if not r.reasons]
        parts = [f'all drives tracked to their end at {", ".join(whole)}'] if whole else []
        parts += [f'at {r.value}, {len(r.reasons)} of {r.drives} were not'
                  for r in own if r.reasons]
        sentences.append(f'{scenario}, {sensor}, {parameter}: {"; ".join(parts)}')
    return sentences


def text_cells(rows: Sequence[Row], paper: Paper, parameter: str = '',
               plus_minus: str = '±') -> tuple[list[str], list[list[str]]]:
    """Return the titles of the columns, and the lines of the table, as text."""
    paper = {row.scenario: paper[row.scenario] for row in rows if row.scenario in paper}
    titles = ['scenario', *([parameter] if parameter else []), 'sensor', 'system', 'drives',
              'ATE [m]', 'ATE [% of distance]', 'scale', 'tracked [%]', 'distance [m]',
              *(['paper: ATE [m]', 'paper: scale'] if paper else [])]
    lines = []
    for row in rows:
        published = paper.get(row.scenario, {}).get(row.sensor, {})
        lines.append([row.scenario, *([row.value] if parameter else []), row.sensor, row.system,
                      f'{row.ate_m.count}/{row.drives}', row.ate_m.text(4, plus_minus),
                      row.ate_percent.text(2, plus_minus), row.scale.text(4, plus_minus),
                      row.tracked.text(1, plus_minus), row.distance_m.text(2, plus_minus),
                      *([_number(published.get(k)) for k in ('ate_m', 'scale')] if paper else [])])
    return titles, lines


def _number(value: float | None) -> str:
    return '–' if value is None else f'{value:g}'


def _escaped(text: str) -> str:
    return text.replace('_', r'\_').replace('%', r'\%').replace('–', '--')
