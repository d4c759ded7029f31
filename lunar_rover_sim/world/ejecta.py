"""Rays of fresh craters: narrow sectors in which ejected rocks and bright soil lie farther out.

Rays of lunar craters reach several radii and are narrow and irregular. Their number, width and
reach here are choices that look like those of metre- to decametre-sized craters in orbital images.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.world.craters import Craters
from lunar_rover_sim.world.grid import window_of

F32 = NDArray[np.float32]

FRESH = 0.25            # greatest age of a crater with rays, in lifetimes
REACH = 6.0             # radii that rays reach
_LEAST_M = 3.0          # least diameter of a crater with rays
_FEWEST, _MOST = 5, 9   # rays of one crater
_WIDTH_RAD = (0.05, 0.14)
_FALL = (1.4, 3.0)      # radii over which rays fade to 1 / e
_HEADINGS = 512


def add_rays(field: NDArray[np.floating], cell_m: float, craters: Craters, amount: float) -> None:
    """Add the rays of all craters to an (n, n) field centred on the origin, in place.

    Args:
        cell_m: Distance of its samples.
        amount: What is added at the rim of a fresh crater, where a ray begins. The rays depend on
            the crater alone, so that all fields show the same ones.
    """
    n = len(field)
    for i in np.flatnonzero((craters.age < FRESH) & (craters.diameter_m > _LEAST_M)):
        radius = 0.5 * craters.diameter_m[i] / cell_m
        x, y = craters.position_m[i] / cell_m + 0.5 * (n - 1)
        window = window_of(x, y, REACH * radius, n)
        if window is None:
            continue
        dx = ((np.arange(window[1].start, window[1].stop) - x) / radius).astype(np.float32)
        dy = ((np.arange(window[0].start, window[0].stop) - y) / radius).astype(np.float32)
        dy = dy[:, None]
        strength, fall = _star(craters.position_m[i])
        rho = np.hypot(dx, dy)
        turn = np.arctan2(dy, dx) * np.float32(0.5 * _HEADINGS / np.pi) + _HEADINGS // 2
        rays = strength[turn.astype(np.int32) % _HEADINGS]
        rays *= np.exp(np.minimum((np.float32(1.2) - rho) / fall, np.float32(0.0)))
        rays *= np.clip(rho - np.float32(0.8), 0.0, 1.0)
        rays *= np.clip(np.float32(REACH) - rho, 0.0, 1.0)
        field[window] += np.float32(amount * (1.0 - craters.age[i] / FRESH)) * rays


def _star(position_m: NDArray[np.float64]) -> tuple[F32, np.float32]:
    """Return the strength of a crater's rays over the headings from -pi, and their fall."""
    x, y = np.rint(1e3 * position_m).astype(np.int64)
    rng = np.random.default_rng([int(x) & 0xFFFFFFFF, int(y) & 0xFFFFFFFF, 5])
    heading = np.linspace(-np.pi, np.pi, _HEADINGS, endpoint=False)
    strength = np.zeros(_HEADINGS)
    for middle in rng.uniform(-np.pi, np.pi, int(rng.integers(_FEWEST, _MOST + 1))):
        turn = np.remainder(heading - middle + np.pi, 2.0 * np.pi) - np.pi
        strength += np.exp(-0.5 * (turn / rng.uniform(*_WIDTH_RAD)) ** 2)
    return strength.astype(np.float32), np.float32(rng.uniform(*_FALL))
