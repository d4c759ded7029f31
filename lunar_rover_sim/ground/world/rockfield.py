"""The population of rocks: how many of each size, where they lie, and how deep."""

from __future__ import annotations

import logging
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
import scipy  # its parts when they are used

from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, product_wxyz
from lunar_rover_sim.ground.world.config import RockConfig, SITES
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.grid import (ALBEDO_STEP, height_step_m, HeightGrid, on_lattice,
                                               round_to, significant, window_of)
from lunar_rover_sim.ground.world.rocks import Rocks, RockShape

logger = logging.getLogger(__name__)

_FILLET_CELLS = 5.0     # of the grid, along the diameter of the smallest rock with a fillet
_POSITION_STEP_M, _ORIENTATION_STEP = 2.0**-20, 2.0**-24


class Elevation(Protocol):
    """Ground to lay rocks on: a height grid or a whole world."""

    def height_at(self, xy_m: ArrayLike) -> Array:
        """Return the heights [m] at (..., 2) positions [m]."""


def decay_per_m(config: RockConfig) -> float:
    """Return q [1/m] of F(>D) = k exp(-q D)."""
    return config.decay_per_m or 0.5648 + 0.01258 / config.abundance


def number_per_m2(config: RockConfig, diameter_m: Array) -> Array:
    """Return the cumulative number N(>D) per m2, up to the largest diameter.

    The area of a rock is pi D^2 / 4, so dN = -4 / (pi D^2) dF = 4 k q / pi exp(-q D) / D^2 dD
    (Golombek & Rapp 1997 integrate it in the same way). At a site of `config.SITES` it is the
    power law that was counted there.
    """
    if config.site:
        factor, exponent = SITES[config.site]
        sizes = np.minimum(np.asarray(diameter_m, float), config.max_diameter_m)
        return np.asarray(0.01 * factor * 1000.0**-exponent * (
            sizes**-exponent - config.max_diameter_m**-exponent))
    q = decay_per_m(config)
    edge = np.geomspace(config.min_diameter_m, config.max_diameter_m, 4097)
    density = 4.0 * config.abundance * q / np.pi * np.exp(-q * edge) / edge ** 2
    piece = 0.5 * (density[1:] + density[:-1]) * np.diff(edge)
    above = np.append(np.cumsum(piece[::-1])[::-1], 0.0)
    return np.interp(diameter_m, edge, above)


def size_classes(config: RockConfig) -> Array:
    """Return the diameters [m] that rocks may have, ascending, evenly spaced in the logarithm."""
    edges = np.geomspace(config.min_diameter_m, config.max_diameter_m, config.size_classes + 1)
    return significant(np.sqrt(edges[1:] * edges[:-1]))


def no_rocks(config: RockConfig) -> Rocks:
    """Return an empty field."""
    return _rocks(np.empty(0, int), np.empty(0, int), np.empty((0, 3)), np.empty((0, 4)),
                  np.empty(0), size_classes(config))


def scatter(config: RockConfig, ground: HeightGrid, shapes: tuple[RockShape, ...],
            craters: Craters, clear_radius_m: float, rng: np.random.Generator) -> Rocks:
    """Return rocks laid on the ground.

    The number and the sizes follow the distribution; rocks are denser around the rims of fresh
    craters. Larger rocks are placed first; a smaller one that would overlap them is moved, and
    left out after 12 attempts. No rock lies near the origin, where the rover starts.
    """
    if config.abundance == 0.0 or config.max_number == 0:
        return no_rocks(config)
    side = 2.0 * ground.half_extent_m
    diameter = _diameters(config, side * side, rng)
    classes = size_classes(config)
    size = np.clip(np.searchsorted(np.sqrt(classes[1:] * classes[:-1]), diameter), 0,
                   len(classes) - 1)
    diameter = classes[size]
    cells = int(np.clip(ground.half_extent_m * 2.0 / 0.2, 8, 512))
    density = relative_density(config, ground.half_extent_m, cells, craters)
    xy, kept = _places(diameter, (np.cumsum(density.ravel()), cells), ground, clear_radius_m, rng)
    rocks = laid(config, ground, shapes, xy[kept], size[kept], rng)
    logger.info('%d rocks from %.2g to %.2g m', len(rocks), rocks.diameter_m.min(initial=np.inf),
                rocks.diameter_m.max(initial=0.0))
    return rocks


