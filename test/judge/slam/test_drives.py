"""Drives of a benchmark: seeds, CSVs, parts that are joined, and their tables."""

import csv
import dataclasses
import io
import json
from pathlib import Path

from command_line import unfolded
from matplotlib.backends.backend_agg import FigureCanvasAgg
import numpy as np
import pytest
from scipy import stats

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.cli.main import execute, main
from lunar_rover_sim.judge.evaluation.statistics import Comparison
from lunar_rover_sim.judge.slam import table
from lunar_rover_sim.judge.slam.benchmark_report import curves, html_report
from lunar_rover_sim.judge.slam.drives import (csv_of_drives, Drive, join, Judged, read_csv,
                                               read_folder, seeds_of, text_of_seeds)
from lunar_rover_sim.judge.slam.run_on_bag import SlamResult
from lunar_rover_sim.judge.slam.table import rows_of


def judged(seed: int, ate_m: float = 0.01, sensor: str = 'stereo', system: str = 'reference',
           scenario: str = 'baseline', scale: float = 0.1 + 0.9, tracked: float | None = None,
           reason: str | None = None, failed: bool = False, **of_drive) -> Judged:
    """Return a drive of 60 s, of which all is tracked if it has an error."""
    if tracked is None:
        tracked = 1.0 if ate_m == ate_m else 0.0
    if reason is None:
        reason = '' if tracked else 'lost: it wrote no pose'
    return Judged(Drive(scenario, seed, **{'duration_s': 60.0, **of_drive}),
                  SlamResult(system, sensor, reason, 1200, tracked, ate_m, scale, 15.0 * ate_m,
                             distance_m=7.0 / 3.0, duration_s=59.9, wall_s=70.0), failed)


def written(path: Path, drives: list[Judged]) -> Path:
    path.write_text(csv_of_drives(drives))
    return path


def folder_of(path: Path, drives: list[Judged]) -> Path:
    """Write the results of a benchmark as `benchmark` leaves them."""
    for one in drives:
        cell = path / 'cells' / f'{one.drive.name}-{one.result.sensor}-{one.result.system}'
        cell.mkdir(parents=True)
        (cell / 'result.json').write_text(json.dumps({
            'request': {'drive': dataclasses.asdict(one.drive), 'estimator': {}},
            'failed': one.failed, 'result': one.result.to_mapping()}))
    return path


@pytest.mark.parametrize(('text', 'seeds'), [
    ('6', (1, 2, 3, 4, 5, 6)), ('1', (1,)), ('7-10', (7, 8, 9, 10)), ('4-4', (4,)),
    ('1,4', (1, 4)), (' 1, 7 - 9 ', (1, 7, 8, 9))])
def test_seeds(text: str, seeds: tuple[int, ...]) -> None:
    assert seeds_of(text) == seeds


@pytest.mark.parametrize('text', ['', '0', '-3', '10-7', '1,,2', 'all', '1-', '1.5', '0-4',
                                  '1-99999999', '12345678901', '\u0665'])
def test_bad_seeds_are_named(text: str) -> None:
    with pytest.raises(SlamError, match='seeds: .* is not valid; valid'):
        seeds_of(text)
    with pytest.raises(SlamError, match='names 4 twice'):
        seeds_of('1-5,4')


def test_seeds_in_words() -> None:
    assert text_of_seeds([3, 1, 2, 9, 12, 11, 1]) == '1 to 3, 9, 11 to 12'


def test_a_csv_is_read_as_it_was_written(tmp_path) -> None:
    """All digits, what is unknown, settings with commas and a reason with quotes."""
    drives = [judged(1, overrides=('a.b=[1,2]', 'c.d=x')), judged(2, float('nan')),
              judged(3, parameter='a.b', value='2', scenario='my "own", file.yaml'),
              dataclasses.replace(judged(4), failed=True)]
    read = read_csv(written(tmp_path / 'drives.csv', drives))
    assert [repr(one) for one in read] == [repr(one) for one in drives]


def test_a_csv_with_the_least_columns(tmp_path) -> None:
    """One made by hand: what it does not say is unknown, the share of the error follows."""
    path = tmp_path / 'old.csv'
    path.write_text('scenario,seed,sensor,system,tracked_share,ate_m,scale,distance_m,of_us\n'
                    'baseline,3,mono,orbslam3,0.97,0.014,1.2,7,x\n')
    one, = read_csv(path)
    assert one.result.ate_percent == pytest.approx(0.2)
    assert one.drive.duration_s != one.drive.duration_s and not one.failed


