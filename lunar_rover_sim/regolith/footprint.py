"""A round tip presses its print into the overlay: it compacts soil and piles the rest around.

What the underside of the ball displaces on its way leaves the samples that it covers. A part is
compacted there. The rest makes a rim around the print, more of it where the tip moves to.
"""

from __future__ import annotations

import math

import numpy as np

from lunar_rover_sim.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.regolith.repose import base_heights
from lunar_rover_sim.world.grid import HeightGrid

RIM_RADII = 1.2   # width of a fresh rim, before it slides

Point = tuple[float, float, float]
Window = tuple[int, int, int, int]


def press(overlay: Overlay, ground: HeightGrid, start: Point, end: Point, radius_m: float,
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
    x = ((ix + np.arange(nx)) * CELL_M)[None, :]
    y = ((iy + np.arange(ny)) * CELL_M)[:, None]
    way = end[0] - start[0], end[1] - start[1]
    length2 = way[0] ** 2 + way[1] ** 2
    along = (np.clip(((x - start[0]) * way[0] + (y - start[1]) * way[1]) / length2, 0.0, 1.0)
             if length2 > 0.0 else np.ones((ny, nx)))
    dx, dy = x - start[0] - along * way[0], y - start[1] - along * way[1]
    distance2 = dx ** 2 + dy ** 2
    underside = (start[2] + along * (end[2] - start[2])
                 - np.sqrt(np.maximum(radius_m ** 2 - distance2, 0.0)))
    base = base_heights(ground, ix, iy, nx, ny)
    change, compaction = overlay.window(ix, iy, nx, ny)
    with np.errstate(invalid='ignore'):
        taken = np.where(distance2 < radius_m ** 2, np.maximum(base + change - underside, 0.0),
                         0.0)
    # Beyond the ground there is nothing to press, and nowhere to put a rim.
    taken[np.isnan(taken)] = 0.0
    pressed = taken > 0.0
    if not pressed.any():
        return window
    distance = np.sqrt(distance2)
    inner = float(distance[pressed].max())
    weight = np.maximum(0.0, 1.0 - (distance - inner) / (RIM_RADII * radius_m))
    length = math.sqrt(length2)
    if length > 0.0:
        ahead = (dx * way[0] + dy * way[1]) / (np.maximum(distance, 1e-9) * length)
        weight *= 1.0 + min(1.0, length / CELL_M) * ahead
    weight[pressed | np.isnan(base)] = 0.0
    total = float(weight.sum())
    # A print at the very border of the world may have no room for a rim: it is compacted then.
    part = compacted if total > 0.0 else 1.0
    change -= taken
    compaction += part * taken
    if total > 0.0:
        piled = float(np.sum(taken - part * taken)) + overlay.residue_m
        change += weight * (piled / total)
        overlay.residue_m = 0.0
    overlay.put(ix, iy, change, compaction)
    return window


def hull(one: Window, other: Window) -> Window:
    """Return the window around two."""
    ix, iy = min(one[0], other[0]), min(one[1], other[1])
    return (ix, iy, max(one[0] + one[2], other[0] + other[2]) - ix,
            max(one[1] + one[3], other[1] + other[3]) - iy)
