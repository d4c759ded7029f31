"""Disturbed soil slides until no slope is steeper than its angle of repose.

Between neighbouring samples (eight around each) a part of the excess of height over the distance
times tan(repose) moves down, as in the erosion of Chrono's deformable terrain (SCM), one direction
of neighbours after the other, until no slope is steeper by more than a tolerance. Where the
untouched ground is as steep as that, everything holds: what falls there would run on without end.
"""

from __future__ import annotations

import math

import numpy as np

from lunar_rover_sim.frames import Array
from lunar_rover_sim.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.world.grid import HeightGrid

TOLERANCE_DEG = 0.8
_SWEEPS = 400
_PART = 0.3   # of an excess that moves at once; both neighbours of a line may take as much
_GROW = 6

_ALL, _FROM, _TO = slice(None), slice(1, None), slice(None, -1)
# The two ends of the pairs towards east, north, north-east and north-west, and their distance.
_PAIRS = (((_ALL, _TO), (_ALL, _FROM), CELL_M),
          ((_TO, _ALL), (_FROM, _ALL), CELL_M),
          ((_TO, _TO), (_FROM, _FROM), CELL_M * math.sqrt(2.0)),
          ((_TO, _FROM), (_FROM, _TO), CELL_M * math.sqrt(2.0)))


def base_heights(ground: HeightGrid, ix: int, iy: int, nx: int, ny: int) -> Array:
    """Return the (ny, nx) heights [m] of the untouched ground on samples; NaN beyond it."""
    x, y = np.meshgrid((ix + np.arange(nx)) * CELL_M, (iy + np.arange(ny)) * CELL_M)
    heights: Array = ground.height_at(np.stack([x, y], axis=-1))
    return heights


def relax(overlay: Overlay, ground: HeightGrid, ix: int, iy: int, nx: int, ny: int,
          repose_deg: float) -> None:
    """Let a window of samples slide; it grows where soil runs over its edge."""
    slope = math.tan(math.radians(repose_deg))
    steepest = math.tan(math.radians(repose_deg + TOLERANCE_DEG))
    base = base_heights(ground, ix, iy, nx, ny)
    change, compaction = overlay.window(ix, iy, nx, ny)
    stood = change.copy()
    edge = np.ones(change.shape, bool)
    edge[1:-1, 1:-1] = False
    # Beyond the ground heights are NaN, and no comparison with them holds.
    stands = [~(np.abs(base[a] - base[b]) < slope * d) for a, b, d in _PAIRS]
    total = base + change
    moved = False
    for _ in range(_SWEEPS):
        calm = True
        for (a, b, d), firm in zip(_PAIRS, stands):
            step = total[a] - total[b]
            size = np.abs(step)
            too_steep = size > steepest * d
            too_steep[firm] = False
            if too_steep.any():
                calm = False
                part = np.where(too_steep, np.copysign(_PART * (size - slope * d), step), 0.0)
                total[a] -= part
                total[b] += part
                change[a] -= part
                change[b] += part
        if calm:
            break
        moved = True
        if (change != stood)[edge].any():
            overlay.put(ix, iy, change, compaction)
            relax(overlay, ground, ix - _GROW, iy - _GROW, nx + 2 * _GROW, ny + 2 * _GROW,
                  repose_deg)
            return
    if moved:
        overlay.put(ix, iy, change, compaction)
