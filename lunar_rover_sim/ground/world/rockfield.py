"""The population of rocks: how many of each size, where they lie, and how deep.

Candidates are drawn tile by tile. One that overlaps a larger candidate is left out, whether that
one is left out itself or not: so which rocks are at a place depends on its surroundings alone. How
a rock lies follows from its key.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
import scipy  # its parts when they are used

from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, product_wxyz
from lunar_rover_sim.ground.world import block_means, rays, streams
from lunar_rover_sim.ground.world.config import ANGULAR_AT, RockConfig, SITES
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.grid import (ALBEDO_STEP, Box, box_around, height_step_m,
                                               HeightGrid, on_lattice, part_of, round_to,
                                               significant, widened)
from lunar_rover_sim.ground.world.rocks import Rocks, RockShape
from lunar_rover_sim.ground.world.shapes import chosen
from lunar_rover_sim.ground.world.spline import Area

logger = logging.getLogger(__name__)

_FILLET_CELLS = 5.0     # of the grid, along the diameter of the smallest rock with a fillet
_POSITION_STEP_M, _ORIENTATION_STEP = 2.0**-20, 2.0**-24
_FRESH = 0.25           # greatest age of a crater around which rocks gather, in lifetimes
_RIM_REACH = 2.6        # radii of a crater to which they gather
_OVERLAP = 0.45         # rocks whose middles are nearer than that of the sum of diameters overlap
_MOST_CROWDED = 3.0     # of the expected number of larger rocks in the way of one that is made up
_KEYS = 100             # number of the first kind of rocks among the kinds of things with keys


@dataclasses.dataclass(frozen=True)
class _Kind:
    """Rocks of similar size, which are drawn together.

    Attributes:
        number: Of the kind.
        least_m: Smallest diameter.
        tile_m: Side of a tile.
        crater_m: Least diameter of a crater around which they gather. Large rocks come from large
            craters, and of those all are known far around a window.
        rays: Whether they lie in the rays of craters, too.
    """

    number: int
    least_m: float
    tile_m: float
    crater_m: float
    rays: bool = False


_KINDS = (_Kind(0, 0.0, 12.8, 0.8), _Kind(1, 0.075, 12.8, 1.6), _Kind(2, 0.3, 51.2, 12.8, True))


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


def angular_share(config: RockConfig) -> float:
    """Return the share of angular blocks among rocks."""
    return ANGULAR_AT[config.site] if config.site else config.angular


def size_classes(config: RockConfig) -> Array:
    """Return the diameters [m] that rocks may have, ascending, evenly spaced in the logarithm."""
    edges = np.geomspace(config.min_diameter_m, config.max_diameter_m, config.size_classes + 1)
    return significant(np.sqrt(edges[1:] * edges[:-1]))


def no_rocks(config: RockConfig) -> Rocks:
    """Return an empty field."""
    return _rocks(np.empty(0, int), np.empty(0, int), np.empty((0, 3)), np.empty((0, 4)),
                  np.empty(0), size_classes(config), np.empty(0, np.uint64))


@dataclasses.dataclass(frozen=True)
class Population:
    """Rocks before they are laid on the ground, the largest first; arrays of equal length m.

    Attributes:
        xy_m: (m, 2) places, frame of the site.
        size: (m,) index into `size_classes`.
        key: (m,) uint64 that a rock keeps in all windows of its site.
    """

    xy_m: Array
    size: NDArray[np.int64]
    key: streams.Keys

    def select(self, chosen: NDArray) -> Population:
        """Return the rocks at the chosen indices, or where a mask is true."""
        return Population(self.xy_m[chosen], self.size[chosen], self.key[chosen])


def rates_per_m2(config: RockConfig) -> Array:
    """Return how many candidates of each class are drawn per m2 of the plain, smallest first.

    They are more than the law has by those that overlap a larger one.
    """
    if config.abundance == 0.0 or config.max_per_m2 == 0.0:
        return np.zeros(config.size_classes)
    edges = np.geomspace(config.min_diameter_m, config.max_diameter_m, config.size_classes + 1)
    number = np.maximum(-np.diff(number_per_m2(config, edges)), 0.0)
    # The smallest are left out where there would be too many.
    above = np.append(np.cumsum(number[::-1])[::-1], 0.0)
    number = np.diff(-np.minimum(above, config.max_per_m2))
    classes = size_classes(config)
    rates = np.zeros(len(classes))
    for k in reversed(range(len(classes))):
        meeting = np.pi * (_OVERLAP * (classes[k] + classes[k:]))**2
        larger = rates[k:] * meeting
        larger[0] = 0.5 * number[k] * meeting[0]    # of its own class, one of two
        rates[k] = number[k] * math.exp(min(larger.sum(), _MOST_CROWDED))
    return rates


def population(config: RockConfig, seed: int, box: Box, craters: Craters, clear_radius_m: float,
               least_m: float = 0.0) -> Population:
    """Return the rocks whose middles lie in a box.

    Args:
        craters: All that reach `known_around` of the box.
        clear_radius_m: None lies within that distance of the origin, where the rover starts.
        least_m: Those of smaller kinds need not be among them.
    """
    classes, rates = size_classes(config), rates_per_m2(config)
    around = widened(box, 2.0 * _OVERLAP * config.max_diameter_m)
    fresh = craters.select((craters.age < _FRESH))
    fresh = fresh.select(np.argsort(fresh.key, kind='stable'))
    parts = []
    for kind, end_m in zip(_KINDS, [*(k.least_m for k in _KINDS[1:]), math.inf]):
        chosen = np.flatnonzero((classes >= kind.least_m) & (classes < end_m))
        if not len(chosen) or end_m <= least_m or not rates[chosen].any():
            continue
        near = fresh.select(fresh.diameter_m > kind.crater_m)
        field = _crowding(config, kind, around, near)
        columns, rows = (range(math.floor(a / kind.tile_m), math.floor(b / kind.tile_m) + 1)
                         for a, b in (around[:2], around[2:]))
        parts += [_tile(config, seed, kind, chosen, rates[chosen], (x, y), near, field)
                  for y in rows for x in columns]
    if not parts:
        return Population(np.empty((0, 2)), np.empty(0, np.int64), np.empty(0, np.uint64))
    drawn = Population(*(np.concatenate(column) for column in zip(*parts)))
    drawn = drawn.select(_within(drawn.xy_m, around))
    drawn = drawn.select(np.lexsort((drawn.key, -drawn.size)))
    diameter = classes[drawn.size]
    clear = np.hypot(*drawn.xy_m.T) >= clear_radius_m + 3.0 * diameter
    return drawn.select(apart(drawn.xy_m, diameter) & clear & _within(drawn.xy_m, box))


def known_around(config: RockConfig, box: Box) -> Box:
    """Return within what the craters must be known that `population` takes for a box."""
    return block_means.box_of(block_means.field_for(
        widened(box, 2.0 * _OVERLAP * config.max_diameter_m)))


def least_crater_m(least_m: float) -> float:
    """Return the diameter of the smallest craters around which rocks of a size and more gather."""
    ends = [*(kind.least_m for kind in _KINDS[1:]), math.inf]
    return min(kind.crater_m for kind, end_m in zip(_KINDS, ends) if end_m > least_m)


def scatter(config: RockConfig, seed: int, ground: HeightGrid, shapes: tuple[RockShape, ...],
            craters: Craters, clear_radius_m: float) -> tuple[Rocks, Population]:
    """Return the rocks that lie on the ground, and all of those whose soil reaches it.

    Their number and sizes follow the law; they are denser around the rims of fresh craters.

    Args:
        craters: All that reach `known_around` of the ground.
    """
    half = ground.half_extent_m
    found = population(config, seed, box_around(ground.middle_m, half + config.max_diameter_m),
                       craters, clear_radius_m)
    away = np.abs(found.xy_m - ground.middle_m).max(axis=1)
    rocks = laid(config, ground, shapes,
                 found.select(away <= half - size_classes(config)[found.size]))
    if len(rocks):
        logger.info('%d rocks from %.2g to %.2g m', len(rocks), rocks.diameter_m.min(),
                    rocks.diameter_m.max())
    return rocks, found


def laid(config: RockConfig, ground: Elevation, shapes: tuple[RockShape, ...],
         rocks: Population) -> Rocks:
    """Return rocks laid on the ground; their keys give shape, burial, turn, tilt and albedo."""
    classes = size_classes(config)
    diameter = classes[rocks.size]
    drawn = streams.uniforms(rocks.key, 'rocks', 3)
    shape = chosen(shapes, angular_share(config), diameter, drawn[:, 0])
    # With this beta distribution most rocks are buried shallowly, and some up to the crown.
    buried = scipy.special.betaincinv(2.4, 2.4 * (1.0 - config.burial) / config.burial,
                                      drawn[:, 1])
    normal = streams.normals(rocks.key, 'rocks', 3)
    lean = np.radians(config.tilt_deg) / np.sqrt(2.0) * normal[:, :2]
    position, orientation = _settle(ground, shapes, shape, diameter, rocks.xy_m, buried,
                                    config.max_height, lean, (2.0 * drawn[:, 2] - 1.0) * np.pi)
    albedo = np.clip(1.0 + config.albedo_variation * normal[:, 2], 0.6, 1.4)
    return _rocks(shape, rocks.size, position, orientation, albedo, classes, rocks.key)


def fillets(config: RockConfig, ground: HeightGrid, rocks: Population) -> HeightGrid:
    """Return ground on which soil has gathered around the feet of rocks.

    Meteoroids throw soil about, and rocks keep what falls beside them: the longer they lie there,
    the higher. It is highest at the rock, and falls to nothing 0.35 diameters away.
    """
    cell = ground.cell_m
    diameters = size_classes(config)[rocks.size]
    share = 2.0 * streams.uniforms(rocks.key, 'fillets', 1)[:, 0]
    large = np.flatnonzero(diameters > _FILLET_CELLS * cell)
    if config.fillet == 0.0 or not len(large):
        return ground
    soil = np.zeros_like(ground.heights_m)
    left, bottom = ground.first
    first = math.floor(left), math.floor(bottom)
    for k in large:
        diameter = diameters[k]
        # On the lattice of the site, so that all windows give one result.
        x, y = rocks.xy_m[k] / cell - (left - first[0], bottom - first[1])
        window = part_of(x, y, 0.85 * diameter / cell, first, soil.shape)
        if window is None:
            continue
        rows, columns = np.ogrid[window]
        away = np.sqrt((columns + first[0] - x)**2 + (rows + first[1] - y)**2) * cell / diameter
        outside = np.clip((away - 0.42) / 0.35, 0.0, 1.0)
        height = config.fillet * share[k] * diameter * (1.0 - outside * outside)**2
        soil[window] = np.maximum(soil[window], height)
    heights = ground.heights_m + soil
    round_to(heights, height_step_m(cell))
    heights.setflags(write=False)
    return dataclasses.replace(ground, heights_m=heights)


def _within(xy_m: Array, box: Box) -> NDArray[np.bool_]:
    x, y = xy_m.T
    return np.asarray((x >= box[0]) & (x < box[1]) & (y >= box[2]) & (y < box[3]))


def _tile(config: RockConfig, seed: int, kind: _Kind, classes: NDArray[np.int64], rates: Array,
          tile: tuple[int, int], craters: Craters,
          field: Area) -> tuple[Array, NDArray[np.int64], streams.Keys]:
    """Return places, sizes and keys of the candidates of a kind on a tile."""
    side = kind.tile_m
    reach = 0.5 * craters.diameter_m * (rays.RAY_REACH if kind.rays else _RIM_REACH)
    away = np.abs(craters.position_m - (np.array(tile) + 0.5) * side).max(axis=1, initial=0.0)
    near = craters.select(away < reach + 0.5 * side)
    amount = config.near_craters * (1.0 - near.age / _FRESH)
    most = 1.0 + amount.sum() * (2.0 if kind.rays else 1.0)
    rng = streams.generator(seed, f'rocks {kind.number}', *tile)
    counts = rng.poisson(rates * (most * side * side))
    size = np.repeat(classes, counts)
    drawn = rng.random((len(size), 3))
    xy = on_lattice((np.array(tile) + drawn[:, :2]) * side, _POSITION_STEP_M)
    density = np.ones(len(size))
    for i in range(len(near)):
        density += _gathered(config, kind, near, i, *(xy - near.position_m[i]).T)
    # Over a block of 51.2 m there are as many as on the plain.
    density /= block_means.smoothed(field, *xy.T)
    taken = drawn[:, 2] * most < density
    key = streams.keys(_KEYS + kind.number, *tile, len(size))
    return xy[taken], size[taken], key[taken]


def _gathered(config: RockConfig, kind: _Kind, craters: Craters, i: int, dx_m: Array,
              dy_m: Array) -> Array:
    """Return what crater i adds to the density of rocks at offsets from its middle."""
    radius = 0.5 * craters.diameter_m[i]
    amount = config.near_craters * (1.0 - craters.age[i] / _FRESH)
    rho = np.hypot(dx_m, dy_m) / radius
    added = np.where(rho < _RIM_REACH, np.exp(-0.5 * ((rho - 1.15) / 0.4)**2), 0.0)
    if kind.rays:
        added = added + np.minimum(rays.strength(craters, i, dx_m / radius, dy_m / radius), 1.0)
    return np.asarray(amount * added)


def _crowding(config: RockConfig, kind: _Kind, box: Box, craters: Craters) -> Area:
    """Return the relative density of a kind over the blocks around a box."""
    field = block_means.field_for(box)
    field.values[:] = 1.0
    x, y = block_means.middles(field)
    for i in range(len(craters)):
        reach = 0.5 * craters.diameter_m[i] * (rays.RAY_REACH if kind.rays else _RIM_REACH)
        at = block_means.at_middles(craters.position_m[i], field.cell_m) / field.cell_m
        part = part_of(at[0], at[1], reach / field.cell_m, field.first, field.values.shape)
        if part is not None:
            dx, dy = np.broadcast_arrays(x[part[1]] - craters.position_m[i, 0],
                                         (y[part[0]] - craters.position_m[i, 1])[:, None])
            field.values[part] += _gathered(config, kind, craters, i, dx, dy)
    return field


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
        around = tree.query_ball_point(xy[start:stop], 2.0 * _OVERLAP * diameter[start])
        for i, near in zip(range(start, stop), around):
            later = np.array([j for j in near if j > i], int)
            if len(later):
                gap = np.linalg.norm(xy[later] - xy[i], axis=1)
                free[later[gap < _OVERLAP * (diameter[later] + diameter[i])]] = False
        start = stop
    return free


def _settle(ground: Elevation, shapes: tuple[RockShape, ...], shape: NDArray, diameter: Array,
            xy: Array, buried: Array, max_height: float, lean: Array,
            yaw: Array) -> tuple[Array, Array]:
    """Return centroids (m, 3) and orientations (m, 4) of rocks that sit in the ground.

    Args:
        lean: (m, 2) tilt towards x and y against the ground [rad].
        yaw: (m,) turn about the vertical [rad].
    """
    count = len(diameter)
    ring = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    around = np.stack([np.cos(ring), np.sin(ring)], axis=-1)
    reach = 0.45 * diameter[:, None, None] * around
    rim = ground.height_at(xy[:, None] + reach)
    slope = np.einsum('mi,ik->mk', rim, around) / (4.0 * 0.45 * diameter[:, None])
    height = np.minimum(ground.height_at(xy), rim.mean(axis=1))
    # Each rock is turned about the vertical, then tilted with the ground.
    lean = np.clip(-slope, -1.0, 1.0) + lean
    angle = np.linalg.norm(lean, axis=1)
    axis = np.column_stack([-lean[:, 1], lean[:, 0]]) / np.maximum(angle, 1e-12)[:, None]
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
           classes: Array, key: streams.Keys) -> Rocks:
    turn = on_lattice(orientation, _ORIENTATION_STEP)
    w, x, y, z = turn.T
    turn = turn / np.sqrt(w * w + x * x + y * y + z * z)[:, None]
    arrays = (shape.astype(np.int32), size.astype(np.int32),
              on_lattice(position, _POSITION_STEP_M), turn,
              on_lattice(albedo, ALBEDO_STEP).astype(np.float32), classes.astype(np.float64),
              key.copy())
    for array in arrays:
        array.setflags(write=False)
    return Rocks(*arrays)
