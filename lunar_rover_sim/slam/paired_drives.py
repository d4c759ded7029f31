"""What a few drives say: medians with their intervals, and comparisons of paired drives.

Drives of one seed are pairs: the same commands and start in another world or with another sensor.
An estimator that fails gives no error; a failure counts as worse than any error, so comparisons
go by ranks.
"""

from __future__ import annotations

from collections.abc import Iterable
import dataclasses
import itertools

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from lunar_rover_sim.frames import Array

CONFIDENCE = 0.95
_LEAST = 3              # values; fewer have no interval
_RESAMPLES = 4000
_EXACT_PAIRS = 14       # up to here all signs are tried, beyond a sample of them
_SEED = 19


@dataclasses.dataclass(frozen=True)
class Median:
    """The median of `count` values and its 95 % interval.

    The interval is that of percentiles of the bootstrap (Efron, Annals of Statistics 7, 1979), so
    it never leaves the range of the values. It is NaN for fewer than three, the median for none.
    """

    value: float
    low: float
    high: float
    count: int

    @classmethod
    def of(cls, values: Iterable[float], confidence: float = CONFIDENCE) -> Median:
        """Return the median of the finite values, with an interval of 95 % or another."""
        known = np.array([v for v in values if np.isfinite(v)])
        nan = float('nan')
        if not len(known):
            return cls(nan, nan, nan, 0)
        low = high = nan
        if len(known) >= _LEAST:
            rng = np.random.default_rng(_SEED)
            medians = np.median(known[rng.integers(0, len(known), (_RESAMPLES, len(known)))],
                                axis=1)
            low, high = np.quantile(medians, (0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence))
        return cls(float(np.median(known)), float(low), float(high), len(known))

    def text(self, digits: int) -> str:
        """Return `median [low, high]`."""
        if not self.count:
            return '–'
        if not np.isfinite(self.low):
            return f'{self.value:.{digits}f}'
        return f'{self.value:.{digits}f} [{self.low:.{digits}f}, {self.high:.{digits}f}]'


@dataclasses.dataclass(frozen=True)
class Share:
    """A share of all drives, 0 to 1, and its 95 % interval.

    The interval is Wilson's (Journal of the American Statistical Association 22, 1927): it stays
    within 0 and 1, and has a width where none or all of a few succeed. NaN without any drive.
    """

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, successes: int, drives: int) -> Share:
        """Return the share of `successes` among `drives`."""
        if not drives:
            return cls(float('nan'), float('nan'), float('nan'))
        interval = stats.binomtest(successes, drives).proportion_ci(CONFIDENCE, 'wilson')
        return cls(successes / drives, float(interval.low), float(interval.high))


@dataclasses.dataclass(frozen=True)
class Comparison:
    """How much larger the first of two paired sets of errors is.

    pairs: number of pairs
    difference: median of first minus second, of the pairs in which both have a value
    p: two-sided, of no difference: the share of all ways to swap the two of a pair that give as
        extreme a sum of signed ranks (Wilcoxon, Biometrics Bulletin 1, 1945)
    effect: rank-biserial correlation of pairs (Kerby, Comprehensive Psychology 3, 2014): 1 if the
        first is larger in all pairs, -1 if smaller
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
        p = float(np.mean(np.abs(sums) >= abs(observed) - 1e-9))
        return cls(len(a), median, p, observed / float(ranks.sum()))

    @property
    def sign(self) -> int:
        """1 if the first is larger, -1 if smaller, 0 if chance may have made the difference."""
        return int(np.sign(self.effect)) if self.p < 1.0 - CONFIDENCE else 0

    def text(self) -> str:
        """Return n, effect and p."""
        return f'n = {self.pairs}, effect {self.effect:+.2f}, p = {self.p:.2g}'


def _signs(count: int) -> Array:
    """Return (m, count) signs: all combinations, or a sample of them."""
    if count <= _EXACT_PAIRS:
        return np.array(list(itertools.product((-1.0, 1.0), repeat=count)))
    rng = np.random.default_rng(_SEED)
    return rng.choice([-1.0, 1.0], (2**_EXACT_PAIRS, count))