@pytest.mark.parametrize(('changed', 'said'), [
    (('60,', '"a'), 'drives.csv: line 2: .*'),
    (('reference', ' '), 'drives.csv: line 2: system is empty'),
    (('baseline,,,1', 'baseline,,,one'), "line 2: seed: 'one' is not a whole number"),
    ((',0.01,', ',many,'), "line 2: ate_m: 'many' is not a number"),
    ((',1.0,0.01,', ',1.4,0.01,'), 'line 2: tracked_share: 1.4 is not valid'),
    ((',1200,', ',inf,'), 'line 2: frames: inf is not valid'),
    (('[],0', '[],yes'), "line 2: failed: 'yes' is not valid"),
    (('[]', '{'), 'line 2: settings'),
    (('ate_m', 'ate'), 'is no CSV of drives: it lacks ate_m')])
def test_bad_csvs_are_named(tmp_path, changed: tuple[str, str], said: str) -> None:
    text = csv_of_drives([judged(1)])
    assert changed[0] in text
    (tmp_path / 'drives.csv').write_text(text.replace(*changed, 1))
    with pytest.raises(SlamError, match=said):
        read_csv(tmp_path / 'drives.csv')


def test_parts_are_joined(tmp_path) -> None:
    """Two machines and an older CSV; what two of them hold counts once, in one order."""
    first = folder_of(tmp_path / 'a', [judged(2), judged(1), judged(1, system='orbslam3')])
    second = written(tmp_path / 'b.csv', [judged(3), judged(1), judged(1, sensor='mono')])
    joined = join([second, first])
    assert [(one.result.sensor, one.result.system, one.drive.seed) for one in joined] == [
        ('mono', 'reference', 1), ('stereo', 'reference', 1), ('stereo', 'reference', 2),
        ('stereo', 'reference', 3), ('stereo', 'orbslam3', 1)]
    assert [one.folder is not None for one in joined] == [False, False, True, False, True]
    assert len(read_folder(first)) == 3


def test_values_of_a_sweep_are_in_order(tmp_path) -> None:
    drives = [judged(1, parameter='a.b', value=value) for value in ('10', '2', 'auto')]
    assert [one.drive.value for one in join([written(tmp_path / 'a.csv', drives)])] == [
        '2', '10', 'auto']


@pytest.mark.parametrize(('other', 'said'), [
    (judged(1, 0.02), 'baseline-seed1 stereo reference: .*a.csv and .*b.csv have different res'),
    (judged(2, duration_s=40.0), 'lasts 40 s, baseline-seed1 in .* 60 s: these are no parts'),
    (judged(2, overrides=('render_node.frame_rate_hz=10',)),
     'has settings render_node.frame_rate_hz=10, baseline-seed1 in .* none'),
    (judged(2, parameter='a.b', value='1'), 'parts sweep different parameters: a.b, none')])
def test_what_is_no_part_is_refused(tmp_path, other: Judged, said: str) -> None:
    parts = [written(tmp_path / 'a.csv', [judged(1)]), written(tmp_path / 'b.csv', [other])]
    with pytest.raises(SlamError, match=said):
        join(parts)


def test_what_was_recorded_makes_no_difference(tmp_path) -> None:
    """Nor does a CSV that does not say how long its drives were."""
    narrow = judged(2, overrides=('recorder_node.topics=[odom]',))
    unknown = judged(3, duration_s=float('nan'))
    parts = [written(tmp_path / f'{k}.csv', [one])
             for k, one in enumerate((judged(1), narrow, unknown))]
    assert len(join(parts)) == 3
    with pytest.raises(SlamError, match='0.csv: baseline-seed1 stereo reference is in it twice'):
        join([written(tmp_path / '0.csv', [judged(1), judged(1)])])


def test_a_folder_without_results_is_named(tmp_path) -> None:
    with pytest.raises(SlamError, match='holds no results of a benchmark'):
        join([tmp_path])
    folder_of(tmp_path / 'a', [judged(1)])
    next((tmp_path / 'a').glob('cells/*/result.json')).write_text('{}')
    with pytest.raises(SlamError, match='result.json: is not a result of a benchmark'):
        join([tmp_path / 'a'])


