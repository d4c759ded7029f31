"""Rounding that makes a world the same on every machine.

Additions, multiplications, divisions and square roots of arrays, element by element, are exact to
the last bit by IEEE 754 wherever NumPy runs. Powers, exponentials, transforms, solvers and sums
are not: libraries and processors differ in their last bits. The result of each of those is rounded
right away to a lattice that is coarse against these bits (about 1e-16 of the value) and fine
against what can be seen, so that all machines go on from the same number. They would differ only
where a value lies within the last bits of the middle between two points of the lattice.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

# The slope that one lattice step makes over a cell is at most 2^-11, 0.5 mrad.
_STEPS_PER_CELL = 2.0**11
ALBEDO_STEP = 2.0**-18  # lattice of the albedo factor


def height_step_m(cell_m: float) -> float:
    """Return the lattice of the heights of a level, a power of two [m]: 2^-17 m for 2.5 cm."""
    return 2.0 ** math.floor(math.log2(cell_m)) / _STEPS_PER_CELL


def on_lattice(values: ArrayLike, step: float) -> NDArray[np.float64]:
    """Return values, rounded to multiples of a step, which is a power of two, as float64."""
    result = np.array(values, np.float64)
    round_to(result, step)
    return result


def round_to(values: NDArray[np.floating[Any]], step: float) -> None:
    """Round values to multiples of a step, which is a power of two; in place."""
    values *= 1.0 / step
    np.rint(values, out=values)
    values *= step


def significant(values: ArrayLike) -> NDArray[np.float64]:
    """Return values, rounded to the 24 significant bits of single precision, as float64."""
    return np.asarray(values, np.float64).astype(np.float32).astype(np.float64)
