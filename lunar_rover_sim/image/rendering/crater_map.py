"""Craters by place of the ground, as lists of each cell of it.

A place lies in a crater if it is within half the crater's diameter of its centre: within the rim
of the fresh crater, taken as a circle. Where several overlap, the youngest counts, the one that
formed last. Every level of the ground shows the craters that are drawn on it or on coarser ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.image.rendering.labels import FIRST_CRATER, LAST_LABEL

F32 = NDArray[np.float32]
Indices = NDArray[np.intp]

_CELLS = 512        # along a side of each level


class CraterLists(NamedTuple):
    """Craters by cell, as `truth_rows.shape_of` reads them.

    Attributes:
        cells: (levels, n, n, 2) first entry of each cell's list, and the one after the last.
        entries: (m, 4) centre x, y [m], square of the radius [m2], number in the image of craters.
        craters: (m,) their places in the catalogue.
    """

    cells: F32
    entries: F32
    craters: NDArray[np.int64]

    @property
    def of_shape(self) -> tuple[F32, F32]:
        """What `truth_rows.shape_of` takes."""
        return self.cells, self.entries

    def numbered(self, numbers: NDArray[np.uint16]) -> CraterLists:
        """Return the lists with other numbers of the craters in the image."""
        entries = self.entries.copy()
        entries[:, 3] = numbers[self.craters]
        return self._replace(entries=entries)


def crater_lists(craters: Craters, half_extents_m: list[float],
                 cells: int = _CELLS) -> CraterLists:
    """Return the craters of each cell of each level, the youngest first.

    Args:
        half_extents_m: Of the levels, finest first. A list ends with the first crater that covers
            all of its cell.
    """
    order = np.argsort(craters.time, kind='stable')
    numbers = np.minimum(order + FIRST_CRATER, LAST_LABEL)
    spans = np.zeros((len(half_extents_m), cells, cells, 2), np.float32)
    parts: list[F32] = []
    places = [np.zeros(0, np.int64)]
    total = 0
    for level, half_m in enumerate(half_extents_m):
        chosen = craters.level[order] >= level
        ordered, number = craters.select(order[chosen]), numbers[chosen]
        cell, rank = _touched(ordered, half_m, cells)
        counts = np.bincount(cell, minlength=cells * cells)
        ends = total + np.cumsum(counts)
        spans[level] = np.stack([ends - counts, ends], axis=-1).reshape(cells, cells, 2)
        parts.append(np.column_stack([
            ordered.position_m[rank], (0.5 * ordered.diameter_m[rank])**2,
            number[rank]]).astype(np.float32))
        places.append(order[chosen][rank])
        total += len(rank)
    return CraterLists(spans, np.concatenate(parts), np.concatenate(places))


def _touched(craters: Craters, half_m: float, cells: int) -> tuple[Indices, Indices]:
    """Return cell and crater of all entries, in their order; craters: the youngest first."""
    size = 2.0 * half_m / cells
    # Centre and radius in cells.
    x, y = (craters.position_m.T + half_m) / size
    radius = 0.5 * craters.diameter_m / size
    first = [np.clip(np.floor(c - radius), 0, cells).astype(int) for c in (x, y)]
    after = [np.clip(np.floor(c + radius) + 1, 0, cells).astype(int) for c in (x, y)]
    width, height = (np.maximum(b - a, 0) for a, b in zip(first, after))
    count = width * height
    crater = np.repeat(np.arange(len(craters)), count)
    place = np.arange(len(crater)) - np.repeat(np.cumsum(count) - count, count)
    columns = np.maximum(width, 1)[crater]
    i, j = first[0][crater] + place % columns, first[1][crater] + place // columns
    dx, dy, r = x[crater] - i, y[crater] - j, radius[crater]
    touches = np.hypot(_beyond(dx), _beyond(dy)) <= r
    covers = np.hypot(np.maximum(dx, 1.0 - dx), np.maximum(dy, 1.0 - dy)) <= r
    cell, crater, covers = (j * cells + i)[touches], crater[touches], covers[touches]
    order = np.argsort(cell, kind='stable')     # within a cell the youngest stays first
    cell, crater, covers = cell[order], crater[order], covers[order]
    # How many craters before it in its cell cover the cell.
    before = np.cumsum(covers) - covers
    starts = np.flatnonzero(np.diff(cell, prepend=-1))
    before = before - np.repeat(before[starts], np.diff(np.append(starts, len(cell))))
    seen = before == 0
    return cell[seen], crater[seen]


def _beyond(offset: Array) -> Array:
    """Return how far a coordinate lies beyond the span from 0 to 1."""
    return np.maximum(np.maximum(-offset, offset - 1.0), 0.0)
