"""What the drives of a benchmark show: medians, paired comparisons, sentences."""

import numpy as np
import pytest
from scipy import stats

from lunar_rover_sim.evaluation.statistics import Comparison, Median
from lunar_rover_sim.slam.drives import Drive, Judged
from lunar_rover_sim.slam.findings import findings
from lunar_rover_sim.slam.run_on_bag import SlamResult

LOST = None


def drives(scenario: str, sensor: str, errors: list[float | None],
           scales: list[float] | None = None, value: str = '') -> list[Judged]:
    """Return a result per seed; LOST is a drive of which 40 % was tracked, with a small error."""
    scales = scales or [1.0] * len(errors)
    return [Judged(Drive(scenario, seed, 60.0, value=value),
                   SlamResult('reference', sensor, 'lost' if error is LOST else '', 1200,
                              0.4 if error is LOST else 1.0, 0.001 if error is LOST else error,
                              scale))
            for seed, (error, scale) in enumerate(zip(errors, scales), 1)]


def said(cells: list[Judged], what: str) -> str:
    """Return how the one sentence that holds `what` begins."""
    found, = (line for line in findings(cells) if what in line)
    return found.split(':')[0]


TEN = np.array([2.1, 1.4, 0.9, 3.0, 1.7, 2.6, 1.1, 1.9, 2.2, 1.3]) * 1e-3


def test_median_and_its_interval() -> None:
    """The order statistics that hold the median of ten with 95 % are about the 2nd and 9th."""
    median = Median.of([*TEN, float('nan')])
    assert (median.value, median.count) == (pytest.approx(1.8e-3), 10)
    assert np.sort(TEN)[1] <= median.low < median.value < median.high <= np.sort(TEN)[8]
    assert median.low > 0.0
    assert Median.of([]).text(2) == '–' and Median.of([1.0, 2.0]).text(2) == '1.50'


def test_the_interval_holds_the_median_as_often_as_it_says() -> None:
    """Of ten values from a skewed law, in 400 trials."""
    rng = np.random.default_rng(3)
    held = 0
    for values in rng.lognormal(size=(400, 10)):
        median = Median.of(values)
        held += median.low <= 1.0 <= median.high
    assert 0.90 <= held / 400 <= 0.985


def test_p_is_that_of_wilcoxon() -> None:
    """Without failures: the exact signed-rank test of SciPy."""
    rng = np.random.default_rng(4)
    for _ in range(5):
        a, b = rng.random(9), rng.random(9)
        test = Comparison.of(a, b)
        assert test.p == pytest.approx(stats.wilcoxon(a, b, method='exact').pvalue)
        assert test.difference.value == pytest.approx(np.median(a - b))
    assert Comparison.of(TEN + 1e-3, TEN).effect == 1.0
    assert Comparison.of(TEN, TEN + 1e-3).sign == -1


def test_few_drives_show_nothing() -> None:
    """With five pairs the smallest p is 2 / 2^5."""
    assert Comparison.of(TEN[:5] + 1.0, TEN[:5]).p == 2.0 / 32.0
    assert Comparison.of(TEN[:5] + 1.0, TEN[:5]).sign == 0
    assert Comparison.of(TEN[:6] + 1.0, TEN[:6]).sign == 1


def test_a_failure_is_worse_than_any_error() -> None:
    lost = TEN.copy()
    lost[:7] = np.inf
    test = Comparison.of(lost, TEN)
    assert test.sign == 1 and test.p == 2.0 / 2**7       # three pairs are equal
    both = np.where(np.isinf(lost), np.inf, TEN)
    assert Comparison.of(lost, both).p == 1.0
    assert Comparison.of(lost, both).difference.count == 3
    assert Comparison.of([np.nan, 1.0], [1.0, 1.0]).pairs == 1


def test_many_pairs() -> None:
    rng = np.random.default_rng(5)
    a = rng.random(40)
    assert Comparison.of(a, a + 0.1 * rng.standard_normal(40)).p > 0.01
    assert Comparison.of(a + 0.2, a).p < 1e-3


