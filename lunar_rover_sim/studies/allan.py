"""Overlapping Allan deviation, and the noise parameters read from it.

For samples y of a rate with interval t0 and their running integral x, at averaging time
tau = m t0 (Riley, Handbook of frequency stability analysis, NIST SP 1065, 2008, eq. 11):

    sigma^2(tau) = sum_k (x[k + 2 m] - 2 x[k + m] + x[k])^2 / (2 tau^2 (N - 2 m + 1))

White noise of density S gives S^2 / tau, a random walk of density K gives K^2 tau / 3 (IEEE Std
952-1997, annex C).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.errors import StudyError
from lunar_rover_sim.frames import Array


@dataclasses.dataclass(frozen=True)
class AllanCurve:
    """Overlapping Allan deviation of some channels.

    tau_s: (k,) averaging times [s]; deviation: (k, c) in the unit of the signal;
    duration_s: length of the record.
    """

    tau_s: Array
    deviation: Array
    duration_s: float


@dataclasses.dataclass(frozen=True)
class NoiseFit:
    """Densities read from a curve: white [unit/sqrt(Hz)], random walk [unit/s/sqrt(Hz)]."""

    white: float
    random_walk: float

    def deviation(self, tau_s: ArrayLike) -> Array:
        """Return the Allan deviation of these densities at averaging times [s]."""
        tau = np.asarray(tau_s, dtype=float)
        return np.sqrt(self.white ** 2 / tau + self.random_walk ** 2 * tau / 3.0)


def overlapping_allan(signal: ArrayLike, rate_hz: float, per_decade: int = 10) -> AllanCurve:
    """Return the curve of (n,) or (n, c) samples taken at rate_hz [Hz].

    Averaging times are spaced evenly in the logarithm, up to a tenth of the record. Raises
    StudyError if there are fewer than 100 samples.
    """
    samples = np.asarray(signal, dtype=float)
    samples = samples.reshape(len(samples), -1)
    n = len(samples)
    if n < 100:
        raise StudyError(f'Allan deviation: {n} samples given; valid is >= 100')
    interval = 1.0 / rate_hz
    # Less the mean, which cancels anyway, the integral keeps its digits.
    integral = np.zeros((n + 1, samples.shape[1]))
    np.cumsum((samples - samples.mean(axis=0)) * interval, axis=0, out=integral[1:])
    decades = np.log10(n / 10.0)
    sizes = np.unique(np.logspace(0.0, decades, int(per_decade * decades) + 1).astype(int))
    deviation = np.empty((len(sizes), samples.shape[1]))
    for row, m in enumerate(sizes):
        second = integral[2 * m:] - 2.0 * integral[m:-m] + integral[:-2 * m]
        deviation[row] = np.sqrt(np.mean(second ** 2, axis=0) / (2.0 * (m * interval) ** 2))
    return AllanCurve(sizes * interval, deviation, n * interval)


def fit_noise(curve: AllanCurve) -> NoiseFit:
    """Return white noise and random walk read from the mean variance of the curve's channels.

    Weighted least squares of the relative error of S^2 / tau + K^2 tau / 3; a variance at tau has
    about duration / tau degrees of freedom. Iterated, since the weights are relative to the fit.
    """
    tau = curve.tau_s
    variance = np.mean(curve.deviation ** 2, axis=1)
    basis = np.stack([1.0 / tau, tau / 3.0], axis=1)
    freedom = curve.duration_s / tau
    model = variance
    squares = np.zeros(2)
    for _ in range(20):
        # The number of points per decade is even, so weights need no further correction.
        weight = np.sqrt(freedom) / np.maximum(model, 1e-300)
        squares = _non_negative(basis * weight[:, None], variance * weight)
        model = basis @ squares
    return NoiseFit(float(np.sqrt(squares[0])), float(np.sqrt(squares[1])))


def _non_negative(matrix: Array, target: Array) -> Array:
    """Return the least-squares solution with two entries >= 0."""
    best: Array = np.linalg.lstsq(matrix, target, rcond=None)[0].astype(np.float64)
    if np.all(best >= 0.0):
        return best
    single = np.maximum(0.0, matrix.T @ target / np.maximum(np.sum(matrix ** 2, axis=0), 1e-300))
    errors = [np.sum((matrix[:, k] * single[k] - target) ** 2) for k in range(2)]
    best[:] = 0.0
    winner = int(np.argmin(errors))
    best[winner] = single[winner]
    return best
