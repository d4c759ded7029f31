"""A round tip presses its print into the overlay: it compacts soil and piles the rest around.

What the underside of the ball displaces on its way leaves the samples that it covers. A part is
compacted there. The rest makes a rim around the print, more of it where the tip moves to.
"""

from __future__ import annotations

import math

import numpy as np

from lunar_rover_sim.regolith.fine_ground import FineGround
from lunar_rover_sim.regolith.overlay import CELL_M, Overlay

RIM_RADII = 1.2   # width of a fresh rim, before it slides

Point = tuple[float, float, float]
Window = tuple[int, int, int, int]


def press(overlay: Overlay, ground: FineGround, start: Point, end: Point, radius_m: float,
          compacted: float) -> Window:
    """Press a ball into the ground, swept from one centre to another (world frame) [m].

    compacted: part of the displaced volume that is compacted, 0 to 1
    Returns the window of samples that may have changed: ix, iy, nx, ny.
    """
    reach = (1.0 + RIM_RADII) * radius_m
    ix = math.floor((min(start[0], end[0]) - reach) / CELL_M)
    iy = math.floor((min(start[1], end[1]) - reach) / CELL_M)
    nx = math.ceil((max(start[0], end[0]) + reach) / CELL_M) - ix + 1
    ny = math.ceil((max(start[1], end[1]) + reach) / CELL_M) - iy + 1
    window = ix, iy, nx, ny
    # Offsets of the samples from the start, then from the nearest point of the path.
    dx = (np.arange(ix, ix + nx) * CELL_M - start[0])[None, :]
    dy = (np.arange(iy, iy + ny) * CELL_M - start[1])[:, None]
    way_x, way_y = end[0] - start[0], end[1] - start[1]
    length2 = way_x * way_x + way_y * way_y
    if length2 > 0.0:
        along = dx * (way_x / length2) + dy * (way_y / length2)
        np.minimum(np.maximum(along, 0.0, out=along), 1.0, out=along)
    else:
        along = np.ones((ny, nx))
    dx, dy = dx - along * way_x, dy - along * way_y
    distance2 = dx * dx + dy * dy
    base = ground.heights(ix, iy, nx, ny)
    change, compaction = overlay.window(ix, iy, nx, ny)
    # Above the underside of the ball; NaN beyond the ground, where there is nothing to press.
    taken = base - start[2]
    taken += change
    taken -= along * (end[2] - start[2])
    taken += np.sqrt(np.maximum(radius_m * radius_m - distance2, 0.0))
    pressed = taken > 0.0
    pressed &= distance2 < radius_m * radius_m
    if not pressed.any():
        return window
    taken[~pressed] = 0.0
    distance = np.sqrt(distance2)
    inner = float(distance[pressed].max())
    weight = np.maximum(0.0, (inner + RIM_RADII * radius_m - distance) / (RIM_RADII * radius_m))
    if length2 > 0.0:
        length = math.sqrt(length2)
        ahead = dx * way_x
        ahead += dy * way_y
        ahead *= min(1.0, length / CELL_M) / length
        ahead /= np.maximum(distance, 1e-9)
        ahead += 1.0
        weight *= ahead
    pressed |= np.isnan(base)
    weight[pressed] = 0.0
    total = float(weight.sum())
    # A print at the very border of the world may have no room for a rim: it is compacted then.
    part = compacted if total > 0.0 else 1.0
    change -= taken
    taken_sum = float(taken.sum())
    taken *= part
    compaction += taken
    if total > 0.0:
        change += weight * ((taken_sum - float(taken.sum()) + overlay.residue_m) / total)
        overlay.residue_m = 0.0
    overlay.put(ix, iy, change, compaction)
    return window


def hull(one: Window, other: Window) -> Window:
    """Return the smallest window that holds both."""
    ix, iy = min(one[0], other[0]), min(one[1], other[1])
    return (ix, iy, max(one[0] + one[2], other[0] + other[2]) - ix,
            max(one[1] + one[3], other[1] + other[3]) - iy)