def table_one(sparse: float = 5.0, dark: float = 0.4) -> list[Judged]:
    """Return drives as the paper has them: sparse worst, dark stereo lowest."""
    rng = np.random.default_rng(6)

    def cell(scenario: str, sensor: str, factor: float) -> list[Judged]:
        scales = rng.uniform(3.0, 40.0, 10) if sensor == 'mono' else rng.normal(1.0, 0.01, 10)
        return drives(scenario, sensor, list(factor * TEN * rng.uniform(0.97, 1.03, 10)),
                      scales.tolist())
    return [*cell('baseline', 'mono', 1.0), *cell('baseline', 'stereo', 1.0),
            *cell('feature_sparse', 'mono', sparse), *cell('feature_sparse', 'stereo', sparse),
            *cell('low_albedo', 'mono', 1.0), *cell('low_albedo', 'stereo', dark)]


def test_the_findings_of_the_paper_are_shown_where_they_hold() -> None:
    sentences = findings(table_one())
    assert len(sentences) == 2 + 1 + 1 + 6
    assert all(line.startswith('shown: ') for line in sentences), sentences


def test_they_are_contradicted_where_the_opposite_holds() -> None:
    cells = table_one(sparse=0.2, dark=3.0)
    assert said(cells, 'stereo is worst on feature_sparse') == 'contradicted'
    assert said(cells, 'lowest error of all') == 'contradicted'
    apart = [*drives('baseline', 'mono', list(3.0 * TEN)),
             *drives('baseline', 'stereo', list(TEN), [0.8] * 10)]
    assert said(apart, 'alike on baseline') == 'contradicted'
    assert said(apart, 'scale of stereo') == 'contradicted'
    assert said(apart, 'scale of mono') == 'contradicted'     # all of them are 1


def test_and_not_shown_where_the_drives_decide_nothing() -> None:
    """As the table of three drives: 121 and 258 mm in the mean."""
    cells = [*drives('baseline', 'stereo', [0.05, 0.14, 0.17], [0.91, 1.03, 0.98]),
             *drives('feature_sparse', 'stereo', [0.06, 0.27, 0.45]),
             *drives('baseline', 'mono', [0.04, 0.2, 0.1], [1.0, 3.0, 1.02])]
    assert {line.split(':')[0] for line in findings(cells) if 'feature_sparse is within' not in
            line} == {'not shown'}


def test_two_drives_have_no_interval() -> None:
    cells = [*drives('baseline', 'stereo', [0.05, 0.14]), *drives('baseline', 'mono', [0.04, 0.2])]
    alike = next(line for line in findings(cells) if 'alike' in line)
    assert 'too few seeds for an interval' in alike and 'nan' not in alike


def test_failures_decide_first() -> None:
    """Small errors of the drives that went well do not make up for those that were lost."""
    sparse = drives('feature_sparse', 'stereo', [*[LOST] * 8, 1e-4, 1e-4])
    cells = [*drives('baseline', 'stereo', list(TEN)), *sparse]
    assert said(cells, 'worst on feature_sparse') == 'shown'
    assert 'n = 10' in findings(cells)[0]


def test_a_sweep_counts_successes_and_compares_neighbours() -> None:
    """Eight drives that fail or get worse show a step, a single failure does not."""
    low = [LOST, LOST, LOST, LOST, 0.05, 0.06, 0.07, 0.08]
    cells = [*drives('baseline', 'stereo', low, value='2'),
             *drives('baseline', 'stereo', [*[0.01] * 7, 0.02], value='6'),
             *drives('baseline', 'stereo', [LOST, *[0.01] * 6, 0.02], value='10'),
             *drives('baseline', 'mono', [0.01], value='2')]
    assert findings(cells, 'sun') == [
        'baseline, stereo, sun: 4 of 8 drives succeed at 2; 8 of 8 drives succeed at 6; '
        '7 of 8 drives succeed at 10',
        'baseline, mono, sun: 1 of 1 drives succeed at 2',
        'shown: the error is larger at 2 than at 6, baseline, stereo '
        '(n = 8, effect +1.00, p = 0.0078)',
        'not shown: the errors at 6 and 10 differ, baseline, stereo '
        '(n = 8, effect -1.00, p = 1)']
    other_way = findings([*drives('baseline', 'stereo', [0.01] * 8, value='5'),
                          *drives('baseline', 'stereo', low, value='10')], 'rate')
    assert other_way[1].startswith('shown: the error is smaller at 5 than at 10, baseline, stereo')
