"""Disturbed soil slides until no slope is steeper than its angle of repose.

Between neighbouring samples (eight around each) a part of the excess of height over the distance
times tan(repose) moves down, as in the erosion of Chrono's deformable terrain (SCM), one direction
of neighbours after the other, until no slope is steeper by more than a tolerance. Where the
untouched ground is as steep as that, everything holds: what falls there would run on without end.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.regolith.fine_ground import FineGround
from lunar_rover_sim.regolith.overlay import CELL_M, Overlay

TOLERANCE_DEG = 0.8
_SWEEPS, _LOOK = 400, 4   # the edge of the window is looked at after every fourth sweep
_PART = 0.45   # share of an excess that moves at once; both neighbours in a line may take it
_GROW = 6
_ALL_HOLDS_M = 1e9


def relax(overlay: Overlay, ground: FineGround, ix: int, iy: int, nx: int, ny: int,
          repose_deg: float) -> None:
    """Let a window of samples slide; it grows where soil runs over its edge."""
    slope = math.tan(math.radians(repose_deg))
    more = math.tan(math.radians(repose_deg + TOLERANCE_DEG)) - slope
    base = ground.heights(ix, iy, nx, ny)
    change, compaction = overlay.window(ix, iy, nx, ny)
    # Heights relative to the middle: near 0 their sums lose least by rounding.
    begin = base - np.nan_to_num(base[ny // 2, nx // 2]) + change
    begin[np.isnan(begin)] = 0.0
    total = begin.copy()
    # Flattened rows: neighbours in one direction are pairs at one offset.
    line = total.ravel()
    edge, neighbours = _window(ny, nx)
    edge_before = line[edge]
    pairs = _pairs(line, base.ravel(), neighbours, slope, more)
    moved = False
    for sweep in range(1, _SWEEPS + 1):
        calm = not any([_slide(*pair) for pair in pairs])
        moved = moved or not calm
        if (calm or sweep % _LOOK == 0) and moved and np.count_nonzero(line[edge] != edge_before):
            _put(overlay, ix, iy, change, compaction, total - begin)
            relax(overlay, ground, ix - _GROW, iy - _GROW, nx + 2 * _GROW, ny + 2 * _GROW,
                  repose_deg)
            return
        if calm:
            break
    if moved:
        _put(overlay, ix, iy, change, compaction, total - begin)


_Neighbours = tuple[int, NDArray[np.bool_], float]
_Pairs = tuple[Array, Array, Array, float, Array, Array]


@functools.lru_cache(maxsize=256)
def _window(ny: int, nx: int) -> tuple[NDArray[np.int_], list[_Neighbours]]:
    """Return the samples at the edge of a window, and the four directions of neighbours.

    A direction: the offset of neighbours in the flattened rows, which (n,) pairs at that offset
    are neighbours, and their distance on the ground [m].
    """
    samples = np.arange(ny * nx).reshape(ny, nx)
    edge = np.concatenate([samples[0], samples[-1], samples[1:-1, 0], samples[1:-1, -1]])
    columns = np.tile(np.arange(nx), ny)
    diagonal = CELL_M * math.sqrt(2.0)
    # Towards east, north, north-east and north-west.
    return edge, [(offset, there[:-offset], way) for offset, there, way in (
        (1, columns < nx - 1, CELL_M), (nx, columns >= 0, CELL_M),
        (nx + 1, columns < nx - 1, diagonal), (nx - 1, columns > 0, diagonal))]


def _pairs(line: Array, base: Array, neighbours: list[_Neighbours], slope: float,
           more: float) -> list[_Pairs]:
    """Return the arguments of `_slide` for each direction."""
    result = []
    step, size = np.empty(line.size), np.empty(line.size)
    for offset, there, way in neighbours:
        # Beyond the ground heights are NaN, and no comparison with them holds.
        slides = np.abs(base[offset:] - base[:-offset]) < slope * way
        slides &= there
        # The height difference up to which a pair does not slide.
        held = np.where(slides, slope * way, _ALL_HOLDS_M)
        result.append((line[:-offset], line[offset:], held, more * way, step[:-offset],
                       size[:-offset]))
    return result


def _slide(low: Array, high: Array, held: Array, tolerance: float, step: Array,
           size: Array) -> bool:
    """Let pairs slide once, in place; return whether any was steeper than the tolerance."""
    np.subtract(high, low, out=step)
    np.abs(step, out=size)
    size -= held
    too_steep = size > tolerance
    if not np.count_nonzero(too_steep):
        return False
    size *= _PART
    size *= too_steep
    np.copysign(size, step, out=step)
    high -= step
    low += step
    return True


def _put(overlay: Overlay, ix: int, iy: int, change: Array, compaction: Array,
         slid: Array) -> None:
    """Write back what slid; its sum is 0 but for rounding, which goes to the residue."""
    overlay.residue_m -= float(slid.sum())
    overlay.put(ix, iy, change + slid, compaction)
