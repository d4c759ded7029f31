"""Indirect light: what lit ground scatters into shadows, once.

From every point of a coarsened height grid the relief is scanned along a few azimuths. A piece of
ground that rises above all nearer ones, from angle a1 to a2 over the point's own plane, is seen
under the projected solid angle (sin^2 a2 - sin^2 a1) / 2 per radian of azimuth. It sends its
radiance, taken as diffuse, if the sun sees it. Light that is scattered twice (a tenth as much,
with a ground albedo of 0.1) and the direction dependence of the scattering ground are left out.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import os

import cv2
import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

_AZIMUTHS = 12
_STEPS = 20             # distances double every third step


def indirect_light(heights_m: F32, cell_m: float, lit: F32, direction: NDArray[np.float64],
                   albedo: float) -> tuple[F32, F32]:
    """Return (irradiance, surroundings), both (n, n) and per normal irradiance of the sun.

    The irradiance is what other ground sends to each point of the grid, the surroundings are the
    exitance of the ground around it, of which upright faces see one half.

    Args:
        heights_m: (n, n) heights of the grid [m].
        cell_m: Distance of its samples [m].
        lit: (n, n) share of the sun's disc that is seen.
        direction: (3,) unit vector to the sun.
        albedo: Diffuse albedo of the ground.
    """
    gradient = np.asarray(np.gradient(heights_m, np.float32(cell_m)), np.float32)
    gy, gx = gradient[0], gradient[1]
    facing = (direction[2] - gx * direction[0] - gy * direction[1]) / np.sqrt(1 + gx**2 + gy**2)
    exitance = (albedo * lit * np.maximum(facing, 0.0)).astype(np.float32)
    angles = 2.0 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    total = np.zeros_like(exitance)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # In a fixed order, so that the rounding of the sum is always the same.
        for part in pool.map(lambda angle: _along(heights_m, gx, gy, exitance, cell_m,
                                                  np.cos(angle), np.sin(angle)), angles):
            total += part
    irradiance = total * np.float32(2.0 / _AZIMUTHS)
    # A mean over about a metre with the weights of an upright face, which sees mostly near ground.
    surroundings = 0.5 * cv2.GaussianBlur(exitance, (0, 0), max(0.4 / cell_m, 0.6)) \
        + 0.5 * cv2.GaussianBlur(exitance, (0, 0), max(1.6 / cell_m, 1.2))
    return irradiance, surroundings


def _along(z: F32, gx: F32, gy: F32, exitance: F32, cell_m: float, c: float, s: float) -> F32:
    """Return sum of exitance (sin^2 a2 - sin^2 a1) / 2 along one azimuth."""
    n = z.shape[0]
    slope = (gx * c + gy * s).astype(np.float32)
    highest = np.zeros_like(z)          # sine squared of the highest angle, over the own plane
    total = np.zeros_like(z)
    previous = exitance.copy()
    last = (0, 0)
    for k in range(_STEPS):
        distance = 1.4 * 2.0**(k / 3.0)
        di, dj = int(round(distance * s)), int(round(distance * c))
        if (di, dj) == last or max(abs(di), abs(dj)) >= n // 2:
            continue
        last = (di, dj)
        to = (slice(max(0, -di), n - max(0, di)), slice(max(0, -dj), n - max(0, dj)))
        of = (slice(max(0, di), n - max(0, -di)), slice(max(0, dj), n - max(0, -dj)))
        reach = np.float32(np.hypot(di, dj) * cell_m)
        rise = np.maximum((z[of] - z[to]) / reach - slope[to], np.float32(0.0))
        rise *= rise
        sine2 = rise / (np.float32(1.0) + rise)
        gain = np.maximum(sine2 - highest[to], np.float32(0.0))
        highest[to] += gain
        # The ground between two samples is taken to be as bright as their mean.
        gain *= exitance[of] + previous[to]
        total[to] += gain
        previous[to] = exitance[of]
    return np.float32(0.25) * total
