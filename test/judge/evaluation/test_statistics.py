"""Intervals and p values of small series, whose resamples can be counted."""

import itertools

import numpy as np
import pytest
from scipy import stats

from lunar_rover_sim.judge.evaluation import statistics


@pytest.mark.parametrize('count', range(5))
def test_three_values_have_an_interval_and_two_have_none(count):
    values = np.append(np.arange(1.0, count + 1.0)**2, np.nan)
    one, means = statistics.estimate(values, np.random.default_rng(1))
    assert one.n == count and means.shape == (statistics.RESAMPLES,)
    assert np.isnan(one.value) == (count == 0)
    known = count >= 3
    assert np.isfinite([one.low, one.high]).all() == known == np.isfinite(means).all()


@pytest.mark.parametrize('count', [6, 7, 10, 25])
def test_the_interval_of_a_median_covers_it(count):
    """Also that of values that are far from normal."""
    rng = np.random.default_rng(3)
    found = [statistics.Median.of(rng.exponential(size=count)) for _ in range(400)]
    covered = sum(one.low <= np.log(2.0) <= one.high for one in found)
    assert stats.binomtest(covered, 400, 0.95, 'less').pvalue > 0.01
    few = statistics.Median.of(rng.exponential(size=5))
    assert np.isnan([few.low, few.high]).all() and few.text(1) == f'{few.value:.1f}'
    assert statistics.Median.of([np.nan]).text(1) == '–'


def test_what_is_rounded_to_nothing_has_no_sign():
    found = statistics.Estimate(-0.004, -0.006, 0.001, 5)
    assert found.text(2) == '0.00 [-0.01, 0.00]' and found.text(2, '+') == '+0.00 [-0.01, +0.00]'


@pytest.mark.parametrize('resamples,p', [
    (np.arange(1.0, 100.0), 2.0 * 1.0 / 100.0),             # none beyond 0: one counts anyway
    (-np.arange(1.0, 100.0), 2.0 * 1.0 / 100.0),
    (np.arange(-3.0, 96.0), 2.0 * 5.0 / 100.0),             # -3, -2, -1 and 0
    (np.arange(-95.0, 4.0), 2.0 * 5.0 / 100.0),
    (np.zeros(99), 1.0), (np.arange(-49.0, 50.0), 1.0)])
def test_p_counts_the_resamples_on_the_other_side_of_nothing(resamples, p):
    found = statistics.difference(2.5, resamples)
    assert found.value == 2.5 and found.p == pytest.approx(p)
    assert (found.low, found.high) == pytest.approx(np.percentile(resamples, [2.5, 97.5]))


def test_p_by_permutation_is_that_of_all_permutations():
    """Three and four rows are shuffled one by one: all 35 sides are counted."""
    rng = np.random.default_rng(2)
    first, second = rng.dirichlet(np.ones(5), 3), rng.dirichlet(np.ones(5) + 1.0, 4)
    rows = np.concatenate([first, second])

    def distance(chosen):
        others = [k for k in range(7) if k not in chosen]
        gap = rows[list(chosen)].mean(axis=0) - rows[others].mean(axis=0)
        return np.abs(np.cumsum(gap)).sum()

    # Of three rows blocks have one row each, and so they have of four beside three.
    all_of_them = [distance(chosen) for chosen in itertools.combinations(range(7), 3)]
    share = np.mean(np.array(all_of_them) >= distance((0, 1, 2)) - 1e-12)
    p, chance = statistics.permutation_p(first, second, np.random.default_rng(1), 4000)
    # Four standard deviations of a share of 4,000 draws.
    assert p == pytest.approx(share, abs=4.0 * np.sqrt(share * (1.0 - share) / 4000) + 1e-3)
    # 33 of 35 are 94 %, 34 are 97 %: a draw of 4,000 may take either for 95 %.
    assert any(chance == pytest.approx(one) for one in sorted(all_of_them)[32:34])


def test_pairs_change_sides_with_one_another():
    """A small change of series that scatter widely: only pair by pair is it beyond chance.

    64 rows have blocks of 4, so 16 pairs of blocks change sides; all but one part of them moves by
    the same amount, which 2 of 2^16 ways reach.
    """
    rng = np.random.default_rng(3)
    level = rng.uniform(0.2, 0.8, 64)
    first = np.stack([level, 1.0 - level], axis=1)
    second = first + [0.01, -0.01]
    alone, far = statistics.permutation_p(first, second, np.random.default_rng(1), 400)
    pairs, near = statistics.permutation_p(first, second, np.random.default_rng(1), 400,
                                           paired=True)
    assert alone > 0.3 and pairs == 1.0 / 401.0
    # 16 throws of a coin: the 95th percentile of |sum| is 8 of 16.
    assert far > 0.03 and near == pytest.approx(0.005, abs=0.0013)


