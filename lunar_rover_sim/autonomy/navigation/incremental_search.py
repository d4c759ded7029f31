"""Shortest ways over a grid of costs, repaired where costs change: D* Lite.

The search runs from the goal. The first one finds the cost from everywhere, so that later ones,
after a change near the rover, look at cells near the rover alone, however far the goal is.

Source: Koenig and Likhachev, D* Lite, AAAI 2002, the optimised version (figure 4).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled

Cell = tuple[int, int]
_DIAGONAL = math.sqrt(2.0)
# Counts of a search: cells in the heap, cells looked at.
_EXPANDED = 1


class IncrementalSearch:
    """Cheapest ways of eight directions from any cell to a goal.

    A step between two cells costs its length in cells times the mean of their costs, which are
    at least 1; infinite cells are not entered.

    Attributes:
        expanded: Cells looked at so far.
    """

    def __init__(self, cost: NDArray[np.float32], goal: Cell) -> None:
        """Begin a search; it shares the (rows, columns) costs, which `changed` must tell of."""
        self._cost = cost
        self._columns = cost.shape[1]
        self._goal = goal
        count = cost.size
        self._g = np.full(count, np.inf)
        self._rhs = np.full(count, np.inf)
        self._rhs[self._index(goal)] = 0.0
        self._keys = np.empty((count, 2))
        self._heap = np.empty(count, np.int32)
        self._place = np.full(count, -1, np.int32)
        self._counts = np.zeros(2, np.int64)
        self._added = 0.0                   # to keys, as the rover moves: k_m
        self._start: Cell | None = None

    @property
    def expanded(self) -> int:
        """Cells looked at so far."""
        return int(self._counts[_EXPANDED])

    def way(self, start: Cell) -> NDArray[np.int64] | None:
        """Return the cells (n, 2) of the cheapest way from a cell to the goal; None without one.

        Rows and columns; both ends are on it.
        """
        if not np.isfinite(self._cost[start]) or not np.isfinite(self._cost[self._goal]):
            return None
        is_first = self._start is None
        if self._start is None:
            _insert(self._heap, self._place, self._keys, self._counts, self._index(self._goal),
                    _between(start, self._goal), 0.0)
        else:
            self._added += _between(self._start, start)
        self._start = start
        _settle(self._cost, self._g, self._rhs, self._keys, self._heap, self._place,
                self._counts, *start, self._added, is_first)
        cells = _descent(self._cost, self._g, *start, self._index(self._goal))
        if not len(cells):
            return None
        return np.stack([cells // self._columns, cells % self._columns], axis=-1)

    def cost_from(self, cell: Cell) -> float:
        """Return the cost of the way from a cell that `way` started from [cells]."""
        return float(self._rhs[self._index(cell)])

    def changed(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> None:
        """Take in that the costs of some cells have changed."""
        if self._start is not None:
            _note(self._cost, self._g, self._rhs, self._keys, self._heap, self._place,
                  self._counts, np.asarray(rows, np.int64), np.asarray(columns, np.int64),
                  *self._start, self._added, self._index(self._goal))

    def _index(self, cell: Cell) -> int:
        return cell[0] * self._columns + cell[1]


def _between(a: Cell, b: Cell) -> float:
    off = sorted(abs(p - q) for p, q in zip(a, b))
    return off[1] + (_DIAGONAL - 1.0) * off[0]


@compiled
def _less(a0, a1, b0, b1):
    return a0 < b0 or (a0 == b0 and a1 < b1)


@compiled
def _up(heap, place, keys, at):
    cell = heap[at]
    while at > 0:
        parent = (at - 1) // 2
        other = heap[parent]
        if not _less(keys[cell, 0], keys[cell, 1], keys[other, 0], keys[other, 1]):
            break
        heap[at], place[other] = other, at
        at = parent
    heap[at], place[cell] = cell, at


@compiled
def _down(heap, place, keys, size, at):
    cell = heap[at]
    while True:
        child = 2 * at + 1
        if child >= size:
            break
        other = heap[child]
        if child + 1 < size:
            second = heap[child + 1]
            if _less(keys[second, 0], keys[second, 1], keys[other, 0], keys[other, 1]):
                child, other = child + 1, second
        if not _less(keys[other, 0], keys[other, 1], keys[cell, 0], keys[cell, 1]):
            break
        heap[at], place[other] = other, at
        at = child
    heap[at], place[cell] = cell, at


@compiled
def _insert(heap, place, keys, counts, cell, key0, key1):
    """Put a cell in the heap, or move it to a new key."""
    keys[cell, 0], keys[cell, 1] = key0, key1
    at = place[cell]
    if at < 0:
        at = counts[0]
        counts[0] += 1
        heap[at] = cell
        place[cell] = at
    _up(heap, place, keys, at)
    _down(heap, place, keys, counts[0], place[cell])


@compiled
def _remove(heap, place, keys, counts, cell):
    at = place[cell]
    counts[0] -= 1
    last = heap[counts[0]]
    place[cell] = -1
    if last != cell:
        heap[at] = last
        place[last] = at
        _up(heap, place, keys, at)
        _down(heap, place, keys, counts[0], place[last])


@compiled
def _step(cost, r, c, i, j):
    """Return what a step between two neighbours costs."""
    length = math.sqrt(2.0) if r != i and c != j else 1.0
    return length * 0.5 * (float(cost[r, c]) + float(cost[i, j]))


@compiled
def _rest(r, c, row, column):
    """Return the least cost between a cell and the rover."""
    a, b = abs(r - row), abs(c - column)
    return max(a, b) + (math.sqrt(2.0) - 1.0) * min(a, b)


@compiled
def _best_of(cost, g, r, c):
    """Return the least cost from a cell over its neighbours."""
    rows, columns = cost.shape
    best = math.inf
    if not math.isfinite(cost[r, c]):
        return best
    for i in range(max(r - 1, 0), min(r + 2, rows)):
        for j in range(max(c - 1, 0), min(c + 2, columns)):
            if i != r or j != c:
                best = min(best, g[i * columns + j] + _step(cost, r, c, i, j))
    return best


@compiled
def _update(cost, g, rhs, keys, heap, place, counts, r, c, row, column, added):
    """Put a cell in the heap whose cost is not what its neighbours say, or take it out."""
    cell = r * cost.shape[1] + c
    if g[cell] != rhs[cell]:
        least = min(g[cell], rhs[cell])
        _insert(heap, place, keys, counts, cell, least + _rest(r, c, row, column) + added, least)
    elif place[cell] >= 0:
        _remove(heap, place, keys, counts, cell)


@compiled
def _settle(cost, g, rhs, keys, heap, place, counts, row, column, added, everywhere):
    """Look at cells until the cost from the rover's cell, or from everywhere, is known."""
    rows, columns = cost.shape
    start = row * columns + column
    while counts[0] > 0:
        cell = heap[0]
        key0, key1 = keys[cell, 0], keys[cell, 1]
        least = min(g[start], rhs[start])
        if not everywhere and not _less(key0, key1, least + added, least) \
                and rhs[start] <= g[start]:
            break
        counts[1] += 1
        r, c = cell // columns, cell % columns
        own = min(g[cell], rhs[cell])
        now = own + _rest(r, c, row, column) + added
        if _less(key0, key1, now, own):
            _insert(heap, place, keys, counts, cell, now, own)
        elif g[cell] > rhs[cell]:
            g[cell] = rhs[cell]
            _remove(heap, place, keys, counts, cell)
            for i in range(max(r - 1, 0), min(r + 2, rows)):
                for j in range(max(c - 1, 0), min(c + 2, columns)):
                    other = i * columns + j
                    if other != cell:
                        over = g[cell] + _step(cost, r, c, i, j)
                        if over < rhs[other]:
                            rhs[other] = over
                            _update(cost, g, rhs, keys, heap, place, counts, i, j, row, column,
                                    added)
        else:
            old = g[cell]
            g[cell] = math.inf
            for i in range(max(r - 1, 0), min(r + 2, rows)):
                for j in range(max(c - 1, 0), min(c + 2, columns)):
                    other = i * columns + j
                    if other == cell:
                        if rhs[cell] != 0.0:
                            rhs[cell] = _best_of(cost, g, r, c)
                    elif rhs[other] == old + _step(cost, r, c, i, j) and rhs[other] != 0.0:
                        rhs[other] = _best_of(cost, g, i, j)
                    _update(cost, g, rhs, keys, heap, place, counts, i, j, row, column, added)