def test_command_line(tmp_path, capsys) -> None:
    """Six seeds of two systems from two machines: one table."""
    drives = [judged(seed, 0.01 * factor + 0.001 * seed, sensor, system, scenario)
              for system in ('reference', 'orbslam3') for sensor in ('mono', 'stereo')
              for scenario, factor in (('baseline', 1.0), ('feature_sparse', 3.0))
              for seed in range(1, 7)]
    parts = [written(tmp_path / f'{k}.csv', [one for one in drives if one.drive.seed % 2 == k])
             for k in (0, 1)]
    args = ['slam', 'table', *map(str, parts), '-o', str(tmp_path / 'out' / 'deep')]
    assert execute(args) == 0
    printed = capsys.readouterr().out
    assert printed.count('6/6') == 8
    out = tmp_path / 'out' / 'deep'
    assert '6 drives of 60 s per line, seeds 1 to 6' in (out / 'table.md').read_text()
    assert len(read_csv(out / 'table_drives.csv')) == len(drives)
    assert {p.name for p in out.iterdir()} == {'table.md', 'table.csv', 'table.tex', 'table.html',
                                               'table_drives.csv'}
    assert main(['slam', 'table', str(tmp_path), '-o', str(tmp_path / 'x')]) == 1
    assert 'holds no results' in unfolded(capsys.readouterr().err)


def test_curves_of_a_sweep(tmp_path) -> None:
    """Two systems over three values; one value at which nothing succeeds."""
    drives = [judged(seed, float('nan') if value == '2' else 0.01 * seed, system=system,
                     parameter='render_node.sun.elevation_deg', value=value)
              for system in ('reference', 'orbslam3') for value in ('2', '6', '15')
              for seed in range(1, 9)]
    args = ['slam', 'table', str(written(tmp_path / 'a.csv', drives)), '-o',
            str(tmp_path / 'out')]
    assert execute(args) == 0
    assert (tmp_path / 'out/table.png').stat().st_size > 10_000
    assert '- baseline 2 stereo orbslam3, seed 1: tracked 0 %' in (
        tmp_path / 'out/table.md').read_text()
    lines = (tmp_path / 'out/table.csv').read_text().splitlines()
    assert lines[0].startswith('scenario,value,sensor,system,drives,successes,success_low,')
    assert lines[1].startswith('baseline,2,stereo,reference,8,0,0.0,0.32')


@pytest.mark.parametrize('most_m', [0.02, 0.6])
def test_errors_of_a_wide_range_are_labelled(most_m) -> None:
    """Half a millimetre to most_m; at least two labels, and none over another."""
    drives = [judged(seed, ate_m, parameter='a.b', value=value)
              for value, ate_m in (('1', 0.0005), ('2', most_m)) for seed in (1, 2, 3)]
    figure = curves(rows_of(drives), drives, 'a.b')
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    axis = figure.axes[1].yaxis
    boxes = sorted(((box.y0, box.y1) for label in [
        *axis.get_ticklabels(), *axis.get_ticklabels(minor=True)] if label.get_text()
        for box in [label.get_window_extent()]
        if figure.axes[1].bbox.y0 <= box.y0 and box.y1 <= figure.axes[1].bbox.y1))
    assert len(boxes) >= 2
    assert all(upper[0] >= lower[1] for lower, upper in zip(boxes, boxes[1:]))


def test_values_of_a_wide_range_are_labelled() -> None:
    """Five values, each twice the one before it: no label stands over another."""
    values = ('0.0005', '0.001', '0.002', '0.004', '0.008')
    drives = [judged(seed, 0.001, parameter='a.b', value=value)
              for value in values for seed in (1, 2, 3)]
    figure = curves(rows_of(drives), drives, 'a.b')
    FigureCanvasAgg(figure).draw()
    for axes in figure.axes:
        labels = axes.get_xticklabels()
        assert [label.get_text() for label in labels] == list(values)
        boxes = [label.get_window_extent() for label in labels]
        assert all(right.x0 >= left.x1 for left, right in zip(boxes, boxes[1:]))