def laid(config: RockConfig, ground: Elevation, shapes: tuple[RockShape, ...], xy_m: Array,
         size: NDArray[np.integer], rng: np.random.Generator) -> Rocks:
    """Return rocks of given sizes laid on the ground at (m, 2) places.

    Args:
        size: (m,) index into `size_classes`; shape, burial, tilt and albedo are drawn.
    """
    classes = size_classes(config)
    diameter, count = classes[size], len(size)
    shape = rng.integers(0, len(shapes), count)
    # With this beta distribution most rocks are buried shallowly, and some up to the crown.
    buried = rng.beta(2.4, 2.4 * (1.0 - config.burial) / config.burial, count)
    position, orientation = _settle(ground, shapes, shape, diameter, xy_m, buried,
                                    config.max_height, np.radians(config.tilt_deg), rng)
    albedo = np.clip(1.0 + config.albedo_variation * rng.standard_normal(count), 0.6, 1.4)
    return _rocks(shape, size, position, orientation, albedo, classes)


def fillets(config: RockConfig, ground: HeightGrid, rocks: Rocks,
            rng: np.random.Generator) -> HeightGrid:
    """Return ground on which soil has gathered around the feet of rocks.

    Meteoroids throw soil about, and rocks keep what falls beside them: the longer they lie there,
    the higher. It is highest at the rock, and falls to nothing 0.35 diameters away.
    """
    cell, n = ground.cell_m, ground.n
    share = rng.uniform(0.0, 2.0, len(rocks))
    if config.fillet == 0.0 or not np.any(rocks.diameter_m > _FILLET_CELLS * cell):
        return ground
    soil = np.zeros((n, n), np.float32)
    for k in np.flatnonzero(rocks.diameter_m > _FILLET_CELLS * cell):
        diameter = rocks.diameter_m[k]
        x, y = rocks.position_m[k, :2] / cell + 0.5 * (n - 1)
        window = window_of(x, y, 0.85 * diameter / cell, n)
        if window is None:
            continue
        rows, columns = np.ogrid[window]
        away = np.sqrt((columns - x)**2 + (rows - y)**2) * cell / diameter
        outside = np.clip((away - 0.42) / 0.35, 0.0, 1.0)
        height = config.fillet * share[k] * diameter * (1.0 - outside * outside)**2
        soil[window] = np.maximum(soil[window], height)
    heights = ground.heights_m + soil
    round_to(heights, height_step_m(cell))
    heights.setflags(write=False)
    return HeightGrid(heights, cell)


def _diameters(config: RockConfig, area_m2: float, rng: np.random.Generator) -> Array:
    """Return diameters, largest first."""
    grid = np.geomspace(config.min_diameter_m, config.max_diameter_m, 2049)
    above = number_per_m2(config, grid) * area_m2
    count = int(rng.poisson(above[0]))
    kept = min(count, config.max_number)
    diameter = np.interp(rng.uniform(0.0, above[0], count), above[::-1], grid[::-1])
    diameter = np.sort(diameter)[::-1][:kept]
    if kept < count:
        logger.warning('rocks.max_number: %d of %d rocks are left out, all below %.3g m',
                       count - kept, count, diameter.min(initial=np.inf))
    return diameter


def relative_density(config: RockConfig, half_extent_m: float, n: int, craters: Craters) -> Array:
    """Return the (n, n) density of rocks over cells of [-h, h]^2; 1 far from fresh craters."""
    density = np.ones((n, n))
    cell = 2.0 * half_extent_m / n
    fresh = (craters.age < 0.25) & (craters.diameter_m > 0.8)
    for (x, y), diameter, age in zip(craters.position_m[fresh], craters.diameter_m[fresh],
                                     craters.age[fresh]):
        window = window_of((x + half_extent_m) / cell - 0.5, (y + half_extent_m) / cell - 0.5,
                           1.3 * diameter / cell, n)
        if window is None:
            continue
        axis = (np.arange(n) + 0.5) * cell - half_extent_m
        rho = np.hypot(axis[window[1]] - x, (axis[window[0]] - y)[:, None]) / (0.5 * diameter)
        density[window] += (config.near_craters * (1.0 - age / 0.25)
                            * np.exp(-0.5 * ((rho - 1.15) / 0.4) ** 2))
    return density


