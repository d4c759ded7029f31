"""Intervals and tests of what a few drives, or the images of a series, say.

Drives of one seed are pairs: the same commands and start in another world or with another sensor.
An estimator that fails gives no error; a failure counts as worse than any error, so `Comparison`
goes by ranks.

Neighbouring images of a drive resemble one another, so blocks of neighbours are drawn from a
series, not single ones: circular blocks (Politis and Romano, 1992) of n^(1/3) (the order that
Kuensch, Annals of Statistics 17, 1989, derives). Intervals are percentiles of the resamples, which
are spread a little, because few blocks scatter less than their population.
"""

from __future__ import annotations

from collections.abc import Iterable
import dataclasses
import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from lunar_rover_sim.base.frames import Array

CONFIDENCE = 0.95
LEAST = 3               # values; fewer have no interval
_EXACT_PAIRS = 14       # up to here all signs are tried, beyond a sample of them
_SEED = 19


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A value of `count` values and its 95 % interval."""

    value: float
    low: float
    high: float
    count: int

    def text(self, digits: int, sign: str = '') -> str:
        """Return `value [low, high]`; sign: '+' to write that of positive numbers."""
        if not self.count:
            return '–'
        spec = f'{sign}.{digits}f'
        # Without the sign of what is rounded to 0.
        value, low, high = (round(float(one), digits) + 0.0
                            for one in (self.value, self.low, self.high))
        if not np.isfinite(low):
            return f'{value:{spec}}'
        return f'{value:{spec}} [{low:{spec}}, {high:{spec}}]'


class Median(Estimate):
    """The median of `count` values and its 95 % interval.

    The interval is between two of the values, by the sign test (Conover, Practical Nonparametric
    Statistics, 1999), and covers at least 95 % for any distribution; percentiles of the bootstrap
    cover 75 % for three values. Fewer than six have none: it is NaN, the median too for none.
    """

    @classmethod
    def of(cls, values: Iterable[float]) -> Median:
        """Return the median of the finite values."""
        known = np.array([v for v in values if np.isfinite(v)])
        nan = float('nan')
        if not len(known):
            return cls(nan, nan, nan, 0)
        interval = stats.quantile_test(known, p=0.5).confidence_interval(CONFIDENCE)
        return cls(float(np.median(known)), float(interval.low), float(interval.high), len(known))


class Mean(Estimate):
    """The mean of `count` values and its 95 % interval, Student's (Biometrika 6, 1908).

    It covers 95 % of normal values of any number; of five exponential ones 88 %, where percentiles
    of the bootstrap cover 77 % and BCa 79 %. It is NaN for fewer than three values.
    """

    @classmethod
    def of(cls, values: Array) -> Mean:
        """Return the mean of (n,) values, NaN left out."""
        known = values[~np.isnan(values)]
        n, nan = len(known), float('nan')
        if n < LEAST:
            return cls(float(known.mean()) if n else nan, nan, nan, n)
        mean = float(known.mean())
        half = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, n - 1) * stats.sem(known))
        return cls(mean, mean - half, mean + half, n)


class Share(Estimate):
    """A share of `count` drives, 0 to 1, and its 95 % interval.

    The interval is Wilson's (Journal of the American Statistical Association 22, 1927): it stays
    within 0 and 1, and has a width where none or all of a few succeed. NaN without any drive.
    """

    @classmethod
    def of(cls, successes: int, drives: int) -> Share:
        """Return the share of `successes` among `drives`."""
        if not drives:
            return cls(float('nan'), float('nan'), float('nan'), 0)
        interval = stats.binomtest(successes, drives).proportion_ci(CONFIDENCE, 'wilson')
        return cls(successes / drives, float(interval.low), float(interval.high), drives)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """How much larger the first of two paired sets of errors is.

    Attributes:
        pairs: Number of pairs.
        difference: Median of first minus second, of the pairs in which both have a value.
        p: Two-sided, of no difference: the share of all ways to swap the two of a pair that give
            as extreme a sum of signed ranks (Wilcoxon, Biometrics Bulletin 1, 1945).
        effect: Rank-biserial correlation of pairs (Kerby, Comprehensive Psychology 3, 2014): 1 if
            the first is larger in all pairs, -1 if smaller.
    """

    pairs: int
    difference: Median
    p: float
    effect: float

    @classmethod
    def of(cls, first: ArrayLike, second: ArrayLike) -> Comparison:
        """Compare (n,) errors, pair by pair; infinite errors are failures, NaN no drives."""
        a, b = np.asarray(first, float), np.asarray(second, float)
        known = ~(np.isnan(a) | np.isnan(b))
        a, b = a[known], b[known]
        # Pairs without a difference, two failures among them, do not count (Wilcoxon).
        difference = np.subtract(a, b, out=np.zeros(len(a)), where=a != b)
        median = Median.of(difference[np.isfinite(a) & np.isfinite(b)])
        difference = difference[difference != 0.0]
        if not len(difference):
            return cls(len(a), median, 1.0, 0.0)
        ranks = stats.rankdata(np.abs(difference))
        observed = float(np.sign(difference) @ ranks)
        sums = _signs(len(ranks)) @ ranks
        extreme = int(np.sum(np.abs(sums) >= abs(observed) - 1e-9))
        # In a sample of the ways, that of the data counts, too: p is never 0 (Phipson and Smyth,
        # Statistical Applications in Genetics and Molecular Biology 9, 2010).
        own = int(len(ranks) > _EXACT_PAIRS)
        p = (extreme + own) / (len(sums) + own)
        return cls(len(a), median, p, observed / float(ranks.sum()))

    def text(self) -> str:
        """Return n, effect and p."""
        return f'n = {self.pairs}, effect {self.effect:+.2f}, p = {self.p:.2g}'


def either_alone_p(first: int, second: int) -> float:
    """Return the exact two-sided p of McNemar's test (Psychometrika 12, 1947).

    Args:
        first: Pairs in which only the first succeeds.
        second: Pairs in which only the second does.
    """
    return float(stats.binomtest(first, first + second).pvalue) if first + second else 1.0


def signed_rank_p(differences: Array) -> float:
    """Return the two-sided p of Wilcoxon's signed-rank test of (n,) differences of pairs."""
    return float(stats.wilcoxon(differences).pvalue) if np.any(differences) else 1.0


