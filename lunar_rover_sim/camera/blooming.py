"""Blooming: charge that a full pixel of a CCD cannot hold runs along its column."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def bloom(electrons: NDArray[np.floating], well_e: float, share: float) -> NDArray[np.float64]:
    """Return the (h, w) electrons after charge has run up and down the columns.

    Half of what a pixel cannot hold runs either way into the next pixels with room. Charge that
    reaches the end of a column leaves it; all else is conserved.

    Args:
        electrons: (h, w) charge before.
        well_e: What a pixel holds.
        share: Of the charge beyond the well that runs, the rest is drained.
    """
    result = np.array(electrons, dtype=float)
    columns = np.flatnonzero((result > well_e).any(axis=0))
    held = np.minimum(result[:, columns], well_e)
    excess = 0.5 * share * (result[:, columns] - held)
    for rows in (range(len(held)), range(len(held) - 1, -1, -1)):
        running = np.zeros(len(columns))
        for row in rows:
            taken = np.minimum(well_e - held[row], running)
            held[row] += taken
            running += excess[row] - taken
    result[:, columns] = held
    return result