def _places(diameter: Array, cumulative: tuple[Array, int], ground: HeightGrid,
            clear_radius_m: float, rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
    """Return (m, 2) positions for rocks in descending order of size, and which are valid."""
    total, n = cumulative
    cell = 2.0 * ground.half_extent_m / n
    xy = np.empty((len(diameter), 2))
    todo = np.arange(len(diameter))
    for _ in range(12):
        index = np.searchsorted(total, rng.uniform(0.0, total[-1], len(todo)))
        index = np.minimum(index, n * n - 1)
        corner = np.stack([index % n, index // n], axis=-1)
        xy[todo] = (corner + rng.random((len(todo), 2))) * cell - ground.half_extent_m
        todo = _misplaced(xy, diameter, ground, clear_radius_m)
        if not len(todo):
            break
    kept = np.ones(len(diameter), bool)
    kept[todo] = False
    return xy, kept


def _misplaced(xy: Array, diameter: Array, ground: HeightGrid,
               clear_radius_m: float) -> NDArray[np.int64]:
    """Return the rocks that touch the clearing, the border, or a larger rock."""
    clearing = clear_radius_m + 3.0 * diameter
    bad = np.linalg.norm(xy, axis=1) < clearing
    bad |= np.abs(xy).max(axis=1) > ground.half_extent_m - diameter
    return np.flatnonzero(bad | ~apart(xy, diameter))


def apart(xy: Array, diameter: Array) -> NDArray[np.bool_]:
    """Return which rocks, in descending order of size, overlap no larger one."""
    free = np.ones(len(diameter), bool)
    if not len(diameter):
        return free
    tree = scipy.spatial.cKDTree(xy)
    start = 0
    while start < len(diameter):
        # One query for rocks of similar size; the reach of the largest bounds that of the others.
        stop = int(np.searchsorted(-diameter, -0.6 * diameter[start], side='right'))
        for i, near in zip(range(start, stop),
                           tree.query_ball_point(xy[start:stop], 0.9 * diameter[start])):
            later = np.array([j for j in near if j > i], int)
            if len(later):
                gap = np.linalg.norm(xy[later] - xy[i], axis=1)
                free[later[gap < 0.45 * (diameter[later] + diameter[i])]] = False
        start = stop
    return free


def _settle(ground: Elevation, shapes: tuple[RockShape, ...], shape: NDArray, diameter: Array,
            xy: Array, buried: Array, max_height: float, tilt_rad: float,
            rng: np.random.Generator) -> tuple[Array, Array]:
    """Return centroids (m, 3) and orientations (m, 4) of rocks that sit in the ground."""
    count = len(diameter)
    ring = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    around = np.stack([np.cos(ring), np.sin(ring)], axis=-1)
    reach = 0.45 * diameter[:, None, None] * around
    rim = ground.height_at(xy[:, None] + reach)
    slope = np.einsum('mi,ik->mk', rim, around) / (4.0 * 0.45 * diameter[:, None])
    height = np.minimum(ground.height_at(xy), rim.mean(axis=1))
    # Each rock is turned about the vertical at random, then tilted with the ground and at random.
    lean = np.clip(-slope, -1.0, 1.0) + tilt_rad / np.sqrt(2.0) * rng.standard_normal((count, 2))
    angle = np.linalg.norm(lean, axis=1)
    axis = np.column_stack([-lean[:, 1], lean[:, 0]]) / np.maximum(angle, 1e-12)[:, None]
    yaw = rng.uniform(-np.pi, np.pi, count)
    w, s = np.cos(angle / 2), np.sin(angle / 2)
    tilt = np.column_stack([w, axis[:, 0] * s, axis[:, 1] * s, np.zeros(count)])
    c, d = np.cos(yaw / 2), np.sin(yaw / 2)
    turn = np.column_stack([c, np.zeros((count, 2)), d])
    quat = product_wxyz(tilt, turn)
    low, high = np.empty(count), np.empty(count)
    up = matrix_from_wxyz(quat)[:, 2]  # maps a point of the rock to its height
    for index, kind in enumerate(shapes):
        chosen = shape == index
        z = np.einsum('mi,vi->mv', up[chosen], kind.vertices.astype(float))
        low[chosen], high[chosen] = z.min(axis=1, initial=0.0), z.max(axis=1, initial=0.0)
    buried = np.maximum(buried, 1.0 - max_height / (high - low))
    foot = height - buried * (high - low) * diameter
    # On a wall or in a pit the ground falls away under the rock, which sinks until its foot is in.
    beneath = ground.height_at(xy[:, None] + 0.65 * reach).min(axis=1) - 0.03 * diameter
    sunk = np.minimum(foot, beneath)
    crown = height - 0.85 * (high - low) * diameter
    z = np.maximum(sunk, np.minimum(foot, crown)) - low * diameter
    return np.column_stack([xy, z]), quat


def _rocks(shape: NDArray, size: NDArray, position: Array, orientation: Array, albedo: NDArray,
           classes: Array) -> Rocks:
    turn = on_lattice(orientation, _ORIENTATION_STEP)
    w, x, y, z = turn.T
    turn = turn / np.sqrt(w * w + x * x + y * y + z * z)[:, None]
    arrays = (shape.astype(np.int32), size.astype(np.int32),
              on_lattice(position, _POSITION_STEP_M), turn,
              on_lattice(albedo, ALBEDO_STEP).astype(np.float32), classes.astype(np.float64))
    for array in arrays:
        array.setflags(write=False)
    return Rocks(*arrays)
