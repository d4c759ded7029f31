"""Means over large blocks of a site, by which fields get a mean that is the same everywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.grid import Box
from lunar_rover_sim.ground.world.spline import Area

BLOCK_M = 51.2          # one block has its middle at the origin
CELL_M = 0.8            # of the field of which means are taken
_CELLS = round(BLOCK_M / CELL_M)


def field_for(box: Box) -> Area:
    """Return zeros on cells of `CELL_M` that hold all blocks around a box.

    Cell (i, j) reaches from i to i + 1 cells; its value is meant for its middle.
    """
    first, count = [], []
    for low, high in (box[:2], box[2:]):
        begin = int(np.floor(low / BLOCK_M + 0.5)) - 1
        end = int(np.floor(high / BLOCK_M + 0.5)) + 2
        first.append(begin * _CELLS - _CELLS // 2)
        count.append((end - begin) * _CELLS)
    return Area(np.zeros((count[1], count[0])), (first[0], first[1]), CELL_M)


def middles(field: Area) -> tuple[Array, Array]:
    """Return the places of the middles of the cells along x and y [m]."""
    x, y = ((first + np.arange(count) + 0.5) * field.cell_m
            for first, count in zip(field.first, field.values.shape[::-1]))
    return x, y


def box_of(field: Area) -> Box:
    """Return x low, x high, y low and y high of a field [m]."""
    (x, y), (rows, columns), cell = field.first, field.values.shape, field.cell_m
    return x * cell, (x + columns) * cell, y * cell, (y + rows) * cell


def smoothed(field: Area, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> Array:
    """Return the means over blocks of a `field_for` at places, bilinear between their middles.

    Args:
        x_m, y_m: Places of shapes that go together.
    """
    rows, columns = (n // _CELLS for n in field.values.shape)
    blocks = np.ascontiguousarray(field.values.reshape(rows, _CELLS, columns, _CELLS)
                                  .transpose(0, 2, 1, 3)).reshape(rows, columns, -1).mean(axis=2)
    taps = []
    for place, origin in ((y_m / BLOCK_M, field.first[1]), (x_m / BLOCK_M, field.first[0])):
        whole = np.floor(place)
        # The middle of block b is at b; the first one is this.
        number = (origin + _CELLS // 2) // _CELLS
        taps.append(((whole - number).astype(np.int64), place - whole))
    (row, v), (column, u) = taps
    low = (1.0 - u) * blocks[row, column] + u * blocks[row, column + 1]
    high = (1.0 - u) * blocks[row + 1, column] + u * blocks[row + 1, column + 1]
    return np.asarray((1.0 - v) * low + v * high)


def at_middles(position_m: NDArray[np.float64], cell_m: float) -> Array:
    """Return places for which samples stand at the middles of cells."""
    return np.asarray(position_m - 0.5 * cell_m)
