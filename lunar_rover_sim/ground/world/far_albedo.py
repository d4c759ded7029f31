"""Albedo of the ground beyond the fine grid: patches of all sizes, and fresh craters with rays.

It is not stored: the recipe and the catalogue of craters give it.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.ground.world import stamping
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World

F32 = NDArray[np.float32]

RECIPE = 1              # rises with every change of what `far_albedo` returns
# Wavelengths of the patches and their parts of the RMS variation; those of the fine ground are
# 0.4 to 6.4 m.
_PATCHES = ((1.6, 0.4), (6.4, 0.55), (25.6, 0.55), (102.4, 0.4))
_PITCH = 0.125          # of the lattice of a patch, in wavelengths
_CELLS = 16.0           # least cells per wavelength on a level that shows it
_FADE_M = 3.0           # beyond the fine ground, whose factor is 1 at its border
_RAY = 0.5              # brightness of rays relative to the crater's surroundings


def far_albedo(world: World, k: int) -> F32:
    """Return the (n, n) albedo factor on the samples of level k > 0; its mean is about 1.

    A world whose recipe has no seed has the factor 1 everywhere.
    """
    grid, config = world.levels[k], world.config.albedo
    change = np.zeros((grid.n, grid.n), np.float32)
    if world.config.seed < 0:
        return change + np.float32(1.0)
    if config.variation > 0.0:
        for wavelength, part in _PATCHES:
            if wavelength >= _CELLS * grid.cell_m:
                change += np.float32(config.variation * part) * _patches(world, wavelength, grid)
    if config.fresh_crater > 0.0:
        stamping.brighten(change, grid.cell_m, world.craters, config.fresh_crater)
        stamping.add_rays(change, grid.cell_m, world.craters, _RAY * config.fresh_crater)
    axis = np.abs(np.arange(grid.n) - 0.5 * (grid.n - 1)) * grid.cell_m
    away = np.maximum(axis[:, None], axis) - world.ground.half_extent_m
    change *= np.clip(away / _FADE_M, 0.0, 1.0).astype(np.float32)
    return np.clip(np.float32(1.0) + change, 0.4, 1.8)


def _patches(world: World, wavelength_m: float, grid: HeightGrid) -> F32:
    """Return one wavelength's variation, RMS 1, on a grid; all levels see the same patches."""
    widest = max((g for g in world.levels if wavelength_m >= _CELLS * g.cell_m),
                 key=lambda g: g.half_extent_m)
    pitch = _PITCH * wavelength_m
    n = 2 * int(np.ceil(widest.half_extent_m / pitch)) + 9
    rng = np.random.default_rng([world.config.seed, *b'far albedo', round(10 * wavelength_m)])
    noise = cv2.GaussianBlur(rng.standard_normal((n, n), dtype=np.float32), (0, 0),
                             0.25 / _PITCH)
    scale = 1.0 / float(noise.std())
    step = grid.cell_m / pitch
    first = 0.5 * (n - 1) - step * 0.5 * (grid.n - 1)
    return np.asarray(cv2.warpAffine(
        scale * noise, np.array([[step, 0.0, first], [0.0, step, first]]), (grid.n, grid.n),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP), np.float32)
