"""Designs of experiments: the points of the unit cube that the episodes of a campaign take."""

from __future__ import annotations

from collections.abc import Sequence
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

LATIN_HYPERCUBE, SOBOL, RANDOM, GRID = 'latin_hypercube', 'sobol', 'random', 'grid'
DESIGNS = (SOBOL, LATIN_HYPERCUBE, RANDOM, GRID)


def unit_points(design: str, count: int, dimensions: int, seed: int) -> NDArray[np.float64]:
    """Return (count, dimensions) points in [0, 1), the same for the same arguments.

    latin_hypercube: each of `count` equal slices of each dimension holds one point (McKay, Beckman
    and Conover, 1979). sobol: a scrambled low-discrepancy sequence (Owen, 1998), of which more
    episodes are a continuation. random: independent points.
    """
    generator = np.random.default_rng(seed)
    if not count or not dimensions:
        return np.zeros((count, dimensions))
    if design == LATIN_HYPERCUBE:
        return qmc.LatinHypercube(dimensions, seed=generator).random(count)
    if design == SOBOL:
        # Sobol points are balanced for powers of two: draw the next power, keep the first ones.
        sampler = qmc.Sobol(dimensions, scramble=True, seed=generator)
        return sampler.random_base2(max(count - 1, 0).bit_length())[:count]
    return generator.random((count, dimensions))


def grid_rows(values: Sequence[Sequence[Any]]) -> list[tuple[Any, ...]]:
    """Return all combinations of the values, the last one changing fastest."""
    return list(itertools.product(*values))


def episode_seed(seed: int, index: int) -> int:
    """Return the seed of an episode, in [0, 2^31): independent streams from one seed."""
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0] & 0x7fffffff)
