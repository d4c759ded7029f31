"""The tables and files of a benchmark, from results that are given."""

from __future__ import annotations

import csv
import io

import pytest

from lunar_rover_sim.errors import SlamError
from lunar_rover_sim.slam import table
from lunar_rover_sim.slam.benchmark_report import html_report
from lunar_rover_sim.slam.drives import Drive, Judged
from lunar_rover_sim.slam.run_on_bag import SlamResult


def judged_of(results: dict[tuple[str, str], list[SlamResult]]) -> list[Judged]:
    return [Judged(Drive(scenario, seed, 40.0), result, bool(result.reason) and not result.frames)
            for (scenario, _), seeds in results.items() for seed, result in enumerate(seeds, 1)]


def result(sensor: str, ate_m: float, scale: float = 1.0, tracked: float = 1.0,
           reason: str = '') -> SlamResult:
    return SlamResult('reference', sensor, reason, 400, tracked, ate_m, scale, 20.0 * ate_m,
                      distance_m=5.0, duration_s=40.0)


RESULTS = {
    ('baseline', 'stereo'): [result('stereo', a) for a in (0.010, 0.012, 0.017)],
    ('baseline', 'mono'): [result('mono', a, 3.0) for a in (0.02, 0.03, float('nan'))],
    ('feature_sparse', 'stereo'): [result('stereo', 0.05, 1.3),
                                   result('stereo', 0.07, 0.9, 0.5, 'lost at 20.0 s'),
                                   SlamResult('reference', 'stereo', 'no bag <at all>')],
    ('feature_sparse', 'mono'): [result('mono', 0.01, 5.0, 0.4)] * 3,
}


def test_successes_and_medians() -> None:
    """A drive that lost its track has no error in the median, and says what it had."""
    rows = {(r.scenario, r.sensor): r for r in table.rows_of(judged_of(RESULTS))}
    good = rows['baseline', 'stereo']
    assert (good.successes, good.drives, good.ate_m.value, good.ate_m.count) == (3, 3, 0.012, 3)
    assert (good.ate_m.low, good.ate_m.high) == (0.010, 0.017)
    assert rows['baseline', 'mono'].successes == 2      # an error that is no number is none
    sparse = rows['feature_sparse', 'stereo']
    assert (sparse.successes, sparse.ate_m.value, sparse.ate_m.count) == (1, 0.05, 1)
    assert sparse.tracked.value == pytest.approx(75.0)   # of the two that ran
    assert sparse.reasons == (
        'seed 2: tracked 50 % of the frames, ATE of these 0.0700 m; lost at 20.0 s',
        'seed 3: no bag <at all>')
    assert rows['feature_sparse', 'mono'].successes == 0


def test_formats(tmp_path) -> None:
    judged = judged_of(RESULTS)
    rows = table.rows_of(judged)
    (tmp_path / 'paper.yaml').write_text('baseline: {stereo: {ate_m: 0.125, scale: 1.02}}\n')
    paper = table.read_paper(tmp_path / 'paper.yaml')
    text = table.markdown(rows, paper).splitlines()
    assert len({line.count('|') for line in text[:6]}) == 1
    assert text[2].endswith('| 0.125 | 1.02 |') and text[3].endswith('| – | – |')
    tex = table.latex(rows, paper)
    assert r'feature\_sparse' in tex and '0.0120 [0.0100, 0.0170]' in tex
    assert len({line.count('&') for line in tex.splitlines() if '&' in line}) == 1
    numbers = list(csv.DictReader(io.StringIO(table.csv_text(rows))))
    assert [float(numbers[0][f'ate_m{end}']) for end in ('', '_low', '_high', '_n')] == [
        0.012, 0.010, 0.017, 3.0]
    assert numbers[0]['successes'] == '3' and numbers[2]['reasons'].endswith('no bag <at all>')
    page = html_report('Benchmark', ['Stated.'], rows, judged, ['Found.'], paper=paper)
    assert 'Found.' in page
    assert page.count('data:image/png;base64,') == 2 and 'no bag &lt;at all&gt;' in page
    assert 'src="http' not in page and '<link' not in page and '<script' not in page


@pytest.mark.parametrize('text', ['', 'a: b', 'baseline: {stereo: {ate_m: many}}', '- 1', '{',
                                  'baseline: {stereo: {ate_m: .nan}}',
                                  'baseline: {stereo: {ate_m: 1' + '0' * 400 + '}}',
                                  '[' * 5000])
def test_bad_paper(tmp_path, text) -> None:
    (tmp_path / 'paper.yaml').write_text(text)
    with pytest.raises(SlamError, match='paper.yaml: (is not valid|not valid YAML)'):
        table.read_paper(tmp_path / 'paper.yaml')
