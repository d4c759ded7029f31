"""Albedo of the ground: patches of all sizes, grain, fresh craters; the same in all windows.

That of the fine ground is stored in the world. That of the coarse levels is not: the recipe and
the catalogue of craters give it.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
from numpy.typing import NDArray
import scipy  # its parts when they are used

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world import levels as nest
from lunar_rover_sim.ground.world import spline, streams
from lunar_rover_sim.ground.world.block_means import at_middles, field_for, smoothed
from lunar_rover_sim.ground.world.config import AlbedoConfig, CraterConfig, WorldConfig
from lunar_rover_sim.ground.world.craters import Craters, density_per_m2
from lunar_rover_sim.ground.world.grid import ALBEDO_STEP, on_lattice, round_to
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rays import add_rays, brighten
from lunar_rover_sim.ground.world.relief import smoothstep
from lunar_rover_sim.ground.world.spline import Area

F32 = NDArray[np.float32]

RECIPE = 2              # rises with every change of what `far_albedo` returns
# Wavelengths of the patches and their parts of the RMS variation, on the fine ground: from 3 dm to
# several metres, smaller ones are fainter; and beyond it.
_FINE = ((6.4, 0.75), (1.6, 0.55), (0.4, 0.35))
_FAR = ((1.6, 0.4), (6.4, 0.55), (25.6, 0.55), (102.4, 0.4))
_PITCH = 0.125          # of the lattice of a patch, in wavelengths
_NARROW, _BROAD = 2.0, 4.0      # deviations of the Gaussians whose difference filters it [cells]
_TAPS = 14              # of that filter, to either side
_CELLS = 16.0           # least cells per wavelength on a level that shows it
_FADE_M = 3.0           # beyond the fine ground, whose factor is 1 at its border
_RAY = 0.5              # brightness of rays relative to the crater's surroundings
# Craters of this diameter and more have their mean brightness taken off block by block, smaller
# ones everywhere alike.
BLOCK_CRATER_M = 4.8


def fine_change(config: WorldConfig, first: tuple[int, int], shape: tuple[int, int],
                craters: Craters) -> F32:
    """Return by how much the albedo factor differs from 1 on a rectangle of the fine ground.

    Its mean is 0 over blocks of 51.2 m, by construction.

    Args:
        first: Column and row at which it begins.
        shape: Its rows and columns.
        craters: All that reach `block_means.field_for` it, and all smaller than `BLOCK_CRATER_M`
            that reach it.
    """
    cell = config.cell_m
    change = np.zeros(shape, np.float32)
    if config.albedo.variation > 0.0:
        for wavelength, part in _FINE:
            change += np.float32(config.albedo.variation * part) * _patches(
                config.seed, wavelength, first, shape, cell)
    if config.albedo.grain > 0.0:
        # Uniform, not normal: exact on every machine, and of the same RMS.
        grain = streams.blocks(config.seed, 'grain', first, shape)
        grain -= np.float32(0.5)
        grain *= np.float32(config.albedo.grain * math.sqrt(12.0))
        change += grain
    if config.albedo.fresh_crater > 0.0:
        brighten(Area(change, first, cell), craters, config.albedo.fresh_crater)
        change -= _mean_of_craters(config, first, shape, craters).astype(np.float32)
    return change


def fine_albedo(change: F32) -> F32:
    """Return the albedo factor of a window, which is 1 at its border, from (n, n) changes."""
    edge = nest.fade(len(change))
    albedo = np.clip(1.0 + change * (edge[:, None] * edge), 0.4, 1.8, dtype=np.float32)
    round_to(albedo, ALBEDO_STEP)
    albedo.setflags(write=False)
    return albedo


def _mean_of_craters(config: WorldConfig, first: tuple[int, int], shape: tuple[int, int],
                     craters: Craters) -> Array:
    """Return the mean brightness that fresh craters add around each sample."""
    small = _mean_of_small(config.craters, config.albedo, 6.0 * config.cell_m)
    large = craters.select(craters.diameter_m >= BLOCK_CRATER_M)
    field = field_for(spline.box_of(first, shape, config.cell_m))
    brighten(field, dataclasses.replace(
        large, position_m=at_middles(large.position_m, field.cell_m)), config.albedo.fresh_crater)
    x, y = ((f + np.arange(n, dtype=float)) * config.cell_m for f, n in zip(first, shape[::-1]))
    return on_lattice(small + smoothed(field, x, y[:, None]), ALBEDO_STEP)


def _mean_of_small(craters: CraterConfig, albedo: AlbedoConfig, least_m: float) -> float:
    """Return the mean brightness that craters below `BLOCK_CRATER_M` add, as `brighten` does."""
    low, high = max(least_m, craters.min_diameter_m), min(BLOCK_CRATER_M, craters.max_diameter_m)
    if low >= high or craters.density == 0.0:
        return 0.0
    edges = np.geomspace(low, high, 65)
    number = np.array([density_per_m2(craters, edge) for edge in edges])
    area = np.sum((number[:-1] - number[1:]) * edges[:-1] * edges[1:]) / 4.0    # of R^2
    rho = np.linspace(0.0, 3.5, 351)
    fall = np.exp(-0.5 * (np.maximum(rho - 0.8, 0.0) / 0.9) ** 2) * smoothstep(3.5 - rho)
    share = np.linspace(0.0, 1.0, 2001)
    age = share ** (1.0 / craters.age_exponent)
    strength = np.mean(np.where(age < 0.2, (1.0 - age / 0.2) ** 2, 0.0))
    return float(albedo.fresh_crater * area * strength
                 * np.sum(2.0 * np.pi * rho * fall) * (rho[1] - rho[0]))


def far_albedo(world: World, k: int) -> F32:
    """Return the (n, n) albedo factor on the samples of level k > 0; its mean is about 1.

    A world whose recipe has no seed has the factor 1 everywhere.
    """
    grid = world.levels[k]
    if world.config.seed < 0:
        return np.ones((grid.n, grid.n), np.float32)
    middle = np.add(grid.middle_m, world.origin_m)
    first = middle / grid.cell_m - 0.5 * (grid.n - 1)
    corner = np.asarray(grid.middle_m) - 0.5 * (grid.n - 1) * grid.cell_m
    change = coarse_change(world.config, (first[0], first[1]), (grid.n, grid.n), grid.cell_m,
                           dataclasses.replace(world.craters,
                                               position_m=world.craters.position_m - corner))
    axis = np.abs(np.arange(grid.n) - 0.5 * (grid.n - 1)) * grid.cell_m
    away = np.maximum(axis[:, None], axis) - world.ground.half_extent_m
    change *= np.clip(away / _FADE_M, 0.0, 1.0).astype(np.float32)
    return np.clip(np.float32(1.0) + change, 0.4, 1.8)


def coarse_change(config: WorldConfig, first: tuple[float, float], shape: tuple[int, int],
                  cell_m: float, craters: Craters) -> F32:
    """Return by how much the albedo factor differs from 1 on a rectangle of coarse cells.

    Args:
        first: Column and row at which it begins, on the lattice of the site.
        shape: Its rows and columns.
        craters: Those whose soil or rays reach it; places count from its first sample.
    """
    change = np.zeros(shape, np.float32)
    if config.albedo.variation > 0.0:
        for wavelength, part in _FAR:
            if wavelength >= _CELLS * cell_m:
                change += np.float32(config.albedo.variation * part) * _patches(
                    config.seed, wavelength, first, shape, cell_m)
    if config.albedo.fresh_crater > 0.0:
        field = Area(change, (0, 0), cell_m)
        brighten(field, craters, config.albedo.fresh_crater)
        add_rays(field, craters, _RAY * config.albedo.fresh_crater)
    return change


def _patches(seed: int, wavelength_m: float, first: tuple[float, float], shape: tuple[int, int],
             cell_m: float) -> F32:
    """Return one wavelength's variation of RMS 1 and mean 0 on a rectangle of a lattice."""
    pitch = _PITCH * wavelength_m
    places = [(f + np.arange(n)) * cell_m / pitch for f, n in zip(first, shape[::-1])]
    begin = [math.floor(place[0]) - 1 - _TAPS for place in places]
    # One more than the spline needs: a fraction that is nearly 1 may be rounded up below.
    count = [math.floor(place[-1]) + 4 + _TAPS - b for place, b in zip(places, begin)]
    noise = streams.blocks(seed, f'albedo {wavelength_m:g} m', (begin[0], begin[1]),
                           (count[1], count[0]), 64).astype(np.float64)
    noise -= 0.5
    noise *= math.sqrt(12.0)
    narrow, broad, scale = _filters()
    smooth = _filtered(noise, narrow) - _filtered(noise, broad)
    smooth = on_lattice(scale * smooth, 2.0**-20)
    # Fractions come from places on the site, so that all windows give one result.
    columns, rows = ((np.floor(place) - b - _TAPS) + (place - np.floor(place))
                     for place, b in zip(places, begin))
    return spline.evaluated(smooth, columns, rows)


