"""How results are compared with those that are stored, by pytest-regressions."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

# Processors and versions of NumPy differ in the last bits. These are relative to the largest value
# of a column; all cases hold to them under each switch of `test/portability.py`.
DOUBLE = 1e-9
SINGLE = 2e-5       # results in single precision
_SAMPLES = 16


def sampled(values: Any) -> np.ndarray:
    """Return mean, deviation and up to 16 values of an array, evenly spread; (n,) float64."""
    flat = np.asarray(values, float).ravel()
    if len(flat) <= _SAMPLES:
        return flat
    known = flat[np.isfinite(flat)]
    places = np.linspace(0, len(flat) - 1, _SAMPLES).astype(int)
    return np.array([known.mean(), known.std(), *flat[places]])


@pytest.fixture()
def unchanged(num_regression: Any) -> Callable[..., None]:
    """Return a function that asserts that arrays, given by name, are as stored."""
    def check(tolerance: float, **arrays: Any) -> None:
        columns = {name: sampled(values) for name, values in arrays.items()}
        scales = {name: np.abs(column[np.isfinite(column)]).max(initial=1e-9)
                  for name, column in columns.items()}
        num_regression.check(columns, tolerances={
            name: {'rtol': 0.0, 'atol': tolerance * scale} for name, scale in scales.items()})

    return check
