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
from lunar_rover_sim.regolith.fine_ground import FineGround
from lunar_rover_sim.regolith.overlay import CELL_M, Overlay

TOLERANCE_DEG = 0.8
_SWEEPS, _LOOK = 400, 4   # the edge of the window is looked at after every fourth sweep
_PART = 0.45   # of an excess that moves at once; both neighbours of a line may take as much
_GROW = 6
_ALL_HOLDS_M = 1e9


def relax(overlay: Overlay, ground: FineGround, ix: int, iy: int, nx: int, ny: int,
          repose_deg: float) -> None:
    """Let a window of samples slide; it grows where soil runs over its edge."""
    slope = math.tan(math.radians(repose_deg))
    more = math.tan(math.radians(repose_deg + TOLERANCE_DEG)) - slope
    base = ground.heights(ix, iy, nx, ny)
    change, compaction = overlay.window(ix, iy, nx, ny)
    # About 0, where sums of heights are exact to far less than what is accounted for.
    begin = base - np.nan_to_num(base[ny // 2, nx // 2]) + change
    begin[np.isnan(begin)] = 0.0
    total = begin.copy()
    # All rows in one line: neighbours of any direction are pairs at one distance in it.
    line = total.ravel()
    pairs = [(offset, held, more * way) for offset, held, way in _held(base, slope)]
    step, size = np.empty(line.size), np.empty(line.size)
    moved = False
    for sweep in range(1, _SWEEPS + 1):
        calm = not any([_slide(line, *pair, step, size) for pair in pairs])
        moved = moved or not calm
        if (calm or sweep % _LOOK == 0) and moved and _differ_at_edge(total, begin):
            _put(overlay, ix, iy, change, compaction, total - begin)
            relax(overlay, ground, ix - _GROW, iy - _GROW, nx + 2 * _GROW, ny + 2 * _GROW,
                  repose_deg)
            return
        if calm:
            break
    if moved:
        _put(overlay, ix, iy, change, compaction, total - begin)


def _held(base: Array, slope: float) -> list[tuple[int, Array, float]]:
    """Return for each of four directions the pairs of samples, and what they hold.

    That is their distance in a line of all rows, the (n,) difference of height [m] that stands
    between them, very large where nothing slides, and their distance on the ground [m].
    """
    ny, nx = base.shape
    full = np.arange(nx)
    result = []
    # Towards east, north, north-east and north-west.
    for offset, columns, way in ((1, full < nx - 1, CELL_M), (nx, full >= 0, CELL_M),
                                 (nx + 1, full < nx - 1, CELL_M * math.sqrt(2.0)),
                                 (nx - 1, full > 0, CELL_M * math.sqrt(2.0))):
        flat = base.ravel()
        # Beyond the ground heights are NaN, and no comparison with them holds.
        slides = np.abs(flat[offset:] - flat[:-offset]) < slope * way
        slides &= np.tile(columns, ny)[:-offset]
        result.append((offset, np.where(slides, slope * way, _ALL_HOLDS_M), way))
    return result


def _slide(line: Array, offset: int, held: Array, tolerance: float, step: Array,
           size: Array) -> bool:
    """Let pairs slide once, in place; return whether any was steeper than the tolerance."""
    low, high = line[:-offset], line[offset:]
    step, size = step[:-offset], size[:-offset]
    np.subtract(high, low, out=step)
    np.abs(step, out=size)
    size -= held
    too_steep = size > tolerance
    if not too_steep.any():
        return False
    size *= _PART
    size *= too_steep
    np.copysign(size, step, out=step)
    high -= step
    low += step
    return True


def _differ_at_edge(one: Array, two: Array) -> bool:
    return any(not np.array_equal(one[side], two[side])
               for side in (0, -1, (slice(None), 0), (slice(None), -1)))


def _put(overlay: Overlay, ix: int, iy: int, change: Array, compaction: Array,
         slid: Array) -> None:
    """Write back what slid; its sum is 0 but for rounding, which goes to the residue."""
    overlay.residue_m -= float(slid.sum())
    overlay.put(ix, iy, change + slid, compaction)