def _filtered(values: Array, kernel: Array) -> Array:
    """Return the values filtered along both axes, without the taps at the border."""
    for axis in (0, 1):
        values = scipy.ndimage.correlate1d(values, kernel, axis=axis, mode='constant')
    return np.asarray(values[_TAPS:-_TAPS, _TAPS:-_TAPS])


@functools.cache
def _filters() -> tuple[Array, Array, float]:
    """Return two Gaussians, and the factor that makes the spline of their difference of RMS 1.

    The difference has no mean, so neither have patches over many wavelengths.
    """
    k = np.arange(-_TAPS, _TAPS + 1)
    narrow, broad = (np.exp(-0.5 * (k / sigma) ** 2) for sigma in (_NARROW, _BROAD))
    narrow, broad = narrow / narrow.sum(), broad / broad.sum()
    products = np.zeros(3)
    phases = (np.arange(16) + 0.5) / 16.0
    for t in phases:
        taps = np.array([w.item() for w in spline.weights(np.array(t))])
        a, b = np.convolve(narrow, taps), np.convolve(broad, taps)
        products += np.array([a @ a, a @ b, b @ b]) / len(phases)
    variance = products[0] ** 2 - 2.0 * products[1] ** 2 + products[2] ** 2
    return narrow, broad, float(variance ** -0.5)
