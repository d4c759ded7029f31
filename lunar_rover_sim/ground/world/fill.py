"""Filling gaps in grids of heights.

Both solvers relax from coarse to fine grids. A direct sparse solver is not used: its result
depends on the linear algebra library and its threads, and so would the hash of the world.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled, inlined


def harmonic_fill(values: NDArray[np.float32], known: NDArray[np.bool_],
                  sweeps: int = 12) -> NDArray[np.float32]:
    """Return the values with the unknown ones filled: smooth, and continuous with the known ones.

    The filling approximates the solution of Laplace's equation: each grid starts from that of half
    its resolution and is relaxed `sweeps` times or more.
    """
    if known.all() or not known.any():
        return np.where(known, values, 0).astype(np.float32)
    ny, nx = values.shape
    weight = known.astype(np.float32)
    if min(ny, nx) <= 4:
        return np.where(known, values, (values * weight).sum() / weight.sum()).astype(np.float32)
    pad = ((0, ny % 2), (0, nx % 2))
    total = np.pad(values * weight, pad)
    total = total[::2, ::2] + total[1::2, ::2] + total[::2, 1::2] + total[1::2, 1::2]
    count = np.pad(weight, pad)
    count = count[::2, ::2] + count[1::2, ::2] + count[::2, 1::2] + count[1::2, 1::2]
    mean = (total / np.maximum(count, 1.0)).astype(np.float32)
    coarse = harmonic_fill(mean, count > 0.0, sweeps * 2)
    y = (np.arange(ny) - 0.5) / 2.0
    x = (np.arange(nx) - 0.5) / 2.0
    filled = _bilinear(coarse, y, x)
    filled[known] = values[known]
    free = ~known
    for _ in range(min(sweeps, 200)):
        around = np.pad(filled, 1, mode='edge')
        beside = 0.25 * (around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2]
                         + around[1:-1, 2:])
        np.copyto(filled, beside, where=free)
    return filled


def plate_fill(values: NDArray[np.float32], known: NDArray[np.bool_],
               tension: float, sweeps: int = 200) -> NDArray[np.float32]:
    """Return the values with the unknown ones filled by a thin plate under tension.

    It approximates (L - tension) L u = 0 (Smith & Wessel, Gridding with continuous curvature
    splines in tension, Geophysics 55 (3), 1990) from coarse to fine grids. L is the discrete
    Laplacian, and tension is (cell / length)^2, where length is the distance over which the plate
    settles.
    """
    if known.all() or not known.any():
        return harmonic_fill(values, known)
    pyramid = [(values, known)]
    while min(pyramid[-1][0].shape) > 12 and pyramid[-1][1].sum() > 16:
        v, k = pyramid[-1]
        pyramid.append((v[::2, ::2], k[::2, ::2]))
    for depth, (v, k) in reversed(list(enumerate(pyramid))):
        if depth == len(pyramid) - 1:
            u = harmonic_fill(np.ascontiguousarray(v), k)
        else:
            u = _bilinear(u, np.arange(v.shape[0]) / 2.0, np.arange(v.shape[1]) / 2.0)
        u[k] = v[k]
        t = np.float32(tension * 4.0 ** depth)
        rate = np.where(k, np.float32(0.0), np.float32(1.0 / (36.0 + 5.0 * t)))
        _relax(u, rate, t, sweeps * (1 + depth))
    return u


@compiled
def _relax(u: np.ndarray, rate: np.ndarray, tension: np.float32, sweeps: int) -> None:
    """Relax a plate (rows, columns) in place. Beyond its edges it goes on as it ends."""
    rows, columns = u.shape
    around = np.empty((rows + 2, columns + 2), np.float32)
    bend = np.empty_like(around)
    around[1:-1, 1:-1] = u
    for _ in range(sweeps):
        _go_on(around)
        for i in range(1, rows + 1):
            for j in range(1, columns + 1):
                bend[i, j] = _laplacian(around, i, j)
        _go_on(bend)
        for i in range(1, rows + 1):
            for j in range(1, columns + 1):
                change = _laplacian(bend, i, j) - bend[i, j] * tension
                around[i, j] -= change * rate[i - 1, j - 1]
    u[:] = around[1:-1, 1:-1]


@inlined
def _go_on(around: np.ndarray) -> None:
    around[0], around[-1] = around[1], around[-2]
    around[:, 0], around[:, -1] = around[:, 1], around[:, -2]


@inlined
def _laplacian(u: np.ndarray, i: int, j: int) -> np.float32:
    beside = u[i - 1, j] + u[i + 1, j] + u[i, j - 1] + u[i, j + 1]
    return beside - np.float32(4.0) * u[i, j]


def _bilinear(values: NDArray, y: NDArray, x: NDArray) -> NDArray[np.float32]:
    def along(v: NDArray, at: NDArray) -> NDArray:
        at = np.clip(at, 0.0, len(v) - 1.0)
        low = np.minimum(at.astype(int), len(v) - 2)
        part = (at - low).astype(np.float32)[:, None]
        return v[low] * (1 - part) + v[low + 1] * part
    return np.ascontiguousarray(along(along(values, y).T, x).T, np.float32)