def adjusted(p: ArrayLike) -> Array:
    """Return the q value of each of the tests of one table, (n,) p values; NaN is no test.

    q is the least share of false ones among the differences that are called shown, if this one is
    called so (Benjamini and Hochberg, Journal of the Royal Statistical Society B 57, 1995).
    """
    values = np.array(p, float)
    tested = ~np.isnan(values)
    if tested.any():
        values[tested] = stats.false_discovery_control(values[tested])
    return values


def _signs(count: int) -> Array:
    """Return (m, count) signs: all combinations, or a sample of them."""
    if count <= _EXACT_PAIRS:
        return np.array(list(itertools.product((-1.0, 1.0), repeat=count)))
    rng = np.random.default_rng(_SEED)
    return rng.choice([-1.0, 1.0], (2**_EXACT_PAIRS, count))


# Series

RESAMPLES = 2000    # of a series
_TAIL = 2.5     # percent
_LEAST_SWAPS = 8    # blocks: fewer pairs have too few ways to change sides for a p below 0.01


class SeriesMean(NamedTuple):
    """A value and its 95 % interval, NaN where there is none; n: number of values behind it."""

    value: float
    low: float
    high: float
    n: int


class Difference(NamedTuple):
    """A difference with its 95 % interval; p: two-sided, of no difference."""

    value: float
    low: float
    high: float
    p: float


def block_length(count: int) -> int:
    """Return the length of the blocks of a series."""
    return max(1, round(count ** (1.0 / 3.0)))