def test_the_interval_of_shares_of_throws_is_wilsons():
    """Images that are throws of 0 or 1: as many trials as images, less what blocks and t add."""
    values = (np.arange(400) % 10 == 0).astype(float)
    rng = np.random.default_rng(1)
    rng.shuffle(values)
    one, means = statistics.estimate(values, rng, share=True)
    trials = round(0.1 * 0.9 / means.var())
    wilson = stats.binomtest(round(0.1 * trials), trials).proportion_ci(0.95, 'wilson')
    assert (one.low, one.high) == pytest.approx((wilson.low, wilson.high), abs=2e-3)
    for all_of_them in (np.zeros(5), np.ones(5), np.full(5, 0.2)):
        one, _ = statistics.estimate(all_of_them, rng, share=True)
        assert one.low == pytest.approx(one.value) == one.high


def test_neighbours_change_sides_together():
    """27 rows in blocks of 3: pairs of equal rows give a shuffled distance of whole blocks only.

    First rows are 1 in the first bin within one block of 3, and nothing else is: a shuffle moves
    the whole block or nothing of it.
    """
    first, second = np.zeros((27, 2)), np.zeros((27, 2))
    first[:, 1] = second[:, 1] = 1.0
    first[9:12] = [1.0, 0.0]
    p, _ = statistics.permutation_p(first, second, np.random.default_rng(1), 200)
    # The distance is 3 / 27 whichever side the block is on: all shuffles reach it.
    assert p == 1.0


def test_a_sampled_p_is_never_zero():
    """30 pairs have more signs than are tried: the data themselves count as one way."""
    rng = np.random.default_rng(5)
    first = rng.uniform(1.0, 2.0, 30)
    p = statistics.Comparison.of(first, first - rng.uniform(0.1, 0.5, 30)).p
    assert 0.0 < p < 0.001
    mixed = statistics.Comparison.of(rng.standard_normal(30), rng.standard_normal(30))
    assert mixed.p > 0.05


@pytest.mark.parametrize('first,second,p', [(0, 0, 1.0), (3, 3, 1.0), (6, 0, 2 / 2**6),
                                            (1, 5, 2 * 7 / 2**6)])
def test_success_of_one_alone_is_a_throw_of_a_coin(first, second, p):
    assert statistics.either_alone_p(first, second) == pytest.approx(p)
    assert statistics.either_alone_p(second, first) == pytest.approx(p)


DRAWN = {'normal': (np.random.Generator.standard_normal, 0.0, 0.935),
         'exponential': (np.random.Generator.standard_exponential, 1.0, 0.86)}


@pytest.mark.parametrize('count', [3, 5, 8, 20, 100])
@pytest.mark.parametrize('kind', DRAWN)
def test_the_interval_of_a_mean_covers_it(kind, count):
    """In 95 of 100 normal samples of any size, and in nearly as many of a skewed one.

    2,000 samples tell a coverage of 95 % to 1.5 % (three deviations). Percentiles of the bootstrap
    cover 85 % of normal samples of five, and 77 % of exponential ones.
    """
    draw, mean, least = DRAWN[kind]
    rng = np.random.default_rng(count)
    found = [statistics.Mean.of(draw(rng, count)) for _ in range(2000)]
    covered = np.mean([each.low <= mean <= each.high for each in found])
    assert least <= covered <= 0.965


def test_series_whose_interval_is_too_narrow_are_told():
    """By autoregression of 0.6 it covers four in five, and is told; independent series are not."""
    def told(correlation):
        rng = np.random.default_rng(3)
        series = rng.standard_normal((400, 74))
        for k in range(1, 74):
            series[:, k] += correlation * series[:, k - 1]
        found = [(statistics.estimate(one, rng)[0], statistics.resemblance(one) > 0.0)
                 for one in series[:, 50:]]
        return (np.mean([mean.low <= 0.0 <= mean.high for mean, _ in found]),
                np.mean([is_told for _, is_told in found]))

    covered, are_told = told(0.6)
    assert covered < 0.9 and are_told > 0.5
    covered, are_told = told(0.0)
    assert covered > 0.92 and are_told < 0.06
    assert statistics.resemblance(np.full(9, 2.0)) == statistics.resemblance(np.array([])) == 0.0


def test_the_interval_of_a_share_covers_it_within_0_and_1():
    """In the mean of all shares, over all outcomes of 30 drives by their probabilities."""
    found = [statistics.Share.of(k, 30) for k in range(31)]
    assert all(0.0 <= each.low <= each.value <= each.high <= 1.0 for each in found)
    assert np.isnan(statistics.Share.of(0, 0).value)
    covered = [stats.binom.pmf(range(31), 30, share)
               @ [each.low <= share <= each.high for each in found]
               for share in np.linspace(0.01, 0.99, 99)]
    assert 0.95 <= np.mean(covered) < 0.96


def test_of_many_tests_of_nothing_few_are_called_shown():
    """In 400 tables of 56 tests of nothing, one in twenty has any q below 0.05; uncorrected 94 %.

    A difference that is there survives the correction.
    """
    tables = np.random.default_rng(1).uniform(size=(400, 56))
    shown = np.mean([statistics.adjusted(p).min() < 0.05 for p in tables])
    assert shown < 0.09 and np.mean(tables.min(axis=1) < 0.05) > 0.9
    assert statistics.adjusted([*tables[0], 1e-5])[-1] < 0.05
    q = statistics.adjusted([0.01, np.nan, 0.02, 0.2])
    assert q == pytest.approx([0.03, np.nan, 0.03, 0.2], nan_ok=True)