NAN = float('nan')
RESULTS = [
    *(judged(k, ate_m) for k, ate_m in enumerate((0.010, 0.011, 0.012, 0.012, 0.015, 0.017), 1)),
    *(judged(k, ate_m, 'mono', tracked=1.0) for k, ate_m in enumerate((0.02, 0.03, NAN), 1)),
    judged(1, 0.05, scenario='feature_sparse'),
    judged(2, 0.07, scenario='feature_sparse', tracked=0.5, reason='lost at 20.0 s'),
    judged(3, NAN, scenario='feature_sparse', reason='no bag <at all>', failed=True),
    *(judged(k, 0.01, 'mono', scenario='feature_sparse', tracked=0.4) for k in (1, 2, 3))]


def test_successes_and_medians() -> None:
    """A drive that lost its track has no error in the median, and says what it had."""
    rows = {(r.scenario, r.sensor): r for r in table.rows_of(RESULTS)}
    good = rows['baseline', 'stereo']
    assert (good.successes, good.drives, good.ate_m.value, good.ate_m.count) == (6, 6, 0.012, 6)
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
    rows = table.rows_of(RESULTS)
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
        0.012, 0.010, 0.017, 6.0]
    assert numbers[0]['successes'] == '6' and numbers[2]['reasons'].endswith('no bag <at all>')
    page = html_report('Benchmark', ['Stated.'], rows, RESULTS, ['Found.'], paper=paper)
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


LOST = None


def drives(errors: list[float | None], value: str) -> list[Judged]:
    """Return a drive per seed; LOST is one of which 40 % was tracked, with a small error."""
    return [judged(seed, 0.001, tracked=0.4, reason='lost', value=value) if error is LOST
            else judged(seed, error, value=value) for seed, error in enumerate(errors, 1)]


TEN = np.array([2.1, 1.4, 0.9, 3.0, 1.7, 2.6, 1.1, 1.9, 2.2, 1.3]) * 1e-3


def test_p_is_that_of_wilcoxon() -> None:
    """Without failures: the exact signed-rank test of SciPy."""
    rng = np.random.default_rng(4)
    for _ in range(5):
        a, b = rng.random(9), rng.random(9)
        test = Comparison.of(a, b)
        assert test.p == pytest.approx(stats.wilcoxon(a, b, method='exact').pvalue)
        assert test.difference.value == pytest.approx(np.median(a - b))
    assert Comparison.of(TEN + 1e-3, TEN).effect == 1.0
    assert Comparison.of(TEN, TEN + 1e-3).effect == -1.0


def test_a_failure_is_worse_than_any_error() -> None:
    lost = TEN.copy()
    lost[:7] = np.inf
    test = Comparison.of(lost, TEN)
    assert test.effect == 1.0 and test.p == 2.0 / 2**7       # three pairs are equal
    both = np.where(np.isinf(lost), np.inf, TEN)
    assert Comparison.of(lost, both).p == 1.0
    assert Comparison.of(lost, both).difference.count == 3
    assert Comparison.of([np.nan, 1.0], [1.0, 1.0]).pairs == 1


def test_a_sweep_compares_neighbours() -> None:
    """Eight drives that fail or get worse show a step; a single failure does not."""
    low = [LOST, LOST, LOST, LOST, 0.05, 0.06, 0.07, 0.08]
    cells = [*drives(low, value='2'),
             *drives([*[0.01] * 7, 0.02], value='6'),
             *drives([LOST, *[0.01] * 6, 0.02], value='10')]
    assert table.steps(rows_of(cells), cells) == [
        'baseline, stereo, reference, from 2 to 6: the error becomes smaller '
        '(n = 8, effect +1.00, p = 0.0078, q = 0.016 of 2 tests)',
        'baseline, stereo, reference, from 6 to 10: the error is not shown to differ '
        '(n = 8, effect -1.00, p = 1, q = 1 of 2 tests)']
    # A rover that tips over tells nothing: neither success nor failure, nor a pair.
    cells = [dataclasses.replace(one, result=dataclasses.replace(one.result, tipped_over_s=3.0))
             if one.drive.seed == 1 else one for one in cells]
    assert [(row.successes, row.drives) for row in rows_of(cells)] == [(4, 7), (7, 7), (7, 7)]
    assert 'seed 1: left out' in rows_of(cells)[1].reasons[0]
    assert 'n = 7' in table.steps(rows_of(cells), cells)[0]
    # Among eleven steps of nothing, the same drives show nothing.
    cells += [one for value in range(11, 22)
              for one in drives([0.01] * 8, value=str(value))]
    assert not any('becomes' in line for line in table.steps(rows_of(cells), cells))
