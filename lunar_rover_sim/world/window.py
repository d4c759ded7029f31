"""The part of a grid that is near a place."""

from __future__ import annotations

import numpy as np


def window_of(x0: float, y0: float, reach: float, n: int) -> tuple[slice, slice] | None:
    """Return the rows and columns within reach of a centre, in cells; None if fewer than two."""
    left, right = max(int(np.ceil(x0 - reach)), 0), min(int(np.floor(x0 + reach)) + 1, n)
    low, high = max(int(np.ceil(y0 - reach)), 0), min(int(np.floor(y0 + reach)) + 1, n)
    if right - left < 2 or high - low < 2:
        return None
    return slice(low, high), slice(left, right)
