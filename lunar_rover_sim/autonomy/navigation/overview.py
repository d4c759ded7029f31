"""What was seen of the ground, kept coarsely beyond the rolling map, and what ways over it cost.

A rover that plans by its map alone forgets a wall that rolls off it. And if ground beyond the map
costs less than unknown ground on it, the nearest edge is the cheapest way: it turns back to drive
around what it has not looked at yet.

It is kept around the rover alone, and a goal beyond that is replaced by a place on the way there:
a new plan costs the same however far the goal is, and however far the rover has come.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import label
from skimage.graph import MCP_Geometric

from lunar_rover_sim.base.frames import Array

_FINE = 4                   # cells of the map along a side of one of these
WALL_COST = 100.0           # of an obstacle, which may have been a wrong match
_KEPT_M = 12.8              # from the middle of the newest map, in x and in y
_GOAL_M = 20.0              # from there, as far as ways are looked for
_OPEN, _CLOSED = 1, 2       # unknown: 0
_FORGOTTEN = 0.5            # share of what the last map knew; if less is known now, it is another
_DIAGONAL = math.sqrt(2.0)


class Overview:
    """Cells around the rover in which it can stand or not, of all maps so far.

    Attributes:
        map_cell_m: Side of a cell of the maps.
        cell_m: Side of a cell of this one.
    """

    def __init__(self, cell_m: float, unknown_cost: float) -> None:
        """Begin one.

        Args:
            cell_m: Side of a cell of the maps.
            unknown_cost: Of a metre over ground that no map knows; over free ground it is 1.
        """
        self._unknown_cost = unknown_cost
        self.map_cell_m, self.cell_m = cell_m, _FINE * cell_m
        self._low = np.zeros(2, int)                    # row and column of [0, 0] in the world
        self._seen = np.zeros((0, 0), np.uint8)
        self._middle = np.zeros(2)                      # of the newest map, row and column
        self._last_low, self._last = self._low, self._seen
        self._way: tuple[tuple[int, ...], tuple[NDArray[np.int64], Array]] | None = None

    def add(self, origin_m: ArrayLike, blocked: NDArray[np.bool_], unknown: NDArray[np.bool_],
            room_m: float) -> None:
        """Take in a map; what it does not know stays as it was.

        A map that has lost what the one before knew was begun anew, since the pose had jumped:
        then all else is forgotten.

        Args:
            origin_m: (2,) corner of the cell [0, 0] with the least x and y.
            blocked: (n, n) cells in which the rover would touch an obstacle.
            unknown: (n, n)
            room_m: What the rover needs to obstacles. Nearer to the edge of the map nothing is
                known to be free: an obstacle may lie beyond it.
        """
        edge = math.ceil(room_m / self.map_cell_m)
        free = np.zeros_like(blocked)
        free[edge:-edge, edge:-edge] = ~unknown[edge:-edge, edge:-edge]
        self._way = None
        low, new = self._coarse(origin_m, blocked, blocked | free)
        before, now = _common(self._last_low, self._last, low, new)
        known = before > 0
        if np.count_nonzero(now[known]) < _FORGOTTEN * np.count_nonzero(known):
            self._seen = np.zeros((0, 0), np.uint8)
        self._last_low, self._last = low, new
        self._middle = low + 0.5 * np.array(new.shape)
        self._extend(low, low + new.shape)
        self._cut(math.ceil(_KEPT_M / self.cell_m))
        r, c = low - self._low
        part = self._seen[r:r + new.shape[0], c:c + new.shape[1]]
        np.copyto(part, new, where=new > 0)

    def closed_at(self, x_m: Array, y_m: Array) -> NDArray[np.bool_]:
        """Return where an obstacle was seen, for columns x (n,) and rows y (m,) as (m, n)."""
        rows, columns = (np.floor(v / self.cell_m).astype(int) - low
                         for v, low in zip((y_m, x_m), self._low))
        inside = [(k >= 0) & (k < size) for k, size in zip((rows, columns), self._seen.shape)]
        closed = np.zeros((len(rows), len(columns)), bool)
        seen = self._seen[np.ix_(rows[inside[0]], columns[inside[1]])]
        closed[np.ix_(*inside)] = seen == _CLOSED
        return closed

    def detour_m(self, points_m: ArrayLike, goal_m: ArrayLike) -> Array:
        """Return what ways from points to a goal cost beyond straight ones over free ground.

        Args:
            points_m: (n, 2)
            goal_m: (2,), of a far one the way there.

        Returns:
            (n,) [m]
        """
        cells = np.floor(np.asarray(points_m, float).reshape(-1, 2)[:, ::-1]
                         / self.cell_m).astype(int)
        place = np.asarray(goal_m, float)[::-1] / self.cell_m
        off = place - self._middle
        far = _GOAL_M / self.cell_m / max(float(np.linalg.norm(off)), 1e-9)
        goal = np.floor(self._middle + off * far if far < 1.0 else place).astype(int)
        low, total = self._to_goal(goal, cells)
        off = np.abs(cells - goal)
        free = off.max(axis=1) + (_DIAGONAL - 1.0) * off.min(axis=1)
        return (total[tuple((cells - low).T)] - free) * self.cell_m

    def is_open(self, from_m: ArrayLike, to_m: ArrayLike) -> bool:
        """Return whether a way leads from a place (2,) to another that crosses nothing closed."""
        cells = [np.floor(np.asarray(xy, float)[::-1] / self.cell_m).astype(int)
                 for xy in (from_m, to_m)]
        # Around all that was seen all is open.
        corners = [self._low, self._low + self._seen.shape, *cells]
        low, high = np.min(corners, axis=0) - 1, np.max(corners, axis=0) + 2
        is_open = np.ones(tuple(high - low), bool)
        r, c = self._low - low
        is_open[r:r + self._seen.shape[0], c:c + self._seen.shape[1]] = self._seen != _CLOSED
        parts, _ = label(is_open, np.ones((3, 3)))
        start, end = (parts[tuple(cell - low)] for cell in cells)
        return bool(start == end != 0)

    def _to_goal(self, goal: NDArray[np.int64], cells: NDArray[np.int64]
                 ) -> tuple[NDArray[np.int64], Array]:
        """Return row and column of a part that holds the (n, 2) cells, and its costs to a goal."""
        if self._way is not None and tuple(goal) == self._way[0]:
            low, total = self._way[1]
            if (cells >= low).all() and (cells < low + total.shape).all():
                return self._way[1]
        # There is a way around all that was seen.
        corners = [self._low, self._low + self._seen.shape, goal, goal + 1, *cells, *(cells + 1)]
        low, high = np.min(corners, axis=0) - 1, np.max(corners, axis=0) + 1
        cost = np.full(tuple(high - low), self._unknown_cost)
        r, c = self._low - low
        seen = cost[r:r + self._seen.shape[0], c:c + self._seen.shape[1]]
        seen[self._seen == _CLOSED] = WALL_COST
        seen[self._seen == _OPEN] = 1.0
        total, _ = MCP_Geometric(cost, fully_connected=True).find_costs([tuple(goal - low)])
        self._way = tuple(goal), (low, total)
        return self._way[1]

    def _coarse(self, origin_m: ArrayLike, blocked: NDArray[np.bool_],
                known: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
        """Return a map in cells of this one: row and column of the first, and the cells."""
        first = np.round(np.asarray(origin_m, float)[::-1] * _FINE / self.cell_m).astype(int)
        low = first // _FINE
        before = first - low * _FINE
        pads = [(b, -(b + n) % _FINE) for b, n in zip(before, blocked.shape)]
        counts = [_blocks(np.pad(cells, pads)) for cells in (blocked, known)]
        half = _FINE * _FINE // 2
        return low, np.where(counts[0] >= half, _CLOSED,
                             np.where(counts[1] >= half, _OPEN, 0)).astype(np.uint8)

    def _extend(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        """Make room for the cells from low up to high."""
        if not self._seen.size:
            self._low, self._seen = low, np.zeros(tuple(high - low), np.uint8)
            return
        before = np.maximum(self._low - low, 0)
        after = np.maximum(high - self._low - self._seen.shape, 0)
        if before.any() or after.any():
            self._seen = np.pad(self._seen, list(zip(before, after)))
            self._low = self._low - before

    def _cut(self, reach: int) -> None:
        """Forget what is farther than so many cells from the middle of the newest map."""
        low = np.maximum(np.floor(self._middle).astype(int) - reach - self._low, 0)
        high = np.ceil(self._middle).astype(int) + reach - self._low
        if low.any() or (high < self._seen.shape).any():
            self._seen = self._seen[low[0]:high[0], low[1]:high[1]].copy()
            self._low = self._low + low


def _blocks(cells: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return how many cells of each coarse one are true."""
    rows, columns = cells.shape
    return cells.reshape(rows // _FINE, _FINE, columns // _FINE, _FINE).sum(axis=(1, 3))


def _common(low_a: NDArray[np.int64], a: NDArray[np.uint8], low_b: NDArray[np.int64],
            b: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return the cells that two arrays share, of each."""
    low = np.maximum(low_a, low_b)
    high = np.maximum(low, np.minimum(low_a + a.shape, low_b + b.shape))
    of_a, of_b = (tuple(slice(*span) for span in zip(low - first, high - first))
                  for first in (low_a, low_b))
    return a[of_a], b[of_b]
