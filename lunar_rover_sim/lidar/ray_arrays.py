"""What rays are cast on, as the arrays that compiled code reads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class LevelArrays(NamedTuple):
    """One level of the world.

    heights_m: (n, n) samples; cell_m: between them; tops_m: greatest heights of ground and rocks
        over all blocks; first, side: where the blocks of a size begin, and how many make a row;
    rock_first: (blocks + 1,) where the rocks of the smallest blocks begin in rock_list
    """

    heights_m: NDArray[np.float32]
    cell_m: float
    tops_m: NDArray[np.float32]
    first: NDArray[np.int64]
    side: NDArray[np.int64]
    rock_first: NDArray[np.int32]
    rock_list: NDArray[np.int32]


class RockArrays(NamedTuple):
    """Rocks as convex hulls.

    position_m: (m, 3); radius_m: (m,) of balls around them; R_world_rock: (m, 3, 3); diameter_m,
    shape: (m,); planes: (p, 4) n . x = d of all shapes, of diameter 1; plane_first: (shapes + 1,)
    """

    position_m: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    R_world_rock: NDArray[np.float64]
    diameter_m: NDArray[np.float64]
    shape: NDArray[np.int32]
    planes: NDArray[np.float64]
    plane_first: NDArray[np.int64]


class SoftArrays(NamedTuple):
    """Changes of the heights of the finest level, in square tiles of samples.

    rise_m: (side, side) more than a smallest block has risen anywhere [m], 0 where it does not
        differ; (0, 0) where nothing does
    slot: (tiles, tiles) number of a tile in change_m; corner: tile of slot[0, 0]
    change_m: (k, tile + 1, tile + 1) [m], with the first samples of the next tiles; sample_m:
        between samples, the first one at the origin
    """

    rise_m: NDArray[np.float64]
    slot: NDArray[np.int32]
    corner: int
    change_m: NDArray[np.float32]
    sample_m: float