@compiled
def _note(cost, g, rhs, keys, heap, place, counts, changed_rows, changed_columns, row, column,
          added, goal):
    """Find anew what costs around changed cells say."""
    rows, columns = cost.shape
    for k in range(len(changed_rows)):
        r, c = changed_rows[k], changed_columns[k]
        for i in range(max(r - 1, 0), min(r + 2, rows)):
            for j in range(max(c - 1, 0), min(c + 2, columns)):
                if i * columns + j != goal:
                    rhs[i * columns + j] = _best_of(cost, g, i, j)
                    _update(cost, g, rhs, keys, heap, place, counts, i, j, row, column, added)


@compiled
def _descent(cost, g, row, column, goal):
    """Return the cells from the rover's on along which the cost falls; none without a way."""
    rows, columns = cost.shape
    cells = np.empty(cost.size, np.int64)
    r, c, count = row, column, 0
    while count < cost.size:
        cells[count] = r * columns + c
        count += 1
        if r * columns + c == goal:
            return cells[:count].copy()
        best, best_r, best_c = math.inf, -1, -1
        for i in range(max(r - 1, 0), min(r + 2, rows)):
            for j in range(max(c - 1, 0), min(c + 2, columns)):
                if i != r or j != c:
                    over = g[i * columns + j] + _step(cost, r, c, i, j)
                    if over < best:
                        best, best_r, best_c = over, i, j
        if best_r < 0:
            break
        r, c = best_r, best_c
    return cells[:0].copy()
