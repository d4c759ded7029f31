"""Intervals and p values of means of series, by the block bootstrap.

Neighbouring images of a drive resemble one another, so blocks of neighbours are drawn, not single
ones: circular blocks (Politis and Romano, 1992) of n^(1/3) (the order that Kuensch, Annals of
Statistics 17, 1989, derives). Intervals are percentiles of the resamples, which are spread a
little, because few blocks scatter less than their population.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from lunar_rover_sim.frames import Array

RESAMPLES = 2000
LEAST = 3       # values; fewer have no interval
_TAIL = 2.5     # percent


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


def estimate(values: Array, rng: np.random.Generator) -> tuple[SeriesMean, Array]:
    """Return the mean of (n,) values, NaN left out, and the means of the resamples."""
    known = values[np.isfinite(values)]
    nan = float('nan')
    if not len(known):
        return SeriesMean(nan, nan, nan, 0), np.full(RESAMPLES, nan)
    mean = float(known.mean())
    if len(known) < LEAST:
        return SeriesMean(mean, nan, nan, len(known)), np.full(RESAMPLES, nan)
    means = known[resampled(len(known), rng)].mean(axis=1)
    means = mean + _spread(len(known)) * (means - mean)
    low, high = np.percentile(means, (_TAIL, 100.0 - _TAIL))
    return SeriesMean(mean, float(low), float(high), len(known)), means


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
                  shuffles: int = RESAMPLES) -> tuple[float, float]:
    """Return p of a distance between the mean rows of (n, k) and (m, k), and what chance gives.

    The distance is the sum of the absolute differences of the cumulated means, in bins. Blocks of
    neighbours change sides together. The second value is the 95th percentile of the distances of
    shuffled sets: a distance below it says nothing.
    """
    rows = np.cumsum(np.concatenate([first, second]), axis=1)
    length = block_length(min(len(first), len(second)))
    blocks = np.concatenate([np.arange(len(first)) // length,
                             len(first) + np.arange(len(second)) // length])
    kinds = np.unique(blocks)

    def distance(is_first: NDArray[np.bool_]) -> float:
        return float(np.abs(rows[is_first].mean(axis=0) - rows[~is_first].mean(axis=0)).sum())

    observed = distance(np.arange(len(rows)) < len(first))
    sides = np.concatenate([np.ones(len(np.unique(blocks[:len(first)])), bool),
                            np.zeros(len(np.unique(blocks[len(first):])), bool)])
    found = []
    for _ in range(shuffles):
        side = rng.permutation(sides)
        found.append(distance(side[np.searchsorted(kinds, blocks)]))
    reached = sum(d >= observed - 1e-12 for d in found)
    return (reached + 1) / (shuffles + 1), float(np.percentile(found, 95.0))