def resampled(count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return (RESAMPLES, count) places in a series, drawn in blocks."""
    length = block_length(count)
    starts = rng.integers(0, count, (RESAMPLES, -(-count // length)))
    places = (starts[..., None] + np.arange(length)) % count
    return places.reshape(RESAMPLES, -1)[:, :count]


def resemblance(values: Array) -> float:
    """Return how neighbours in a series (n,) are correlated where that is clear; else 0.

    It is clear above 0.3 and above twice the error of the correlation of independent values,
    n^(-1/2) (Bartlett, J. R. Stat. Soc. Suppl. 8, 1946). NaN are left out.
    """
    known = values[np.isfinite(values)]
    off = known - known.mean() if len(known) else known
    power = float(off @ off)
    if power <= 0.0:
        return 0.0
    found = float(off[1:] @ off[:-1]) / power
    return found if found > max(0.3, 2.0 / np.sqrt(len(known))) else 0.0


def estimate(values: Array, rng: np.random.Generator,
             share: bool = False) -> tuple[SeriesMean, Array]:
    """Return the mean of (n,) values, NaN left out, and the means of the resamples.

    The blocks are too short for neighbours that resemble each other much: `resemblance` says so.

    Args:
        share: Whether the values are shares, 0 to 1: the interval is then Wilson's, of as many
            trials as have the scatter of the resamples (Korn and Graubard, Survey Methodology 24,
            1998, with Wilson's interval for theirs), so that it stays within 0 and 1.
    """
    known = values[np.isfinite(values)]
    nan = float('nan')
    if not len(known):
        return SeriesMean(nan, nan, nan, 0), np.full(RESAMPLES, nan)
    mean = float(known.mean())
    if len(known) < LEAST:
        return SeriesMean(mean, nan, nan, len(known)), np.full(RESAMPLES, nan)
    means = known[resampled(len(known), rng)].mean(axis=1)
    means = mean + _spread(len(known)) * (means - mean)
    low, high = (_wilson(mean, float(means.std())) if share
                 else np.percentile(means, (_TAIL, 100.0 - _TAIL)))
    return SeriesMean(mean, float(low), float(high), len(known)), means


def _wilson(mean: float, error: float) -> tuple[float, float]:
    """Return Wilson's interval of a share with a standard error."""
    variance = mean * (1.0 - mean)
    if error**2 <= 1e-12 * variance or variance <= 0.0:
        return mean, mean       # all values are the same
    z = float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE))
    per_trial = error**2 / variance             # 1 / trials
    centre = mean + 0.5 * z**2 * per_trial
    half = z * np.sqrt(error**2 + 0.25 * (z * per_trial)**2)
    low, high = (np.array([centre - half, centre + half]) / (1.0 + z**2 * per_trial))
    return max(float(low), 0.0), min(float(high), 1.0)


def _spread(count: int) -> float:
    """Return the factor on the scatter of resampled means of so many values.

    Means over circular blocks have 1 - length / count of the variance; the quantile is that of
    Student's t with 1.5 degrees of freedom a block, as overlapping blocks have (Priestley,
    Spectral Analysis and Time Series, 1981, for Bartlett's window).
    """
    blocks = count / block_length(count)
    quantile = stats.t.ppf(0.975, 1.5 * blocks) / stats.norm.ppf(0.975)
    return float(np.sqrt(blocks / (blocks - 1.0)) * quantile)


def difference(value: float, resamples: Array) -> Difference:
    """Return a difference by the differences of its resamples; NaN without them."""
    if not np.isfinite(resamples).all():
        return Difference(value, *[float('nan')] * 3)
    low, high = np.percentile(resamples, (_TAIL, 100.0 - _TAIL))
    # The share beyond 0, ties counted in full, and one: no p is 0 (Davison and Hinkley, 1997).
    beyond = min((resamples <= 0.0).sum(), (resamples >= 0.0).sum())
    return Difference(value, float(low), float(high),
                      float(min(1.0, 2.0 * (beyond + 1) / (len(resamples) + 1))))


def permutation_p(first: Array, second: Array, rng: np.random.Generator,
                  shuffles: int = RESAMPLES, paired: bool = False) -> tuple[float, float]:
    """Return p of a distance between the mean rows of (n, k) and (m, k), and what chance gives.

    The distance is the sum of the absolute differences of the cumulated means, in bins. Blocks of
    neighbours change sides together; of pairs (n = m), the two blocks of a place change with one
    another, if there are enough of them. The second value is the 95th percentile of the distances
    of shuffled sets: a distance below it says nothing.
    """
    rows = np.cumsum(np.concatenate([first, second]), axis=1)
    length = block_length(min(len(first), len(second)))
    one, other = (np.arange(len(part)) // length for part in (first, second))
    counts = one[-1] + 1, other[-1] + 1

    def distance(is_first: NDArray[np.bool_]) -> float:
        return float(np.abs(rows[is_first].mean(axis=0) - rows[~is_first].mean(axis=0)).sum())

    def shuffled() -> NDArray[np.bool_]:
        if paired and counts[0] >= _LEAST_SWAPS:
            stays = rng.integers(0, 2, counts[0]) > 0
            return np.concatenate([stays[one], ~stays[other]])
        sides = rng.permutation(np.repeat([True, False], counts))
        return np.concatenate([sides[one], sides[counts[0] + other]])

    observed = distance(np.arange(len(rows)) < len(first))
    found = [distance(shuffled()) for _ in range(shuffles)]
    reached = sum(d >= observed - 1e-12 for d in found)
    return (reached + 1) / (shuffles + 1), float(np.percentile(found, 95.0))
