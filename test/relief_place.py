"""Where the tiles of relief are read, in plain NumPy, as image/rendering/relief_rows.py does."""

import numpy as np

ZONE = 0.1


def places(xy):
    """Return bent places (n, 2), both tiles' shifts (n, 4) of the first and the second cell, and
    how much nearer the first one is (n,), over the zone."""
    wave = (0.93 * xy[:, ::-1]) % 1.0 - 0.5
    p = xy + 0.2 * wave * (1.0 - 2.0 * np.abs(wave))
    q = np.stack([p[:, 0] - 0.57735027 * p[:, 1], 1.15470054 * p[:, 1]], axis=1)
    corner = np.floor(q).astype(np.int64)
    f = q - corner
    upper = f.sum(axis=1) > 1.0
    weights = np.where(upper[:, None],
                       np.stack([f.sum(axis=1) - 1.0, 1.0 - f[:, 1], 1.0 - f[:, 0]], axis=1),
                       np.stack([1.0 - f.sum(axis=1), f[:, 0], f[:, 1]], axis=1))
    cells = corner[:, None] + np.array([[0, 0], [1, 0], [0, 1]])
    cells[upper, 0] += 1
    order = np.argsort(-weights, axis=1, kind='stable')
    pick = np.arange(len(xy))
    lead = (weights[pick, order[:, 0]] - weights[pick, order[:, 1]]) / ZONE
    return p, _shifts(cells[pick, order[:, 0]]), _shifts(cells[pick, order[:, 1]]), lead


def _shifts(cells):
    """Return the (n, 4) places of both tiles in (n, 2) cells, over their periods."""
    x, y = (axis.astype(np.uint32) for axis in cells.T)
    h = x * np.uint32(0x9e3779b9) + y * np.uint32(0x85ebca6b)
    h = (h ^ (h >> 16)) * np.uint32(0x7feb352d)
    h = (h ^ (h >> 15)) * np.uint32(0x846ca68b)
    h ^= h >> 16
    return np.stack([h >> bits & 0xff for bits in (0, 8, 16, 24)], axis=1) / 256.0


def bilinear(values, at):
    """Return periodic (n, n, ...) values at (m, 2) places, over the period."""
    n = len(values)
    place = at * n - 0.5
    whole = np.floor(place).astype(int)
    x, y = (place - whole).T.reshape(2, -1, *(1,) * (values.ndim - 2))
    i, j = whole.T % n
    i1, j1 = (i + 1) % n, (j + 1) % n
    return ((values[j, i] * (1 - x) + values[j, i1] * x) * (1 - y)
            + (values[j1, i] * (1 - x) + values[j1, i1] * x) * y)
